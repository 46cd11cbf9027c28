"""A hole in the sheet, with strain concentration at its sides and no pattern inside."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from semlive_simulators.effects.interfaces import Array, Effect, Magnification, PixelVisits, Plane, pick_by_magnification
from semlive_simulators.specimen.elliptic import EllipticHole


class Opening(Effect):
    """Base class of hole and notch: an elliptic opening in the sheet, with no pattern inside."""

    __slots__ = ()
    strain_per_n: float
    poissons_ratio: float
    grey_level: float
    edge_px: float

    @property
    def shape(self) -> EllipticHole:
        """The ellipse, from the centre of the frame."""
        raise NotImplementedError(f"{type(self).__name__} has no shape")

    def material_px(self, x_px: Array, y_px: Array, at: PixelVisits) -> Plane:
        """Displacement by the opening in addition to the uniform deformation."""
        centre = at.scan.centre_px
        return self.shape.displacement_px(x_px - centre[0], y_px - centre[1], self.strain_per_n * at.load_n, self.poissons_ratio)

    def absent(self, x_px: Array, y_px: Array, at: PixelVisits) -> NDArray[np.bool_]:
        """Whether points are inside the opening."""
        centre = at.scan.centre_px
        return self.shape.outside(x_px - centre[0], y_px - centre[1]) < 1.0

    def grey(self, grey: Array, x_px: Array, y_px: Array, at: PixelVisits) -> Array:
        """Set the grey level inside the opening."""
        centre = at.scan.centre_px
        return self.shape.darkened(grey, x_px - centre[0], y_px - centre[1], self.grey_level, self.edge_px)


@dataclass(frozen=True, slots=True)
class Hole(Opening):
    """A round hole in the centre of the field of view, in a sheet that is much wider (Kirsch 1898).

    Attributes:
        radius_px: radius of the hole.
        strain_per_n: remote strain along y per N, 1 / (A E).
        poissons_ratio: nu.
        grey_level: grey level inside, 8 bit.
        edge_px: half width of the soft edge.
    """

    name: ClassVar[str] = "hole"

    radius_px: float
    strain_per_n: float
    poissons_ratio: float
    grey_level: float = 12.0
    edge_px: float = 1.5

    @classmethod
    def defaults(cls, magnification: Magnification) -> Hole:
        """Radius 0.19 mm in AL2024-T4 of 10 mm^2; at x10,000 3.8 um, like a removed inclusion."""
        return cls(pick_by_magnification(magnification, 150.0, 150.0), 1.0 / (10.0 * 71.1e3), 0.33)

    @property
    def shape(self) -> EllipticHole:
        """The circle as an ellipse."""
        return EllipticHole(0.0, 0.0, self.radius_px, self.radius_px)
