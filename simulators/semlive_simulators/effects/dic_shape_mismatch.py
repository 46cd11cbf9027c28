"""Deformation that is curved within a subset: first-order shape functions have an error of about D'' subset^2 / 24."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Array, Effect, Magnification, PixelVisits, Plane, pick_by_magnification


@dataclass(frozen=True, slots=True)
class DicShapeMismatch(Effect):
    """u = A F cos(2 pi x / L), v = A F cos(2 pi y / L), x and y from the centre.

    Attributes:
        amplitude_px_per_n: A.
        wavelength_px: L.
    """

    name: ClassVar[str] = "dic_shape_mismatch"

    amplitude_px_per_n: float
    wavelength_px: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> DicShapeMismatch:
        """0.2 px at 2200 N, with an error of 0.017 px in subsets of 43 px."""
        return cls(pick_by_magnification(magnification, 1e-4, 1e-4), 200.0)

    def material_px(self, x_px: Array, y_px: Array, at: PixelVisits) -> Plane:
        """Waves in the direction of the displacement."""
        centre, k = at.scan.centre_px, 2 * np.pi / self.wavelength_px
        amplitude_px = self.amplitude_px_per_n * at.load_n
        return amplitude_px * np.cos(k * (x_px - centre[0])), amplitude_px * np.cos(k * (y_px - centre[1]))
