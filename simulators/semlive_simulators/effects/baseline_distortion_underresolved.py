"""Distortion with more spatial detail than a spline with few knots can represent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Effect, Magnification, PixelVisits, Plane, pick_by_magnification


@dataclass(frozen=True, slots=True)
class BaselineDistortionUnderresolved(Effect):
    """u = A sin(2 pi x / L) cos(2 pi y / L), v = A cos(2 pi x / L) sin(2 pi y / L).

    Attributes:
        amplitude_px: A.
        wavelength_px: L.
    """

    name: ClassVar[str] = "baseline_distortion_underresolved"

    amplitude_px: float
    wavelength_px: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> BaselineDistortionUnderresolved:
        """0.05 px over 110 px."""
        return cls(pick_by_magnification(magnification, 0.05, 0.05), 110.0)

    def offset_px(self, at: PixelVisits) -> Plane:
        """A periodic field in x and y."""
        x, y = 2 * np.pi * at.x_px / self.wavelength_px, 2 * np.pi * at.y_px / self.wavelength_px
        return self.amplitude_px * np.sin(x) * np.cos(y), self.amplitude_px * np.cos(x) * np.sin(y)
