"""The true dwell time differs from the file header, the row time does not."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from semlive_simulators.effects.interfaces import Effect, Magnification, pick_by_magnification
from semlive_simulators.microscope.scan import Scan, Timing


@dataclass(frozen=True, slots=True)
class WrongDwell(Effect):
    """t = y t_R + x t_D (1 + delta).

    Attributes:
        dwell_error: delta, true dwell time divided by the stated one, minus 1.
    """

    name: ClassVar[str] = "wrong_dwell"

    dwell_error: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> WrongDwell:
        """3 %."""
        return cls(pick_by_magnification(magnification, 0.03, 0.03))

    def retime(self, timing: Timing, scan: Scan) -> Timing:
        """Change the dwell time."""
        return replace(timing, dwell_time_s=timing.dwell_time_s * (1 + self.dwell_error))
