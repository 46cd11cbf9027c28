"""Electrical breakdowns at random times: the image jumps, with a flash."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Array, Effect, Magnification, PixelVisits, Plane, pick_by_magnification, step_function
from semlive_simulators.kernels.exposure import gaussians
from semlive_simulators.kernels.pattern import gaussian


@dataclass(frozen=True, slots=True)
class ChargingJump(Effect):
    """(u, v) += J_k H(T - T_k), T_k = (k + U_k) mean interval, U_k uniform, J_k normal; grey rises for the length of the flash.

    Attributes:
        sd_px: standard deviation of J_k in each axis.
        mean_interval_s: mean time between breakdowns.
        flash_levels: grey levels of a flash.
        flash_s: duration of a flash.
        seed: seed of J and U.
    """

    name: ClassVar[str] = "charging_jump"

    sd_px: float
    mean_interval_s: float
    flash_levels: float
    flash_s: float
    seed: int = 1

    @classmethod
    def defaults(cls, magnification: Magnification) -> ChargingJump:
        """1 or 10 px every twenty minutes."""
        return cls(pick_by_magnification(magnification, 1.0, 10.0), 1200.0, 25.0, 0.3)

    def instants_s(self, until_s: float) -> Array:
        """T_k of all breakdowns that are possible up to a time."""
        count = max(1, int(until_s / self.mean_interval_s) + 1)
        share = np.array([0.5 * (1 + math.erf(z / math.sqrt(2))) for z in gaussians(self.seed, 50, 0, count)])
        return np.asarray((np.arange(count) + share) * self.mean_interval_s, dtype=np.float64)

    def offset_px(self, at: PixelVisits) -> Plane:
        """A jump between two pixels."""
        u, v = np.zeros((1, 1)), np.zeros((1, 1))
        first, last = float(at.time_s.min()), float(at.time_s.max())
        for number, time_s in enumerate(self.instants_s(last)):
            if time_s <= last:
                step = np.ones((1, 1)) if time_s <= first else step_function(at.time_s, time_s)
                u = u + self.sd_px * gaussian(self.seed, 51, number) * step
                v = v + self.sd_px * gaussian(self.seed, 52, number) * step
        return u, v

    def grey(self, grey: Array, x_px: Array, y_px: Array, at: PixelVisits) -> Array:
        """Add the flashes."""
        for time_s in self.instants_s(float(at.time_s.max())):
            grey = grey + self.flash_levels * ((at.time_s >= time_s) & (at.time_s < time_s + self.flash_s))
        return grey
