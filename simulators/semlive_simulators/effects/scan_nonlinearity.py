"""Non-linear scan ramps, and hysteresis of the coil cores."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Effect, Magnification, PixelVisits, Plane, pick_by_magnification


@dataclass(frozen=True, slots=True)
class ScanNonlinearity(Effect):
    """u = q X^2 + k X^3 +- h (1 - X^2), v = q Y^2 + k Y^3, with X, Y = -1 ... 1 and minus in rows scanned from right to left.

    Attributes:
        quadratic_px: q.
        cubic_px: k.
        hysteresis_px: h.
    """

    name: ClassVar[str] = "scan_nonlinearity"

    quadratic_px: float
    cubic_px: float
    hysteresis_px: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> ScanNonlinearity:
        """About 1 or 2 px in the corners."""
        return cls(
            pick_by_magnification(magnification, 0.6, 1.2),
            pick_by_magnification(magnification, 0.4, 0.8),
            pick_by_magnification(magnification, 0.1, 0.2),
        )

    def offset_px(self, at: PixelVisits) -> Plane:
        """A function of the column in x, and of the row in y."""
        x, y = at.from_centre_px
        X, Y = x / (0.5 * (at.scan.width_px - 1)), y / (0.5 * (at.scan.height_px - 1))
        sign = np.where(at.reversed_rows, -1.0, 1.0)
        u = self.quadratic_px * X**2 + self.cubic_px * X**3 + sign * self.hysteresis_px * (1 - X**2)
        return u, self.quadratic_px * Y**2 + self.cubic_px * Y**3
