"""Noise of high voltage or lens current: every frame has its own magnification."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Array, Effect, Instants, Magnification, isotropic, pick_by_magnification
from semlive_simulators.kernels.pattern import gaussian


@dataclass(frozen=True, slots=True)
class MagnificationFrameInstability(Effect):
    """(u, v) = s_f (x - xc, y - yc), s_f white and normal over frames.

    Attributes:
        sd: standard deviation of s_f.
        seed: seed of s_f.
    """

    name: ClassVar[str] = "magnification_frame_instability"

    sd: float
    seed: int = 1

    @classmethod
    def defaults(cls, magnification: Magnification) -> MagnificationFrameInstability:
        """5e-5, which is 0.026 px at the edge."""
        return cls(pick_by_magnification(magnification, 5e-5, 5e-5))

    def deflection(self, at: Instants) -> Array:
        """An isotropic change, constant within a frame."""
        return isotropic(np.full(at.time_s.size, self.sd * gaussian(self.seed, 15, at.frame)))
