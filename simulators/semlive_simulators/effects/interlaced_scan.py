"""The even rows are scanned first, then the odd ones."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Effect, Magnification, pick_by_magnification
from semlive_simulators.microscope.scan import Scan, Timing


@dataclass(frozen=True, slots=True)
class InterlacedScan(Effect):
    """t = (y mod 2) t_F / 2 + floor(y / 2) t_R + x t_D."""

    name: ClassVar[str] = "interlaced_scan"

    @classmethod
    def defaults(cls, magnification: Magnification) -> InterlacedScan:
        """The effect has no parameters."""
        pick_by_magnification(magnification, 0.0, 0.0)
        return cls()

    def retime(self, timing: Timing, scan: Scan) -> Timing:
        """Set the start of each row in its field."""
        rows = np.arange(scan.height_px)
        later = ((rows % 2) * ((scan.height_px + 1) // 2) + rows // 2 - rows) * timing.row_time_s
        return replace(timing, row_start_s=timing.row_start_s + later)
