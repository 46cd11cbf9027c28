"""The reading of the load cell drifts while its bridge warms up."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from semlive_simulators.effects.interfaces import Effect, Magnification, pick_by_magnification
from semlive_simulators.specimen.specimen import Motion


@dataclass(frozen=True, slots=True)
class LoadCellDrift(Effect):
    """F_m = F + r T.

    Attributes:
        rate_n_per_s: r.
    """

    name: ClassVar[str] = "load_cell_drift"

    rate_n_per_s: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> LoadCellDrift:
        """7 N in an hour."""
        return cls(pick_by_magnification(magnification, 0.002, 0.002))

    def load_reading_n(self, reading_n: float, time_s: float, motion: Motion) -> float:
        """Add the drift."""
        return reading_n + self.rate_n_per_s * time_s
