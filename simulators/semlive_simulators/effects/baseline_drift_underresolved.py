"""Drift with more detail in time than a spline with few knots can represent."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Array, Effect, Instants, Magnification, pick_by_magnification
from semlive_simulators.kernels.exposure import gaussians


@dataclass(frozen=True, slots=True)
class BaselineDriftUnderresolved(Effect):
    """D += A sqrt(2 / 12) sum_k sin(2 pi T / P_k + phase_k), 12 periods evenly spaced in their logarithm.

    Attributes:
        sd_px: A, root mean square over time in each axis.
        shortest_period_s: first P_k.
        longest_period_s: last P_k.
        seed: seed of the phases, which are normally distributed numbers of turns.
    """

    name: ClassVar[str] = "baseline_drift_underresolved"

    sd_px: float
    shortest_period_s: float
    longest_period_s: float
    seed: int = 1

    @classmethod
    def defaults(cls, magnification: Magnification) -> BaselineDriftUnderresolved:
        """0.1 or 2 px, periods from half a minute to four."""
        return cls(pick_by_magnification(magnification, 0.1, 2.0), 30.0, 240.0)

    def drift_px(self, at: Instants) -> Array:
        """Independent drifts of both axes."""
        periods_s = np.geomspace(self.shortest_period_s, self.longest_period_s, 12)
        drift = np.empty((at.time_s.size, 2))
        for axis in range(2):
            turns = at.time_s[:, None] / periods_s + gaussians(self.seed, 45 + axis, 0, 12)
            drift[:, axis] = self.sd_px * math.sqrt(2 / 12) * np.sin(2 * np.pi * turns).sum(axis=1)
        return drift
