"""The load cell has a zero offset."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from semlive_simulators.effects.interfaces import Effect, Magnification, pick_by_magnification
from semlive_simulators.specimen.specimen import Motion


@dataclass(frozen=True, slots=True)
class LoadCellZero(Effect):
    """F_m = F + z.

    Attributes:
        zero_n: z.
    """

    name: ClassVar[str] = "load_cell_zero"

    zero_n: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> LoadCellZero:
        """20 N, about 1 % of the largest load."""
        return cls(pick_by_magnification(magnification, 20.0, 20.0))

    def load_reading_n(self, reading_n: float, time_s: float, motion: Motion) -> float:
        """Add the zero offset."""
        return reading_n + self.zero_n
