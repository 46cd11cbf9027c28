"""Effects on the strain field of the sheet: bending, misalignment, inhomogeneous strain, and motion out of its plane."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import (
    Array,
    Effect,
    Instants,
    PixelVisits,
    Plane,
    isotropic,
)


@dataclass(frozen=True, slots=True)
class BendingMisalignment(Effect):
    """The load acts outside the centre line of the sheet and bends it in its plane.

    u = -k F (y^2 + nu x^2) / 2, v = k F x y, x and y from the centre.

    Attributes:
        curvature_per_mm_n: k.
        poissons_ratio: nu.
    """

    name: ClassVar[str] = "bending_misalignment"
    typical = (7e-8, 0.33)
    """A radius of 6.5 m at 2200 N: 0.02 px at the edge at x200, 0.05 px in the corner."""

    curvature_per_mm_n: float
    poissons_ratio: float

    def material_px(self, x_px: Array, y_px: Array, at: PixelVisits) -> Plane:
        """The displacement of a beam with constant curvature."""
        centre = at.scan.centre_px
        x, y = x_px - centre[0], y_px - centre[1]
        k = self.curvature_per_mm_n * at.load_n * at.scan.pixel_size_um * 1e-3
        return -0.5 * k * (y * y + self.poissons_ratio * x * x), k * x * y


@dataclass(frozen=True, slots=True)
class InplaneMisalignment(Effect):
    """The grips are not aligned: the load also shears and rotates the specimen.

    u = (s - r) F (y - yc), v = (s + r) F (x - xc).

    Attributes:
        shear_per_n: s, tensor shear strain.
        rotation_rad_per_n: r.
    """

    name: ClassVar[str] = "inplane_misalignment"
    typical = (5e-8, 1e-7)
    """A shear of 1e-4 and a rotation of 2e-4 at 2200 N."""

    shear_per_n: float
    rotation_rad_per_n: float

    def specimen_shift_px(self, at: Instants) -> Array:
        """Zero: the centre does not move."""
        return np.zeros((at.time_s.size, 2))

    def specimen_gradient(self, at: Instants) -> Array:
        """Shear and rotation in proportion to the load."""
        load_n = at.motion.load_at(at.time_s)[:, None, None]
        shear, rotation = self.shear_per_n, self.rotation_rad_per_n
        return load_n * np.array([[0.0, shear - rotation], [shear + rotation, 0.0]])


@dataclass(frozen=True, slots=True)
class InhomogeneousStrain(Effect):
    """Slip bands: strain that varies periodically along the direction of the largest shear. This is a quantity to measure, not an error.

    (u, v) = (1, -1) / sqrt(2) A F sin(2 pi (x + y) / (sqrt(2) L)), x and y from the centre.

    Attributes:
        amplitude_px_per_n: A.
        wavelength_px: L.
    """

    name: ClassVar[str] = "inhomogeneous_strain"
    typical = (1e-4, 250.0)
    """0.22 px at 2200 N."""

    amplitude_px_per_n: float
    wavelength_px: float

    def material_px(self, x_px: Array, y_px: Array, at: PixelVisits) -> Plane:
        """A shear displacement in bands at 45 degrees."""
        centre = at.scan.centre_px
        along = (x_px - centre[0] + y_px - centre[1]) / math.sqrt(2)
        slip = self.amplitude_px_per_n * at.load_n * np.sin(2 * np.pi * along / self.wavelength_px) / math.sqrt(2)
        return slip, -slip


@dataclass(frozen=True, slots=True)
class OutOfPlaneTranslation(Effect):
    """The specimen moves towards the lens with the load, by the grips and the contraction of the sheet.

    (u, v) = F lift / WD (x - xc, y - yc).

    Attributes:
        lift_um_per_n: motion towards the lens.
        working_distance_mm: WD.
    """

    name: ClassVar[str] = "out_of_plane_translation"
    typical = (0.002, 14.1)
    """4.4 um at 2200 N, which is 0.16 px at the edge."""

    lift_um_per_n: float
    working_distance_mm: float

    def deflection(self, at: Instants) -> Array:
        """An isotropic change in proportion to the load."""
        load_n = at.motion.load_at(at.time_s)
        return isotropic(load_n * self.lift_um_per_n / (1e3 * self.working_distance_mm))


@dataclass(frozen=True, slots=True)
class TiltWithLoad(Effect):
    """Misaligned grips tilt the specimen about the x axis in proportion to the load.

    u = a x y / WD, v = a y^2 / WD, a = tilt F, x and y from the centre, WD in px.

    Attributes:
        tilt_rad_per_n: a per load.
        working_distance_mm: WD.
    """

    name: ClassVar[str] = "tilt_with_load"
    typical = (1e-6, 14.1)
    """2.2 mrad at 2200 N: 0.04 px in the corner at x200."""

    tilt_rad_per_n: float
    working_distance_mm: float

    def offset_px(self, at: PixelVisits) -> Plane:
        """Perspective displacement of the tilted specimen."""
        x, y = at.from_centre_px
        distance_px = 1e3 * self.working_distance_mm / at.scan.pixel_size_um
        a = self.tilt_rad_per_n * at.load_n / distance_px
        return a * x * y, a * y * y
