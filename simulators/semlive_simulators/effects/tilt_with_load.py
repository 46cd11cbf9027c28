"""Misaligned grips tilt the specimen about the x axis in proportion to the load."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from semlive_simulators.effects.interfaces import Effect, Magnification, PixelVisits, Plane, pick_by_magnification


@dataclass(frozen=True, slots=True)
class TiltWithLoad(Effect):
    """u = a x y / WD, v = a y^2 / WD, a = tilt F, x and y from the centre, WD in px.

    Attributes:
        tilt_rad_per_n: a per load.
        working_distance_mm: WD.
    """

    name: ClassVar[str] = "tilt_with_load"

    tilt_rad_per_n: float
    working_distance_mm: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> TiltWithLoad:
        """2.2 mrad at 2200 N: 0.04 px in the corner at x200."""
        return cls(pick_by_magnification(magnification, 1e-6, 1e-6), 14.1)

    def offset_px(self, at: PixelVisits) -> Plane:
        """Perspective displacement of the tilted specimen."""
        x, y = at.from_centre_px
        distance_px = 1e3 * self.working_distance_mm / at.scan.pixel_size_um
        a = self.tilt_rad_per_n * at.load_n / distance_px
        return a * x * y, a * y * y
