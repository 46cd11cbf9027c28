"""Effects on the times at which pixels are visited, and on the recorded times."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import ByMagnification, Effect, PixelVisits, Plane
from semlive_simulators.kernels.exposure import gaussians
from semlive_simulators.microscope.scan import Scan, Timing


@dataclass(frozen=True, slots=True)
class BidirectionalScan(Effect):
    """Odd rows are scanned from right to left, with a lag of the beam in both directions.

    t = (W - 1 - x) t_D + y t_R in odd rows; u = (-1)^y lag / 2.

    Attributes:
        lag_px: offset between rows of the two directions, px.
    """

    name: ClassVar[str] = "bidirectional_scan"
    typical = (1.0,)
    """1 px."""

    lag_px: float

    def retime(self, timing: Timing, scan: Scan) -> Timing:
        """Reverse the odd rows."""
        return replace(timing, reversed_rows=np.arange(scan.height_px) % 2 == 1)

    def offset_px(self, at: PixelVisits) -> Plane:
        """An offset of alternating sign from row to row."""
        return np.where(at.y_px % 2 == 1, -0.5, 0.5) * self.lag_px, np.zeros((1, 1))


@dataclass(frozen=True, slots=True)
class InterlacedScan(Effect):
    """The even rows are scanned first, then the odd ones.

    t = (y mod 2) t_F / 2 + floor(y / 2) t_R + x t_D.
    """

    name: ClassVar[str] = "interlaced_scan"
    typical = ()
    """The effect has no parameters."""

    def retime(self, timing: Timing, scan: Scan) -> Timing:
        """Set the start of each row in its field."""
        rows = np.arange(scan.height_px)
        later = ((rows % 2) * ((scan.height_px + 1) // 2) + rows // 2 - rows) * timing.row_time_s
        return replace(timing, row_start_s=timing.row_start_s + later)


@dataclass(frozen=True, slots=True)
class WrongRowTime(Effect):
    """The true row time differs from the file header.

    t = y t_R (1 + delta) + x t_D.

    Attributes:
        row_time_error: delta, true row time divided by the stated one, minus 1.
    """

    name: ClassVar[str] = "wrong_row_time"
    typical = (0.044,)
    """4.4 %: an estimate without fly-back, with W t_D = 0.1024 s instead of t_R = 0.1071 s."""

    row_time_error: float

    def retime(self, timing: Timing, scan: Scan) -> Timing:
        """Stretch all row starts."""
        stretch = 1 + self.row_time_error
        return replace(timing, row_start_s=timing.row_start_s * stretch, row_time_s=timing.row_time_s * stretch)


@dataclass(frozen=True, slots=True)
class IrregularRows(Effect):
    """Rows start late at random, for example while they wait for a trigger, and the scan pauses once; delays add up over the frame.

    t = y t_R + delta_1 + ... + delta_y + pause (from a row on) + x t_D, delta half of a normal distribution.

    Attributes:
        delay_s: root mean square of the delay of a row.
        pause_row: row before which the scan pauses.
        pause_s: duration of the pause.
        seed: seed of the delays, which are the same in each frame.
    """

    name: ClassVar[str] = "irregular_rows"
    typical = (0.01, 300, 20.0)
    """A tenth of the row time of 0.1 s for each row, and a pause of 20 s before row 300."""

    delay_s: float
    pause_row: int = 0
    pause_s: float = 0.0
    seed: int = 1

    def retime(self, timing: Timing, scan: Scan) -> Timing:
        """Delay all rows by the sum of the delays so far."""
        delay_s = self.delay_s * np.abs(gaussians(self.seed, 60, 0, scan.height_px))
        delay_s[0] = 0.0
        late_s = np.cumsum(delay_s) + np.where(np.arange(scan.height_px) >= max(self.pause_row, 1), self.pause_s, 0.0)
        return replace(timing, row_start_s=timing.row_start_s + late_s)


@dataclass(frozen=True, slots=True)
class WrongDwell(Effect):
    """The true dwell time differs from the file header, the row time does not.

    t = y t_R + x t_D (1 + delta).

    Attributes:
        dwell_error: delta, true dwell time divided by the stated one, minus 1.
    """

    name: ClassVar[str] = "wrong_dwell"
    typical = (0.03,)
    """3 %."""

    dwell_error: float

    def retime(self, timing: Timing, scan: Scan) -> Timing:
        """Change the dwell time."""
        return replace(timing, dwell_time_s=timing.dwell_time_s * (1 + self.dwell_error))


@dataclass(frozen=True, slots=True)
class TimestampOffset(Effect):
    """The clock of the microscope differs from that of the load frame.

    The time in the files is T + dt.

    Attributes:
        offset_s: dt.
    """

    name: ClassVar[str] = "timestamp_offset"
    typical = (5.0,)
    """5 s."""

    offset_s: float

    def stamp_s(self, true_s: float) -> float:
        """Add the offset."""
        return true_s + self.offset_s


@dataclass(frozen=True, slots=True)
class FrameIntegration(Effect):
    """A frame is the mean of several fast scans with the total duration in the file header.

    t = m t_F / M + (y t_R + x t_D) / M, m = 0 ... M - 1, and the mean over m.

    Attributes:
        scans: M.
    """

    name: ClassVar[str] = "frame_integration"
    typical = (ByMagnification(4, 16),)
    """4 or 16 scans."""

    scans: int

    def __post_init__(self) -> None:
        if self.scans < 1:
            raise ValueError(f"scans must be at least 1, not {self.scans}")

    def retime(self, timing: Timing, scan: Scan) -> Timing:
        """Each visit becomes `scans` visits in the same time."""
        begin_s = timing.row_start_s / self.scans
        later_s = np.arange(self.scans)[:, None, None] * scan.duration_s / self.scans
        row_start_s = (begin_s + later_s).reshape(-1, scan.height_px)
        return replace(
            timing,
            row_start_s=row_start_s,
            dwell_time_s=timing.dwell_time_s / self.scans,
            row_time_s=timing.row_time_s / self.scans,
        )
