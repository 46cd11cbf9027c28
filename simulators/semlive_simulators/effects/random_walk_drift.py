"""Random walk of the beam: Brownian motion down to the shortest period, smooth below it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Array, Effect, Instants, Magnification, pick_by_magnification
from semlive_simulators.kernels.exposure import gaussians


@dataclass(frozen=True, slots=True)
class RandomWalkDrift(Effect):
    """D += s sum_k Z_k sqrt(2 S) sin(w_k T / S) / w_k, w_k = (k - 1/2) pi: Karhunen-Loeve series of Brownian motion on 0 ... S.

    Attributes:
        step_px_per_sqrt_s: s, standard deviation of the change within one second, in each axis.
        span_s: S; after this time the drift is mirrored in time.
        shortest_period_s: period of the last term.
        seed: seed of Z.
    """

    name: ClassVar[str] = "random_walk_drift"

    step_px_per_sqrt_s: float
    span_s: float
    shortest_period_s: float
    seed: int = 1

    @classmethod
    def defaults(cls, magnification: Magnification) -> RandomWalkDrift:
        """0.85 or 25 px in two hours."""
        return cls(pick_by_magnification(magnification, 0.01, 0.3), 20_000.0, 60.0)

    def drift_px(self, at: Instants) -> Array:
        """Independent drifts of both axes."""
        count = max(1, round(2 * self.span_s / self.shortest_period_s))
        w = (np.arange(count) + 0.5) * np.pi
        waves = np.sin(at.time_s[:, None] * (w / self.span_s)) / w
        z = np.stack([gaussians(self.seed, 43 + axis, 0, count) for axis in range(2)], axis=-1)
        return self.step_px_per_sqrt_s * math.sqrt(2 * self.span_s) * (waves @ z)
