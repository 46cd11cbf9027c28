"""Effects on the image field of the scan: magnification, rotation, shear, aspect and distortion, and their drift."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import (
    Array,
    Effect,
    Instants,
    PixelVisits,
    Plane,
    exponential_approach,
    isotropic,
)
from semlive_simulators.kernels.pattern import gaussian


@dataclass(frozen=True, slots=True)
class MagnificationDrift(Effect):
    """High voltage (dM/M = dV/2V), lens current or working distance drift (dM/M = dz/WD: 1 um is 7e-5).

    (u, v) = s(T) (x - xc, y - yc), s = change (1 - exp(-T / tau)).

    Attributes:
        change: total relative change.
        time_constant_s: tau.
    """

    name: ClassVar[str] = "magnification_drift"
    typical = (3e-4, 3600.0)
    """3e-4, which is 0.15 px at the edge."""

    change: float
    time_constant_s: float

    def deflection(self, at: Instants) -> Array:
        """An isotropic change."""
        return isotropic(exponential_approach(at.time_s, self.change, self.time_constant_s))


@dataclass(frozen=True, slots=True)
class MagnificationFrameInstability(Effect):
    """Noise of high voltage or lens current: every frame has its own magnification.

    (u, v) = s_f (x - xc, y - yc), s_f white and normal over frames.

    Attributes:
        sd: standard deviation of s_f.
        seed: seed of s_f.
    """

    name: ClassVar[str] = "magnification_frame_instability"
    typical = (5e-5,)
    """5e-5, which is 0.026 px at the edge."""

    sd: float
    seed: int = 1

    def deflection(self, at: Instants) -> Array:
        """An isotropic change, constant within a frame."""
        return isotropic(np.full(at.time_s.size, self.sd * gaussian(self.seed, 15, at.frame)))


@dataclass(frozen=True, slots=True)
class RefocusMagnificationStep(Effect):
    """The operator or auto-focus changes the focus after each move and each load step.

    (u, v) = s_n (x - xc, y - yc), n counts the moves and load steps before the frame; s_0 = 0, the others normal.

    Attributes:
        sd: standard deviation of s_n.
        seed: seed of s_n.
    """

    name: ClassVar[str] = "refocus_magnification_step"
    typical = (5e-4,)
    """5e-4, which is 0.26 px at the edge."""

    sd: float
    seed: int = 1

    def deflection(self, at: Instants) -> Array:
        """An isotropic change, constant within a frame."""
        count = sum(1 for time_s in at.motion.history.changes_s() if time_s <= at.start_s)
        step = self.sd * gaussian(self.seed, 16, count) if count else 0.0
        return isotropic(np.full(at.time_s.size, step))


@dataclass(frozen=True, slots=True)
class RasterRotationDrift(Effect):
    """Lens current or scan rotation electronics drift: the raster rotates.

    (u, v) = theta(T) (-(y - yc), x - xc), theta = change (1 - exp(-T / tau)).

    Attributes:
        change_rad: total rotation.
        time_constant_s: tau.
    """

    name: ClassVar[str] = "raster_rotation_drift"
    typical = (5e-5, 3600.0)
    """5e-5 rad, which is 0.026 px at the edge."""

    change_rad: float
    time_constant_s: float

    def deflection(self, at: Instants) -> Array:
        """A rotation."""
        return exponential_approach(at.time_s, self.change_rad, self.time_constant_s)[:, None, None] * np.array([[0.0, -1.0], [1.0, 0.0]])


@dataclass(frozen=True, slots=True)
class ScanShearDrift(Effect):
    """Cross-talk between the scan amplifiers drifts with temperature.

    u = gamma(T) (y - yc), gamma = change (1 - exp(-T / tau)).

    Attributes:
        change: total shear.
        time_constant_s: tau.
    """

    name: ClassVar[str] = "scan_shear_drift"
    typical = (5e-5, 3600.0)
    """5e-5, which is 0.022 px at the edge."""

    change: float
    time_constant_s: float

    def deflection(self, at: Instants) -> Array:
        """A shear of the rows."""
        return exponential_approach(at.time_s, self.change, self.time_constant_s)[:, None, None] * np.array([[0.0, 1.0], [0.0, 0.0]])


@dataclass(frozen=True, slots=True)
class AspectDrift(Effect):
    """The gains of the two scan amplifiers drift differently with temperature.

    (u, v) = s(T) (x - xc, -(y - yc)), s = change (1 - exp(-T / tau)).

    Attributes:
        change: total change.
        time_constant_s: tau.
    """

    name: ClassVar[str] = "aspect_drift"
    typical = (5e-5, 3600.0)
    """5e-5, which is 0.026 px at the edge."""

    change: float
    time_constant_s: float

    def deflection(self, at: Instants) -> Array:
        """A stretch along x and a compression along y."""
        return exponential_approach(at.time_s, self.change, self.time_constant_s)[:, None, None] * np.array([[1.0, 0.0], [0.0, -1.0]])


@dataclass(frozen=True, slots=True)
class DistortionScaleDrift(Effect):
    """Working distance or high voltage drift, and the distortion changes in proportion.

    (u, v) = eta(T) E(R), eta = change (1 - exp(-T / tau)).

    Attributes:
        change: total relative change of the distortion.
        time_constant_s: tau.
    """

    name: ClassVar[str] = "distortion_scale_drift"
    typical = (0.1, 3600.0)
    """A tenth of the distortion."""

    change: float
    time_constant_s: float

    def offset_px(self, at: PixelVisits) -> Plane:
        """A fraction of the distortion."""
        eta = exponential_approach(at.time_s, self.change, self.time_constant_s)
        return eta * at.distortion_px[0], eta * at.distortion_px[1]


@dataclass(frozen=True, slots=True)
class AnisotropicPixel(Effect):
    """Pixels are wider than high.

    u = e (x - xc).

    Attributes:
        x_excess: e.
    """

    name: ClassVar[str] = "anisotropic_pixel"
    typical = (0.01,)
    """1 %, which is 5 px at the edge."""

    x_excess: float

    def deflection(self, at: Instants) -> Array:
        """Constant in time."""
        return np.broadcast_to(np.array([[self.x_excess, 0.0], [0.0, 0.0]]), (at.time_s.size, 2, 2))


@dataclass(frozen=True, slots=True)
class ScanNonorthogonality(Effect):
    """Columns are not perpendicular to rows.

    u = skew (y - yc).

    Attributes:
        skew_rad: 90 degrees minus the angle between the axes.
    """

    name: ClassVar[str] = "scan_nonorthogonality"
    typical = (0.01,)
    """0.01 rad, which is 4.4 px at the edge."""

    skew_rad: float

    def deflection(self, at: Instants) -> Array:
        """Constant in time."""
        return np.broadcast_to(np.array([[0.0, self.skew_rad], [0.0, 0.0]]), (at.time_s.size, 2, 2))
