"""Scan timing: the time at which each pixel of a frame was scanned (Sutton 2007, equations 1-4)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

T = TypeVar("T")


class Provenance(StrEnum):
    """Origin of a value."""

    FILE = "file"
    DERIVED = "derived"
    CONFIG = "config"
    ASSUMED = "assumed"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class Sourced(Generic[T]):
    """A value with its origin."""

    value: T
    source: Provenance


@dataclass(frozen=True, slots=True)
class ScanTiming:
    """Timing of one raster scan.

    Attributes:
        dwell_time_s: time on one pixel in one pass, t_D.
        row_time_s: time from the start of one row to the start of the next, t_R, including all passes and fly-backs.
        frame_time_s: time of one complete scan, t_F.
        integrations: number of scans M that were integrated into the image.
        line_integrations: passes over each row that were integrated before the next row.
    """

    dwell_time_s: Sourced[float]
    row_time_s: Sourced[float]
    frame_time_s: Sourced[float]
    integrations: Sourced[int]
    line_integrations: Sourced[int] = Sourced(1, Provenance.ASSUMED)

    def __post_init__(self) -> None:
        for name in ("dwell_time_s", "row_time_s", "frame_time_s", "integrations", "line_integrations"):
            value = getattr(self, name).value
            if not value > 0:
                raise ValueError(f"{name} must be > 0, not {value}")

    @property
    def duration_s(self) -> float:
        """Time from the first pixel's first visit to the end of the last scan."""
        return self.frame_time_s.value * self.integrations.value

    def time_in_frame_s(self, x_px: ArrayLike, y_px: ArrayLike) -> NDArray[np.float64]:
        """Time since the scan began at positions (x, y), mean over the integrated scans (equation 3).

        Positions may be fractional (a subset centre after displacement). With frame integration a pixel is scanned once per scan, so the
        mean time is (M - 1)/2 scans after the first. With L passes over a row, the mean time is (L - 1)/2 passes after the first.
        """
        first_visit_s = np.asarray(x_px) * self.dwell_time_s.value + np.asarray(y_px) * self.row_time_s.value
        passes = self.line_integrations.value
        pass_delay_s = 0.5 * (passes - 1) / passes * self.row_time_s.value
        return first_visit_s + (pass_delay_s + 0.5 * (self.integrations.value - 1) * self.frame_time_s.value)
