"""The calibration of the load cell has a gain error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from semlive_simulators.effects.interfaces import Effect, Magnification, pick_by_magnification
from semlive_simulators.specimen.specimen import Motion


@dataclass(frozen=True, slots=True)
class LoadCellGain(Effect):
    """F_m = (1 + g) F.

    Attributes:
        gain_error: g.
    """

    name: ClassVar[str] = "load_cell_gain"

    gain_error: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> LoadCellGain:
        """2 %."""
        return cls(pick_by_magnification(magnification, 0.02, 0.02))

    def load_reading_n(self, reading_n: float, time_s: float, motion: Motion) -> float:
        """Multiply by the gain."""
        return (1 + self.gain_error) * reading_n
