"""A frame is the mean of several fast scans with the total duration in the file header."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Effect, Magnification, pick_by_magnification
from semlive_simulators.microscope.scan import Scan, Timing


@dataclass(frozen=True, slots=True)
class FrameIntegration(Effect):
    """t = m t_F / M + (y t_R + x t_D) / M, m = 0 ... M - 1, and the mean over m.

    Attributes:
        scans: M.
    """

    name: ClassVar[str] = "frame_integration"

    scans: int

    def __post_init__(self) -> None:
        if self.scans < 1:
            raise ValueError(f"scans must be at least 1, not {self.scans}")

    @classmethod
    def defaults(cls, magnification: Magnification) -> FrameIntegration:
        """4 or 16 scans."""
        return cls(round(pick_by_magnification(magnification, 4, 16)))

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
