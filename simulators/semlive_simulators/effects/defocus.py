"""The focus drifts: the probe becomes wider, and the magnification changes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Array, Effect, Instants, Magnification, isotropic, pick_by_magnification


@dataclass(frozen=True, slots=True)
class Defocus(Effect):
    """Probe sigma (r + a) T along an axis and |r - a| T across it, added in squares; (u, v) = m r T (x - xc, y - yc).

    Attributes:
        blur_px_per_s: r.
        magnification_per_px: m, relative change per px of blur.
        astigmatism_px_per_s: a.
        axis_rad: angle of the longer axis of the probe, from x to y.
    """

    name: ClassVar[str] = "defocus"

    blur_px_per_s: float
    magnification_per_px: float
    astigmatism_px_per_s: float = 0.0
    axis_rad: float = 0.0

    @classmethod
    def defaults(cls, magnification: Magnification) -> Defocus:
        """0.7 px of blur and 0.07 px at the edge in two hours."""
        return cls(pick_by_magnification(magnification, 1e-4, 1e-4), 2e-4)

    def blur_px2(self, at: Instants) -> Array:
        """A covariance that grows with the square of time."""
        cos, sin = math.cos(self.axis_rad), math.sin(self.axis_rad)
        rotation = np.array([[cos, -sin], [sin, cos]])
        rates = np.diag([(self.blur_px_per_s + self.astigmatism_px_per_s) ** 2, (self.blur_px_per_s - self.astigmatism_px_per_s) ** 2])
        return at.time_s[:, None, None] ** 2 * (rotation @ rates @ rotation.T)

    def deflection(self, at: Instants) -> Array:
        """An isotropic change of magnification."""
        return isotropic(self.magnification_per_px * self.blur_px_per_s * at.time_s)
