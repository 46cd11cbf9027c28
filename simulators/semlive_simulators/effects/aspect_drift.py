"""The gains of the two scan amplifiers drift differently with temperature."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Array, Effect, Instants, Magnification, exponential_approach, pick_by_magnification


@dataclass(frozen=True, slots=True)
class AspectDrift(Effect):
    """(u, v) = s(T) (x - xc, -(y - yc)), s = change (1 - exp(-T / tau)).

    Attributes:
        change: total change.
        time_constant_s: tau.
    """

    name: ClassVar[str] = "aspect_drift"

    change: float
    time_constant_s: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> AspectDrift:
        """5e-5, which is 0.026 px at the edge."""
        return cls(pick_by_magnification(magnification, 5e-5, 5e-5), 3600.0)

    def deflection(self, at: Instants) -> Array:
        """A stretch along x and a compression along y."""
        return exponential_approach(at.time_s, self.change, self.time_constant_s)[:, None, None] * np.array([[1.0, 0.0], [0.0, -1.0]])
