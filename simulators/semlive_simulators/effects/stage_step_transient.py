"""Gears and piezos relax after each move of the stage."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Array, Effect, Instants, Magnification, pick_by_magnification


@dataclass(frozen=True, slots=True)
class StageStepTransient(Effect):
    """D += A m_n exp(-(T - T_n) / tau) after every move n by m_n.

    Attributes:
        fraction: A, fraction of a move that relaxes.
        time_constant_s: tau.
    """

    name: ClassVar[str] = "stage_step_transient"

    fraction: float
    time_constant_s: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> StageStepTransient:
        """0.5 px after 25 px, or 3 px after 10 px."""
        return cls(pick_by_magnification(magnification, 0.02, 0.3), 60.0)

    def drift_px(self, at: Instants) -> Array:
        """An exponential decay after every move."""
        total = np.zeros((at.time_s.size, 2))
        for move in at.motion.history.moves:
            elapsed_s = np.maximum(at.time_s - move.time_s, 0.0)
            remaining = np.where(at.time_s >= move.time_s, self.fraction * np.exp(-elapsed_s / self.time_constant_s), 0.0)
            total += remaining[:, None] * np.array(move.change_px)
        return total
