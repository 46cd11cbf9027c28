"""Charged grains on the specimen deflect the beam around them and are brighter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import (
    Array,
    Effect,
    Magnification,
    PixelVisits,
    Plane,
    exponential_approach,
    pick_by_magnification,
)


@dataclass(frozen=True, slots=True)
class ChargingLocalLens(Effect):
    """(u, v) = q(T) 2 w (r - r_j) / (|r - r_j|^2 + w^2) summed over grains, q = q0 (1 - exp(-T / tau)); |u| is q at |r - r_j| = w.

    Attributes:
        peak_px: q0.
        width_px: w.
        brightness_levels: grey levels in the centre of a fully charged grain, a Gaussian of standard deviation w.
        charging_s: tau.
        grains_px: (x, y) of each grain on the specimen, r_j.
    """

    name: ClassVar[str] = "charging_local_lens"
    apparent: ClassVar[bool] = True

    peak_px: float
    width_px: float
    brightness_levels: float
    charging_s: float
    grains_px: tuple[tuple[float, float], ...]

    @classmethod
    def defaults(cls, magnification: Magnification) -> ChargingLocalLens:
        """0.3 or 2 px around two grains."""
        return cls(pick_by_magnification(magnification, 0.3, 2.0), 80.0, 10.0, 900.0, ((310.0, 250.0), (720.0, 610.0)))

    def material_px(self, x_px: Array, y_px: Array, at: PixelVisits) -> Plane:
        """A displacement away from each grain."""
        charge = exponential_approach(at.time_s, self.peak_px, self.charging_s)
        u, v = np.zeros(x_px.shape), np.zeros(x_px.shape)
        for grain_x, grain_y in self.grains_px:
            dx, dy = x_px - grain_x, y_px - grain_y
            lens = 2 * self.width_px * charge / (dx * dx + dy * dy + self.width_px**2)
            u, v = u + lens * dx, v + lens * dy
        return u, v

    def grey(self, grey: Array, x_px: Array, y_px: Array, at: PixelVisits) -> Array:
        """Add the brightness around each grain."""
        charge = exponential_approach(at.time_s, self.brightness_levels, self.charging_s)
        for grain_x, grain_y in self.grains_px:
            square = (x_px - grain_x) ** 2 + (y_px - grain_y) ** 2
            grey = grey + charge * np.exp(-0.5 * square / self.width_px**2)
        return grey
