"""The load acts outside the centre line of the sheet and bends it in its plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from semlive_simulators.effects.interfaces import Array, Effect, Magnification, PixelVisits, Plane, pick_by_magnification


@dataclass(frozen=True, slots=True)
class BendingMisalignment(Effect):
    """u = -k F (y^2 + nu x^2) / 2, v = k F x y, x and y from the centre.

    Attributes:
        curvature_per_mm_n: k.
        poissons_ratio: nu.
    """

    name: ClassVar[str] = "bending_misalignment"

    curvature_per_mm_n: float
    poissons_ratio: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> BendingMisalignment:
        """A radius of 6.5 m at 2200 N: 0.02 px at the edge at x200, 0.05 px in the corner."""
        return cls(pick_by_magnification(magnification, 7e-8, 7e-8), 0.33)

    def material_px(self, x_px: Array, y_px: Array, at: PixelVisits) -> Plane:
        """The displacement of a beam with constant curvature."""
        centre = at.scan.centre_px
        x, y = x_px - centre[0], y_px - centre[1]
        k = self.curvature_per_mm_n * at.load_n * at.scan.pixel_size_um * 1e-3
        return -0.5 * k * (y * y + self.poissons_ratio * x * x), k * x * y
