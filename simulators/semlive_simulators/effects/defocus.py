"""The focus wanders: the probe widens, and the magnification changes with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from semlive_simulators.effects.protocol import Array, Effect, Instants, Magnification, by, isotropic


@dataclass(frozen=True, slots=True)
class Defocus(Effect):
    """Probe sigma r T, added in squares; (u, v) = m r T (x - xc, y - yc).

    Attributes:
        blur_px_per_s: r.
        magnification_per_px: m, relative change per px of blur.
    """

    name: ClassVar[str] = "defocus"

    blur_px_per_s: float
    magnification_per_px: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> Defocus:
        """0.7 px of blur and 0.07 px at the edge in two hours."""
        return cls(by(magnification, 1e-4, 1e-4), 2e-4)

    def blur_px(self, at: Instants) -> Array:
        """Grows with time."""
        return self.blur_px_per_s * at.time_s

    def deflection(self, at: Instants) -> Array:
        """Isotropic."""
        return isotropic(self.magnification_per_px * self.blur_px_per_s * at.time_s)
