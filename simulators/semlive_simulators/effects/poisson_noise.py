"""Shot noise of few electrons: the variance grows with the signal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Array, Effect, Magnification, pick_by_magnification


@dataclass(frozen=True, slots=True)
class PoissonNoise(Effect):
    """Variance a + b I, instead of that of the detector.

    Attributes:
        dark_variance_levels2: a.
        levels_per_electron: b.
    """

    name: ClassVar[str] = "poisson_noise"

    dark_variance_levels2: float
    levels_per_electron: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> PoissonNoise:
        """8 or 11 grey levels in the bright dots."""
        return cls(1.0, pick_by_magnification(magnification, 0.35, 0.7))

    def variance(self, variance: Array, grey: Array) -> Array:
        """A linear function of the signal."""
        return self.dark_variance_levels2 + self.levels_per_electron * np.maximum(grey, 0.0)
