"""Effects on focus, grey levels and noise, and errors of image correlation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import (
    Array,
    ByMagnification,
    Effect,
    Instants,
    PixelVisits,
    Plane,
    isotropic,
)
from semlive_simulators.microscope.patterns import Pattern


@dataclass(frozen=True, slots=True)
class Contamination(Effect):
    """Carbon is deposited by the beam: less brightness and contrast inside the scanned box.

    I *= 1 - c T inside the box around the centre of the field, never below a fifth.

    Attributes:
        loss_per_s: c.
        box_width_px: width of the box on the specimen.
        box_height_px: height of the box.
    """

    name: ClassVar[str] = "contamination"
    typical = (ByMagnification(2e-5, 5e-5), 1000.0, 860.0)
    """14 or 36 % in two hours, in a box a little smaller than the frame."""

    loss_per_s: float
    box_width_px: float
    box_height_px: float

    def grey(self, grey: Array, x_px: Array, y_px: Array, at: PixelVisits) -> Array:
        """Reduce the grey levels inside the box."""
        centre = at.scan.centre_px
        inside = (np.abs(x_px - centre[0]) <= 0.5 * self.box_width_px) & (np.abs(y_px - centre[1]) <= 0.5 * self.box_height_px)
        return grey * np.where(inside, np.maximum(0.2, 1 - self.loss_per_s * at.time_s), 1.0)


@dataclass(frozen=True, slots=True)
class Defocus(Effect):
    """The focus drifts: the probe becomes wider, and the magnification changes.

    Probe sigma (r + a) T along an axis and |r - a| T across it, added in squares; (u, v) = m r T (x - xc, y - yc).

    Attributes:
        blur_px_per_s: r.
        magnification_per_px: m, relative change per px of blur.
        astigmatism_px_per_s: a.
        axis_rad: angle of the longer axis of the probe, from x to y.
    """

    name: ClassVar[str] = "defocus"
    typical = (1e-4, 2e-4)
    """0.7 px of blur and 0.07 px at the edge in two hours."""

    blur_px_per_s: float
    magnification_per_px: float
    astigmatism_px_per_s: float = 0.0
    axis_rad: float = 0.0

    def blur_px2(self, at: Instants) -> Array:
        """A covariance that grows with the square of time."""
        cos, sin = math.cos(self.axis_rad), math.sin(self.axis_rad)
        rotation = np.array([[cos, -sin], [sin, cos]])
        rates = np.diag([(self.blur_px_per_s + self.astigmatism_px_per_s) ** 2, (self.blur_px_per_s - self.astigmatism_px_per_s) ** 2])
        return at.time_s[:, None, None] ** 2 * (rotation @ rates @ rotation.T)

    def deflection(self, at: Instants) -> Array:
        """An isotropic change of magnification."""
        return isotropic(self.magnification_per_px * self.blur_px_per_s * at.time_s)


@dataclass(frozen=True, slots=True)
class GammaChange(Effect):
    """The operator or the microscope changes brightness or contrast.

    I -> 255 a (I / 255)^g + b from an instant on.

    Attributes:
        gain: a.
        gamma: g.
        offset_levels: b.
        at_s: time of the change, seconds since the run began.
    """

    name: ClassVar[str] = "gamma_change"
    typical = (1.05, 0.9, -8.0, 600.0)
    """A slightly lower contrast and brightness after ten minutes."""

    gain: float
    gamma: float
    offset_levels: float
    at_s: float

    def grey(self, grey: Array, x_px: Array, y_px: Array, at: PixelVisits) -> Array:
        """Apply the changed response curve."""
        changed = 255.0 * self.gain * (np.maximum(grey, 0.0) / 255.0) ** self.gamma + self.offset_levels
        return np.where(at.time_s >= self.at_s, changed, grey)


@dataclass(frozen=True, slots=True)
class PoissonNoise(Effect):
    """Shot noise of few electrons: the variance grows with the signal.

    Variance a + b I, instead of that of the detector.

    Attributes:
        dark_variance_levels2: a.
        levels_per_electron: b.
    """

    name: ClassVar[str] = "poisson_noise"
    typical = (1.0, ByMagnification(0.35, 0.7))
    """8 or 11 grey levels in the bright dots."""

    dark_variance_levels2: float
    levels_per_electron: float

    def variance(self, variance: Array, grey: Array) -> Array:
        """A linear function of the signal."""
        return self.dark_variance_levels2 + self.levels_per_electron * np.maximum(grey, 0.0)


@dataclass(frozen=True, slots=True)
class DicSubpixelBias(Effect):
    """Dots or islands with edges sharper than a pixel: interpolation has a periodic error over the fraction of a pixel.

    The half width of the edges is multiplied by a factor. Nothing moves: any displacement in the result is a bias of correlation.

    Attributes:
        edge_factor: the factor, at most 1.
    """

    name: ClassVar[str] = "dic_subpixel_bias"
    typical = (0.16,)
    """A sixth of the width: edges of less than a pixel."""

    edge_factor: float

    def __post_init__(self) -> None:
        if not 0 < self.edge_factor <= 1:
            raise ValueError(f"edge_factor must be above 0 and at most 1, not {self.edge_factor}")

    def changed(self, speckle: Pattern) -> Pattern:
        """The pattern with sharper edges."""
        return speckle.with_sharper_edges(self.edge_factor)


@dataclass(frozen=True, slots=True)
class DicShapeMismatch(Effect):
    """Deformation that is curved within a subset: first-order shape functions have an error of about D'' subset^2 / 24.

    u = A F cos(2 pi x / L), v = A F cos(2 pi y / L), x and y from the centre.

    Attributes:
        amplitude_px_per_n: A.
        wavelength_px: L.
    """

    name: ClassVar[str] = "dic_shape_mismatch"
    typical = (1e-4, 200.0)
    """0.2 px at 2200 N, with an error of 0.017 px in subsets of 43 px."""

    amplitude_px_per_n: float
    wavelength_px: float

    def material_px(self, x_px: Array, y_px: Array, at: PixelVisits) -> Plane:
        """Waves in the direction of the displacement."""
        centre, k = at.scan.centre_px, 2 * np.pi / self.wavelength_px
        amplitude_px = self.amplitude_px_per_n * at.load_n
        return amplitude_px * np.cos(k * (x_px - centre[0])), amplitude_px * np.cos(k * (y_px - centre[1]))
