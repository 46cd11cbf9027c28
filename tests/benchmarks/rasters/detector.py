"""From a surface to grey levels: contrast transfer, shadows, charging, brightness of rows, noise, clipping."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from .textures import HEIGHT_PX, WIDTH_PX, Field, Surface

MEAN_GREY = 118.0


@dataclass(frozen=True, slots=True)
class Detector:
    """Contrast transfer of one frame. Grey levels are those of 8 bits; images of 16 bits have 257 times as many.

    Attributes:
        contrast_grey: grey levels per standard deviation of the surface's signal.
        shadow_grey: grey levels per unit slope of the relief.
        shadow_rad: direction from which the detector collects.
        gamma: exponent of the contrast transfer about the mean grey level.
        negative_fraction: part of the surface with negative contrast, in patches.
        brightness_grey: added everywhere.
    """

    contrast_grey: float
    shadow_grey: float = 0.0
    shadow_rad: float = 0.0
    gamma: float = 1.0
    negative_fraction: float = 0.0
    brightness_grey: float = 0.0

    def grey(self, surface: Surface, x_px: Field, y_px: Field) -> Field:
        """Grey levels without noise at material positions."""
        value = self.contrast_grey * self._sign(x_px, y_px) * surface.signal_at(x_px, y_px)
        if self.shadow_grey:
            value = value + self.shadow_grey * surface.slope_at(x_px, y_px, self.shadow_rad)
        level = np.clip((MEAN_GREY + value) / 255.0, 1e-3, None)
        return 255.0 * (MEAN_GREY / 255.0) ** (1.0 - self.gamma) * level**self.gamma + self.brightness_grey

    def _sign(self, x_px: Field, y_px: Field) -> Field | float:
        """1, and -1 within the patches of negative contrast; smooth between them."""
        if not self.negative_fraction:
            return 1.0
        threshold = np.quantile(_patches(*np.mgrid[: float(HEIGHT_PX), : float(WIDTH_PX)][::-1]), self.negative_fraction)
        return np.tanh((_patches(x_px, y_px) - threshold) / 0.15)


def _patches(x_px: Field, y_px: Field) -> Field:
    return 0.5 * (np.sin(x_px / 31.0 + 1.3) + np.sin(y_px / 27.0 + 0.4) + np.sin((x_px + y_px) / 43.0))


@dataclass(frozen=True, slots=True)
class Charging:
    """Tails along the fast axis behind bright parts, and slow brightening.

    Attributes:
        tail: grey level behind a wide bright part per grey level above the threshold; negative: dark tails.
        threshold_grey: above the mean grey level.
        length_px: of the exponential tail.
        rise_grey: brightening over the frame, exponential with a third of the rows.
    """

    tail: float = 0.0
    threshold_grey: float = 12.0
    length_px: float = 40.0
    rise_grey: float = 0.0

    def added(self, grey: Field) -> Field:
        """(height, width) grey levels that charging adds to a frame."""
        out = np.zeros_like(grey)
        if self.tail:
            excess = np.clip(grey - MEAN_GREY - self.threshold_grey, 0.0, None)
            decay = np.exp(-1.0 / self.length_px)
            out += self.tail * (1.0 - decay) * signal.lfilter([0.0, 1.0], [1.0, -decay], excess, axis=1)
        rows = np.arange(HEIGHT_PX) / (HEIGHT_PX / 3.0)
        return out + self.rise_grey * (1.0 - np.exp(-rows))[:, None]


@dataclass(frozen=True, slots=True, eq=False)
class RowBrightness:
    """Offset, tilt and gain of every row, (height,); and rows without a measurement."""

    offset_grey: Field = field(default_factory=lambda: np.zeros(HEIGHT_PX))
    tilt_grey: Field = field(default_factory=lambda: np.zeros(HEIGHT_PX))
    gain: Field = field(default_factory=lambda: np.ones(HEIGHT_PX))
    lost: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(HEIGHT_PX, bool))

    def apply(self, grey: Field, rng: np.random.Generator) -> Field:
        """Frame with these rows; a lost row shows an unrelated constant with noise."""
        position = np.linspace(-1.0, 1.0, grey.shape[1])
        out = MEAN_GREY + self.gain[:, None] * (grey - MEAN_GREY) + self.offset_grey[:, None] + self.tilt_grey[:, None] * position
        count = int(self.lost.sum())
        out[self.lost] = rng.uniform(20.0, 235.0, (count, 1)) + 3.0 * rng.standard_normal((count, grey.shape[1]))
        return out


def random_brightness(
    rng: np.random.Generator, offset_grey: float, gain_sd: float, tilt_grey: float = 0.0, lost_rows: int = 0
) -> RowBrightness:
    """Draw offset (half of it white, half a bounded random walk), tilt and gain of the rows of one frame."""
    walk = np.cumsum(rng.standard_normal(HEIGHT_PX))
    walk -= np.linspace(walk[0], walk[-1], HEIGHT_PX)
    offset = rng.standard_normal(HEIGHT_PX) + (walk - walk.mean()) / max(float(walk.std()), 1e-9)
    lost = np.zeros(HEIGHT_PX, bool)
    lost[rng.choice(HEIGHT_PX, lost_rows, replace=False)] = True
    return RowBrightness(
        offset_grey * offset / np.sqrt(2.0),
        tilt_grey * rng.standard_normal(HEIGHT_PX),
        np.clip(1.0 + gain_sd * rng.standard_normal(HEIGHT_PX), 0.3, 2.0),
        lost,
    )


@dataclass(frozen=True, slots=True)
class Noise:
    """Variance of the noise: read_grey^2 + shot_grey * grey level, and the bits of a pixel."""

    read_grey: float = 2.0
    shot_grey: float = 0.0
    bits: int = 8

    def variance(self, grey: Field) -> Field:
        """Variance at noise-free grey levels, rounding included, grey^2 of 8 bits."""
        return self.read_grey**2 + self.shot_grey * np.clip(grey, 0.0, None) + (1.0 / 12.0 if self.bits == 8 else 0.0)

    def expose(self, grey: Field, rng: np.random.Generator) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """Frame with noise, rounded and clipped."""
        spread = np.sqrt(self.read_grey**2 + self.shot_grey * np.clip(grey, 0.0, None))
        value = grey + spread * rng.standard_normal(grey.shape)
        if self.bits == 8:
            return np.clip(np.rint(value), 0, 255).astype(np.uint8)
        return np.clip(np.rint(257.0 * value), 0, 65535).astype(np.uint16)
