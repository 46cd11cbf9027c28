"""A slit in the sheet from the left, with strain concentration at its tip."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from semlive_simulators.effects.hole import Opening
from semlive_simulators.effects.interfaces import Magnification, pick_by_magnification
from semlive_simulators.specimen.elliptic import EllipticHole


@dataclass(frozen=True, slots=True)
class Notch(Opening):
    """The right half of a flat elliptic hole whose centre is to the left of the field of view (Inglis 1913).

    Attributes:
        tip_x_px: position of the tip, from the centre of the frame.
        tip_y_px: likewise.
        depth_px: distance from the tip to the centre of the ellipse.
        tip_radius_px: radius of curvature at the tip.
        strain_per_n: remote strain along y per N, 1 / (A E).
        poissons_ratio: nu.
        grey_level: grey level inside, 8 bit.
        edge_px: half width of the soft edge.
    """

    name: ClassVar[str] = "notch"

    tip_x_px: float
    tip_y_px: float
    depth_px: float
    tip_radius_px: float
    strain_per_n: float
    poissons_ratio: float
    grey_level: float = 12.0
    edge_px: float = 1.5

    @classmethod
    def defaults(cls, magnification: Magnification) -> Notch:
        """A slit 1 mm (at x10,000: 20 um) deep with a tip of 60 px, which has 8.3 times the remote strain."""
        return cls(pick_by_magnification(magnification, -200.0, -200.0), 0.0, 800.0, 60.0, 1.0 / (10.0 * 71.1e3), 0.33)

    @property
    def shape(self) -> EllipticHole:
        """Half axes a and sqrt(a r), for a tip radius of r = b^2 / a."""
        return EllipticHole(self.tip_x_px - self.depth_px, self.tip_y_px, self.depth_px, (self.depth_px * self.tip_radius_px) ** 0.5)
