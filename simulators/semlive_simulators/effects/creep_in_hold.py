"""The specimen creeps during a hold."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Array, Effect, Instants, Magnification, pick_by_magnification


@dataclass(frozen=True, slots=True)
class CreepInHold(Effect):
    """eps(T) = c F ln(1 + (T - T_k) / t0) since the last load step, eyy = eps, exx = -nu eps.

    Attributes:
        strain_per_n: c.
        onset_s: t0.
        poissons_ratio: nu.
    """

    name: ClassVar[str] = "creep_in_hold"

    strain_per_n: float
    onset_s: float
    poissons_ratio: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> CreepInHold:
        """Near yield: 0.14 px at the edge 125 s after a step to 2200 N."""
        return cls(pick_by_magnification(magnification, 6e-8, 6e-8), 10.0, 0.33)

    def specimen_shift_px(self, at: Instants) -> Array:
        """Zero: the centre does not move."""
        return np.zeros((at.time_s.size, 2))

    def specimen_gradient(self, at: Instants) -> Array:
        """Uniaxial strain along y."""
        strain = np.zeros(at.time_s.size)
        for step in at.motion.history.load_steps:
            elapsed_s = np.maximum(at.time_s - step.time_s, 0.0)
            creep = self.strain_per_n * at.motion.load_at(at.time_s) * np.log1p(elapsed_s / self.onset_s)
            strain = np.where(at.time_s >= step.time_s, creep, strain)
        return strain[:, None, None] * np.array([[-self.poissons_ratio, 0.0], [0.0, 1.0]])
