"""Pixels are wider than high."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Array, Effect, Instants, Magnification, pick_by_magnification


@dataclass(frozen=True, slots=True)
class AnisotropicPixel(Effect):
    """u = e (x - xc).

    Attributes:
        x_excess: e.
    """

    name: ClassVar[str] = "anisotropic_pixel"

    x_excess: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> AnisotropicPixel:
        """1 %, which is 5 px at the edge."""
        return cls(pick_by_magnification(magnification, 0.01, 0.01))

    def deflection(self, at: Instants) -> Array:
        """Constant in time."""
        return np.broadcast_to(np.array([[self.x_excess, 0.0], [0.0, 0.0]]), (at.time_s.size, 2, 2))
