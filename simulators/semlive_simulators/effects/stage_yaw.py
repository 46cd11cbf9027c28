"""The guides of the stage rotate the specimen slightly with each move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Array, Effect, Instants, Magnification, pick_by_magnification
from semlive_simulators.kernels.pattern import gaussian


@dataclass(frozen=True, slots=True)
class StageYaw(Effect):
    """(u, v) = theta_n (-(y - yc), x - xc) after move n, theta_n normal.

    Attributes:
        sd_rad: standard deviation of theta_n.
        seed: seed of theta_n.
    """

    name: ClassVar[str] = "stage_yaw"

    sd_rad: float
    seed: int = 1

    @classmethod
    def defaults(cls, magnification: Magnification) -> StageYaw:
        """3e-4 rad, which is 0.15 px at the edge."""
        return cls(pick_by_magnification(magnification, 3e-4, 3e-4))

    def specimen_shift_px(self, at: Instants) -> Array:
        """Zero: the centre does not move."""
        return np.zeros((at.time_s.size, 2))

    def specimen_gradient(self, at: Instants) -> Array:
        """A rotation."""
        theta = np.zeros(at.time_s.size)
        for number, move in enumerate(at.motion.history.moves):
            theta = np.where(at.time_s >= move.time_s, self.sd_rad * gaussian(self.seed, 30, number), theta)
        return theta[:, None, None] * np.array([[0.0, -1.0], [1.0, 0.0]])
