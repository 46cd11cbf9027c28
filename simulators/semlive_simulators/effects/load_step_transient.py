"""Settling of grips and load frame after each load step: the field of view moves with a decaying rate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Array, Effect, Instants, Magnification, pick_by_magnification


@dataclass(frozen=True, slots=True)
class LoadStepTransient(Effect):
    """D += dF A exp(-(T - T_k) / tau) after every load step k.

    Attributes:
        x_px_per_n: A in x.
        y_px_per_n: A in y.
        time_constant_s: tau.
    """

    name: ClassVar[str] = "load_step_transient"

    x_px_per_n: float
    y_px_per_n: float
    time_constant_s: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> LoadStepTransient:
        """1 or 50 px after a step of 350 N."""
        return cls(pick_by_magnification(magnification, 0.001, 0.05), pick_by_magnification(magnification, 0.003, 0.15), 60.0)

    def drift_px(self, at: Instants) -> Array:
        """An exponential decay after every load step."""
        total = np.zeros(at.time_s.size)
        for step in at.motion.history.load_steps:
            elapsed_s = np.maximum(at.time_s - step.time_s, 0.0)
            total += np.where(at.time_s >= step.time_s, step.change_n * np.exp(-elapsed_s / self.time_constant_s), 0.0)
        return total[:, None] * np.array([self.x_px_per_n, self.y_px_per_n])
