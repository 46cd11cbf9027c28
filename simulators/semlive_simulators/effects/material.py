"""Properties of a specimen that is not a plain elastic sheet: no errors, but quantities to measure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from semlive_simulators.effects.interfaces import Array, ByMagnification, Effect, Instants, PixelVisits, Plane
from semlive_simulators.kernels.grains import grain_grey, smooth_field
from semlive_simulators.specimen.elliptic import EllipticHole


@dataclass(frozen=True, slots=True)
class PlasticHardening(Effect):
    """Plastic strain: a power law of the highest stress so far, which remains after unloading.

    Ramberg and Osgood's law (1943): eyy = s / E + 0.002 (s_max / s_02)^n, the second part at constant volume.

    The elastic part is that of the specimen. Crosshead and strain gage measure the plastic part as well.

    Attributes:
        area_mm2: cross-section, to convert loads to stresses.
        proof_stress_mpa: s_02, the stress at a plastic strain of 0.2 %.
        exponent: n.
    """

    name: ClassVar[str] = "plastic_hardening"
    typical = (10.0, 95.0, 2.25)
    """AL2024 annealed, 10 mm^2: 0.2 % plastic at 95 MPa, 1.3 % at 2200 N."""

    area_mm2: float
    proof_stress_mpa: float
    exponent: float

    def __post_init__(self) -> None:
        if not (self.area_mm2 > 0 and self.proof_stress_mpa > 0 and self.exponent >= 1):
            raise ValueError("area_mm2 and proof_stress_mpa must be above 0, exponent at least 1")

    def plastic_strain(self, peak_n: Array) -> Array:
        """Plastic strain along y after highest loads (n,) so far, N."""
        stress_mpa = np.maximum(peak_n, 0.0) / self.area_mm2
        return 0.002 * (stress_mpa / self.proof_stress_mpa) ** self.exponent

    def specimen_shift_px(self, at: Instants) -> Array:
        """Zero: the centre does not move."""
        return np.zeros((at.time_s.size, 2))

    def specimen_gradient(self, at: Instants) -> Array:
        """Plastic strain along y, and minus half of it along x."""
        strain = self.plastic_strain(_peak_n(at))
        gradient = np.zeros((at.time_s.size, 2, 2))
        gradient[:, 0, 0], gradient[:, 1, 1] = -0.5 * strain, strain
        return gradient


def _peak_n(at: Instants) -> Array:
    """Highest load up to each instant, N, of all completed load steps and of the present load."""
    peak, level = at.motion.load_at(at.time_s), 0.0
    for step in at.motion.history.load_steps:
        level += step.change_n
        peak = np.where(at.time_s >= step.time_s, np.maximum(peak, level), peak)
    return peak


@dataclass(frozen=True, slots=True)
class GrainStrain(Effect):
    """Grains yield differently: strain varies from grain to grain about its mean. This is a quantity to measure, not an error.

    A smooth random displacement (v, -v' / 2) F s L / k; its strain along y has the standard deviation s F.

    v and v' are sums of bumps (1 - r^2 / L^2)^4 of random position and sign, standard deviation 1; their slopes have the standard
    deviation k / L, k = sqrt(36 / 7).

    Attributes:
        seed: seed of the grains.
        grain_px: L, approximately the size of a grain.
        strain_sd_per_n: s.
    """

    name: ClassVar[str] = "grain_strain"
    typical = (2, ByMagnification(160.0, 250.0), 2e-7)
    """A seventh of the mean elastic strain, 4.4e-4 at 2200 N."""

    seed: int
    grain_px: float
    strain_sd_per_n: float

    def __post_init__(self) -> None:
        if not self.grain_px > 0:
            raise ValueError(f"grain_px must be above 0, not {self.grain_px}")

    def material_px(self, x_px: Array, y_px: Array, at: PixelVisits) -> Plane:
        """Independent fields along and across the load."""
        size_px = self.strain_sd_per_n * at.load_n * self.grain_px / math.sqrt(36.0 / 7.0)
        return (
            -0.5 * size_px * smooth_field(x_px, y_px, 2 * self.seed, self.grain_px),
            size_px * smooth_field(x_px, y_px, 2 * self.seed + 1, self.grain_px),
        )


@dataclass(frozen=True, slots=True)
class GrainContrast(Effect):
    """Grains of the metal have different grey levels by electron channelling.

    Voronoi grains, stretched along y (the rolling direction), each with its own grey offset.

    Attributes:
        seed: seed of the grains.
        width_px: mean width of a grain.
        length_px: mean length along y.
        levels: largest offset, grey levels of 8 bit; offsets are uniform between plus and minus that.
        edge_px: half width of a grain boundary.
    """

    name: ClassVar[str] = "grain_contrast"
    typical = (1, ByMagnification(120.0, 200.0), ByMagnification(480.0, 400.0), 12.0)
    """Pancake grains of 0.15 x 0.6 mm; at x10,000 subgrains of 5 x 10 um."""

    seed: int
    width_px: float
    length_px: float
    levels: float
    edge_px: float = 1.0

    def __post_init__(self) -> None:
        if not (self.width_px > 0 and self.length_px > 0 and self.edge_px > 0):
            raise ValueError("width_px, length_px and edge_px must be above 0")

    def grey(self, grey: Array, x_px: Array, y_px: Array, at: PixelVisits) -> Array:
        """Add the offset of each grain."""
        return grey + self.levels * grain_grey(x_px, y_px, self.seed, self.width_px, self.length_px, self.edge_px)


class Opening(Effect):
    """A hole in the sheet, with strain concentration at its sides and no pattern inside.

    Base class of hole and notch: an elliptic opening in the sheet, with no pattern inside.
    """

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
    typical = (150.0, 1.0 / (10.0 * 71.1e3), 0.33)
    """Radius 0.19 mm in AL2024-T4 of 10 mm^2; at x10,000 3.8 um, like a removed inclusion."""

    radius_px: float
    strain_per_n: float
    poissons_ratio: float
    grey_level: float = 12.0
    edge_px: float = 1.5

    @property
    def shape(self) -> EllipticHole:
        """The circle as an ellipse."""
        return EllipticHole(0.0, 0.0, self.radius_px, self.radius_px)


@dataclass(frozen=True, slots=True)
class Notch(Opening):
    """A slit in the sheet from the left, with strain concentration at its tip.

    The right half of a flat elliptic hole whose centre is to the left of the field of view (Inglis 1913).

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
    typical = (-200.0, 0.0, 800.0, 60.0, 1.0 / (10.0 * 71.1e3), 0.33)
    """A slit 1 mm (at x10,000: 20 um) deep with a tip of 60 px, which has 8.3 times the remote strain."""

    tip_x_px: float
    tip_y_px: float
    depth_px: float
    tip_radius_px: float
    strain_per_n: float
    poissons_ratio: float
    grey_level: float = 12.0
    edge_px: float = 1.5

    @property
    def shape(self) -> EllipticHole:
        """Half axes a and sqrt(a r), for a tip radius of r = b^2 / a."""
        return EllipticHole(self.tip_x_px - self.depth_px, self.tip_y_px, self.depth_px, (self.depth_px * self.tip_radius_px) ** 0.5)
