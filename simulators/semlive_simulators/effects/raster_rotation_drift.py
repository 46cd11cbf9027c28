"""Lens current or scan rotation electronics drift: the raster rotates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Array, Effect, Instants, Magnification, exponential_approach, pick_by_magnification


@dataclass(frozen=True, slots=True)
class RasterRotationDrift(Effect):
    """(u, v) = theta(T) (-(y - yc), x - xc), theta = change (1 - exp(-T / tau)).

    Attributes:
        change_rad: total rotation.
        time_constant_s: tau.
    """

    name: ClassVar[str] = "raster_rotation_drift"

    change_rad: float
    time_constant_s: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> RasterRotationDrift:
        """5e-5 rad, which is 0.026 px at the edge."""
        return cls(pick_by_magnification(magnification, 5e-5, 5e-5), 3600.0)

    def deflection(self, at: Instants) -> Array:
        """A rotation."""
        return exponential_approach(at.time_s, self.change_rad, self.time_constant_s)[:, None, None] * np.array([[0.0, -1.0], [1.0, 0.0]])
