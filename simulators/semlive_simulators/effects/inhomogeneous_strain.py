"""Slip bands: strain that varies periodically along the direction of the largest shear. This is a quantity to measure, not an error."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Array, Effect, Magnification, PixelVisits, Plane, pick_by_magnification


@dataclass(frozen=True, slots=True)
class InhomogeneousStrain(Effect):
    """(u, v) = (1, -1) / sqrt(2) A F sin(2 pi (x + y) / (sqrt(2) L)), x and y from the centre.

    Attributes:
        amplitude_px_per_n: A.
        wavelength_px: L.
    """

    name: ClassVar[str] = "inhomogeneous_strain"

    amplitude_px_per_n: float
    wavelength_px: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> InhomogeneousStrain:
        """0.22 px at 2200 N."""
        return cls(pick_by_magnification(magnification, 1e-4, 1e-4), 250.0)

    def material_px(self, x_px: Array, y_px: Array, at: PixelVisits) -> Plane:
        """A shear displacement in bands at 45 degrees."""
        centre = at.scan.centre_px
        along = (x_px - centre[0] + y_px - centre[1]) / math.sqrt(2)
        slip = self.amplitude_px_per_n * at.load_n * np.sin(2 * np.pi * along / self.wavelength_px) / math.sqrt(2)
        return slip, -slip
