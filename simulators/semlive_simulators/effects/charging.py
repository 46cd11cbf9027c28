"""Effects of charge on the specimen."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import (
    Array,
    ByMagnification,
    Effect,
    PixelVisits,
    Plane,
    exponential_approach,
    step_function,
)
from semlive_simulators.kernels.exposure import gaussians
from semlive_simulators.kernels.pattern import gaussian


@dataclass(frozen=True, slots=True)
class ChargingFrameRamp(Effect):
    """The specimen charges during each frame, more with the total scan time; the image becomes brighter.

    (u, v) = A_f (1 - exp(-tau / tau_c)), A_f = A (1 - exp(-T_f / T_d)), tau time in the frame, T_f its start; grey likewise.

    Attributes:
        x_px: A in x.
        y_px: A in y.
        brightness_levels: A of the grey level.
        charging_s: tau_c.
        dose_s: T_d.
    """

    name: ClassVar[str] = "charging_frame_ramp"
    typical = (ByMagnification(0.15, 1.0), ByMagnification(0.3, 2.0), 5.0, 20.0, 1800.0)
    """0.3 or 2 px, 5 grey levels."""

    x_px: float
    y_px: float
    brightness_levels: float
    charging_s: float
    dose_s: float

    def _charge(self, at: PixelVisits) -> Array:
        return np.expm1(-at.in_frame_s / self.charging_s) * np.expm1(-at.start_s / self.dose_s)

    def offset_px(self, at: PixelVisits) -> Plane:
        """The electric field deflects the beam."""
        charge = self._charge(at)
        return self.x_px * charge, self.y_px * charge

    def grey(self, grey: Array, x_px: Array, y_px: Array, at: PixelVisits) -> Array:
        """The electric field directs electrons to the detector."""
        return grey + self.brightness_levels * self._charge(at)


@dataclass(frozen=True, slots=True)
class ChargingLocalLens(Effect):
    """Charged grains on the specimen deflect the beam around them and are brighter.

    (u, v) = q(T) 2 w (r - r_j) / (|r - r_j|^2 + w^2) summed over grains, q = q0 (1 - exp(-T / tau)); |u| is q at |r - r_j| = w.

    Attributes:
        peak_px: q0 of the first grain.
        width_px: w of the first grain.
        brightness_levels: grey levels in the centre of a fully charged grain, a Gaussian of standard deviation w.
        charging_s: tau.
        grains_px: (x, y) of each grain on the specimen, r_j.
        sizes: (q0, w) of each grain relative to those of the first; empty for equal grains.
    """

    name: ClassVar[str] = "charging_local_lens"
    apparent: ClassVar[bool] = True
    typical = (ByMagnification(0.3, 2.0), 80.0, 10.0, 900.0, ((310.0, 250.0), (720.0, 610.0)))
    """0.3 or 2 px around two grains."""

    peak_px: float
    width_px: float
    brightness_levels: float
    charging_s: float
    grains_px: tuple[tuple[float, float], ...]
    sizes: tuple[tuple[float, float], ...] = ()

    def material_px(self, x_px: Array, y_px: Array, at: PixelVisits) -> Plane:
        """A displacement away from each grain."""
        charge = exponential_approach(at.time_s, self.peak_px, self.charging_s)
        u, v = np.zeros(x_px.shape), np.zeros(x_px.shape)
        for (grain_x, grain_y), (height, width) in self._grains():
            dx, dy, width_px = x_px - grain_x, y_px - grain_y, width * self.width_px
            lens = 2 * width_px * height * charge / (dx * dx + dy * dy + width_px**2)
            u, v = u + lens * dx, v + lens * dy
        return u, v

    def grey(self, grey: Array, x_px: Array, y_px: Array, at: PixelVisits) -> Array:
        """Add the brightness around each grain."""
        charge = exponential_approach(at.time_s, self.brightness_levels, self.charging_s)
        for (grain_x, grain_y), (height, width) in self._grains():
            square = (x_px - grain_x) ** 2 + (y_px - grain_y) ** 2
            grey = grey + height * charge * np.exp(-0.5 * square / (width * self.width_px) ** 2)
        return grey

    def _grains(self) -> Iterator[tuple[tuple[float, float], tuple[float, float]]]:
        yield from zip(self.grains_px, self.sizes or ((1.0, 1.0),) * len(self.grains_px), strict=True)


@dataclass(frozen=True, slots=True)
class ChargingJump(Effect):
    """Electrical breakdowns at random times: the image jumps, with a flash.

    (u, v) += J_k H(T - T_k), T_k = (k + U_k) mean interval, U_k uniform, J_k normal; grey rises for the length of the flash.

    Attributes:
        sd_px: standard deviation of J_k in each axis.
        mean_interval_s: mean time between breakdowns.
        flash_levels: grey levels of a flash.
        flash_s: duration of a flash.
        seed: seed of J and U.
    """

    name: ClassVar[str] = "charging_jump"
    typical = (ByMagnification(1.0, 10.0), 1200.0, 25.0, 0.3)
    """1 or 10 px every twenty minutes."""

    sd_px: float
    mean_interval_s: float
    flash_levels: float
    flash_s: float
    seed: int = 1

    def instants_s(self, until_s: float) -> Array:
        """T_k of all breakdowns that are possible up to a time."""
        count = max(1, int(until_s / self.mean_interval_s) + 1)
        share = np.array([0.5 * (1 + math.erf(z / math.sqrt(2))) for z in gaussians(self.seed, 50, 0, count)])
        return np.asarray((np.arange(count) + share) * self.mean_interval_s, dtype=np.float64)

    def offset_px(self, at: PixelVisits) -> Plane:
        """A jump between two pixels."""
        u, v = np.zeros((1, 1)), np.zeros((1, 1))
        first, last = float(at.time_s.min()), float(at.time_s.max())
        for number, time_s in enumerate(self.instants_s(last)):
            if time_s <= last:
                step = np.ones((1, 1)) if time_s <= first else step_function(at.time_s, time_s)
                u = u + self.sd_px * gaussian(self.seed, 51, number) * step
                v = v + self.sd_px * gaussian(self.seed, 52, number) * step
        return u, v

    def grey(self, grey: Array, x_px: Array, y_px: Array, at: PixelVisits) -> Array:
        """Add the flashes."""
        for time_s in self.instants_s(float(at.time_s.max())):
            grey = grey + self.flash_levels * ((at.time_s >= time_s) & (at.time_s < time_s + self.flash_s))
        return grey
