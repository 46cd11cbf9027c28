"""Periodic thermal drift of the column by air conditioning or a chiller."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Array, Effect, Instants, Magnification, pick_by_magnification


@dataclass(frozen=True, slots=True)
class ThermalOscillation(Effect):
    """D += A sin(2 pi T / P + phase).

    Attributes:
        x_px: A in x.
        y_px: A in y.
        period_s: P.
        phase_rad: phase at the start of the run.
    """

    name: ClassVar[str] = "thermal_oscillation"

    x_px: float
    y_px: float
    period_s: float
    phase_rad: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> ThermalOscillation:
        """0.2 or 5 px every eight minutes."""
        return cls(pick_by_magnification(magnification, 0.1, 2.5), pick_by_magnification(magnification, 0.2, 5.0), 480.0, 0.7)

    def drift_px(self, at: Instants) -> Array:
        """Equal phases in both axes."""
        return np.sin(2 * np.pi * at.time_s / self.period_s + self.phase_rad)[:, None] * np.array([self.x_px, self.y_px])
