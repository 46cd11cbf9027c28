"""The raster in time: start, number of visits and direction of each row."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict


@dataclass(frozen=True, slots=True)
class Scan:
    """Raster scans over the field of view, one or several per image.

    Attributes:
        width_px: pixels in a row.
        height_px: number of rows.
        dwell_time_s: time on a pixel per visit, s.
        frame_time_s: time of one visit of all rows, with fly-back, s.
        gap_s: time between the end of a frame and the start of the next in continuous mode, s.
        pixel_size_um: edge of a pixel on the specimen.
        integrations: number of visits of each pixel, which are averaged.
        integration: ``frame`` repeats the complete frame, ``line`` repeats each line before the next one.
        direction: ``forward`` scans all rows from left to right, ``snake`` the odd rows from right to left.
        interlaced: whether the even rows are scanned first, then the odd ones.
        rotation_rad: scan rotation from the axes of the column to those of the scan, positive from x to y.
        spot_px: standard deviation of the probe, px, in addition to the soft edges of the dots.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    width_px: int
    height_px: int
    dwell_time_s: float
    frame_time_s: float
    gap_s: float
    pixel_size_um: float
    integrations: int = 1
    integration: Literal["frame", "line"] = "frame"
    direction: Literal["forward", "snake"] = "forward"
    interlaced: bool = False
    rotation_rad: float = 0.0
    spot_px: float = 0.0

    def __post_init__(self) -> None:
        if self.width_px * self.dwell_time_s > self.row_time_s:
            raise ValueError(f"a row takes {self.row_time_s} s, too little for {self.width_px} px of {self.dwell_time_s} s")
        if self.integrations < 1:
            raise ValueError(f"integrations must be at least 1, not {self.integrations}")
        if self.spot_px < 0:
            raise ValueError(f"spot_px must be at least 0, not {self.spot_px}")

    @property
    def row_time_s(self) -> float:
        """Time from the start of a row to the start of the next, s."""
        return self.frame_time_s / self.height_px

    @property
    def duration_s(self) -> float:
        """Time from the first pixel to the end of the last scan, s."""
        return self.integrations * self.frame_time_s

    @property
    def centre_px(self) -> NDArray[np.float64]:
        """Centre of the frame, (x, y)."""
        return np.array([0.5 * (self.width_px - 1), 0.5 * (self.height_px - 1)])

    @property
    def rotation(self) -> NDArray[np.float64]:
        """(2, 2) rotation matrix from the axes of the scan to those of the column."""
        cos, sin = math.cos(self.rotation_rad), math.sin(self.rotation_rad)
        return np.array([[cos, -sin], [sin, cos]])


@dataclass(frozen=True, slots=True, eq=False)
class Timing:
    """Times at which the rows of a frame are visited.

    Attributes:
        row_start_s: (visits, rows) start of each row on each visit, seconds since the frame began.
        reversed_rows: (rows,) whether a row is scanned from right to left.
        dwell_time_s: time on a pixel, s.
        row_time_s: time from the start of a row to the start of the next scanned row, s.
    """

    row_start_s: NDArray[np.float64]
    reversed_rows: NDArray[np.bool_]
    dwell_time_s: float
    row_time_s: float

    @property
    def end_s(self) -> float:
        """End of the last row, seconds since the frame began."""
        return float(self.row_start_s.max()) + self.row_time_s

    @property
    def plain(self) -> bool:
        """Whether every row has a single visit, from left to right and from top to bottom."""
        even = np.arange(self.row_start_s.shape[1]) * self.row_time_s
        return self.row_start_s.shape[0] == 1 and not self.reversed_rows.any() and np.allclose(self.row_start_s[0], even, atol=1e-9)


def timing(scan: Scan) -> Timing:
    """The nominal timing of a scan."""
    rows = np.arange(scan.height_px)
    order: NDArray[np.int64] = rows if not scan.interlaced else np.where(rows % 2 == 0, rows // 2, (scan.height_px + 1) // 2 + rows // 2)
    visits = np.arange(scan.integrations)[:, None]
    if scan.integration == "frame":
        row_start_s = np.asarray(order * scan.row_time_s + visits * scan.frame_time_s, dtype=np.float64)
    else:
        row_start_s = np.asarray((order * scan.integrations + visits) * scan.row_time_s, dtype=np.float64)
    reverse = rows % 2 == 1 if scan.direction == "snake" else np.zeros(scan.height_px, dtype=bool)
    return Timing(row_start_s, reverse, scan.dwell_time_s, scan.row_time_s)
