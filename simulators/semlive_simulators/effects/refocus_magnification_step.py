"""The operator or auto-focus changes the focus after each move and each load step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Array, Effect, Instants, Magnification, isotropic, pick_by_magnification
from semlive_simulators.kernels.pattern import gaussian


@dataclass(frozen=True, slots=True)
class RefocusMagnificationStep(Effect):
    """(u, v) = s_n (x - xc, y - yc), n counts the moves and load steps before the frame; s_0 = 0, the others normal.

    Attributes:
        sd: standard deviation of s_n.
        seed: seed of s_n.
    """

    name: ClassVar[str] = "refocus_magnification_step"

    sd: float
    seed: int = 1

    @classmethod
    def defaults(cls, magnification: Magnification) -> RefocusMagnificationStep:
        """5e-4, which is 0.26 px at the edge."""
        return cls(pick_by_magnification(magnification, 5e-4, 5e-4))

    def deflection(self, at: Instants) -> Array:
        """An isotropic change, constant within a frame."""
        count = sum(1 for time_s in at.motion.history.changes_s() if time_s <= at.start_s)
        step = self.sd * gaussian(self.seed, 16, count) if count else 0.0
        return isotropic(np.full(at.time_s.size, step))
