"""Drift during the warm-up of the column, about half an hour after power on (Sutton 2007 waits 15 to 30 minutes)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Array, Effect, Instants, Magnification, pick_by_magnification


@dataclass(frozen=True, slots=True)
class WarmupTransient(Effect):
    """D += A exp(-T / tau).

    Attributes:
        x_px: A in x.
        y_px: A in y.
        time_constant_s: tau.
    """

    name: ClassVar[str] = "warmup_transient"

    x_px: float
    y_px: float
    time_constant_s: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> WarmupTransient:
        """2 or 20 px in ten minutes."""
        return cls(pick_by_magnification(magnification, 1.0, 10.0), pick_by_magnification(magnification, 2.0, 20.0), 600.0)

    def drift_px(self, at: Instants) -> Array:
        """An exponential decay."""
        return np.exp(-at.time_s / self.time_constant_s)[:, None] * np.array([self.x_px, self.y_px])
