"""Speckle without interpolation: a sum of Gaussian spots, evaluated at the displaced position of every pixel.

Independent of the engine: numpy only. Every image is exact (but for rounding to grey levels), so what an engine gets wrong is its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Affine:
    """x_current = x + u + ux (x - xc) + uy (y - yc), likewise v."""

    u: float = 0.0
    v: float = 0.0
    ux: float = 0.0
    uy: float = 0.0
    vx: float = 0.0
    vy: float = 0.0
    xc: float = 0.0
    yc: float = 0.0

    def at(self, x: NDArray, y: NDArray) -> tuple[NDArray, NDArray]:
        """Displacement (u, v) of reference positions."""
        dx, dy = x - self.xc, y - self.yc
        return self.u + self.ux * dx + self.uy * dy, self.v + self.vx * dx + self.vy * dy

    def back(self, x: NDArray, y: NDArray) -> tuple[NDArray, NDArray]:
        """Reference positions of current positions, exact."""
        a, b, c, d = 1.0 + self.ux, self.uy, self.vx, 1.0 + self.vy
        det = a * d - b * c
        dx, dy = x - self.xc - self.u, y - self.yc - self.v
        return self.xc + (d * dx - b * dy) / det, self.yc + (a * dy - c * dx) / det


@dataclass(frozen=True)
class Speckle:
    """Random spots over a frame and a margin around it.

    The autocorrelation of spots of standard deviation s has a full width at half maximum of 3.33 s.
    """

    width: int
    height: int
    spot_px: float = 2.0
    seed: int = 1
    margin: int = 90
    density: float = 0.16  # spots per spot_px^2

    @cached_property
    def spots(self) -> NDArray[np.float64]:
        rng = np.random.default_rng(self.seed)
        area = (self.width + 2 * self.margin) * (self.height + 2 * self.margin)
        count = int(self.density * area / self.spot_px**2)
        place = rng.uniform(-self.margin, [self.width + self.margin, self.height + self.margin], (count, 2))
        return np.column_stack([place, rng.choice([-1.0, 1.0], count)])

    def render(self, motion: Affine = Affine()) -> NDArray[np.float64]:
        """Grey levels, mean 128, standard deviation 39, not yet rounded."""
        x0, y0, sign = self.spots.T
        u, v = motion.at(x0, y0)
        column, row = np.round(x0 + u).astype(int), np.round(y0 + v).astype(int)
        reach = int(np.ceil(5.0 * self.spot_px))
        near = (column > -reach) & (column < self.width + reach) & (row > -reach) & (row < self.height + reach)
        x0, y0, sign, column, row = (a[near] for a in (x0, y0, sign, column, row))
        image = np.zeros(self.height * self.width)
        for dy in range(-reach, reach + 1):
            for dx in range(-reach, reach + 1):
                x, y = column + dx, row + dy
                inside = (x >= 0) & (x < self.width) & (y >= 0) & (y < self.height)
                x, y = x[inside], y[inside]
                bx, by = motion.back(x.astype(float), y.astype(float))
                r2 = (bx - x0[inside]) ** 2 + (by - y0[inside]) ** 2
                value = sign[inside] * np.exp(-0.5 * r2 / self.spot_px**2)
                image += np.bincount(y * self.width + x, weights=value, minlength=image.size)
        sd = np.sqrt(self.density * np.pi)  # shot noise of random spots
        return 128.0 + 39.0 * image.reshape(self.height, self.width) / sd


def expose(grey: NDArray[np.float64], noise: float = 0.0, seed: int = 0, bits: int = 8) -> NDArray:
    """Round to 8 or 16 bit, with Gaussian noise of so many 8-bit grey levels."""
    noisy = grey + noise * np.random.default_rng(seed).standard_normal(grey.shape) if noise else grey
    scale = 1.0 if bits == 8 else 257.0
    return np.clip(np.round(noisy * scale), 0, 2**bits - 1).astype(np.uint8 if bits == 8 else np.uint16)
