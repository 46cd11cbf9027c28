"""The true row time differs from the file header."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from semlive_simulators.effects.interfaces import Effect, Magnification, pick_by_magnification
from semlive_simulators.microscope.scan import Scan, Timing


@dataclass(frozen=True, slots=True)
class WrongRowTime(Effect):
    """t = y t_R (1 + delta) + x t_D.

    Attributes:
        row_time_error: delta, true row time divided by the stated one, minus 1.
    """

    name: ClassVar[str] = "wrong_row_time"

    row_time_error: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> WrongRowTime:
        """4.4 %: an estimate without fly-back, with W t_D = 0.1024 s instead of t_R = 0.1071 s."""
        return cls(pick_by_magnification(magnification, 0.044, 0.044))

    def retime(self, timing: Timing, scan: Scan) -> Timing:
        """Stretch all row starts."""
        stretch = 1 + self.row_time_error
        return replace(timing, row_start_s=timing.row_start_s * stretch, row_time_s=timing.row_time_s * stretch)
