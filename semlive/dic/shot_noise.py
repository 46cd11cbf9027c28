"""Noise whose variance grows with the grey level (shot noise), and its effect on the uncertainty of u and v.

The variance of one frame is ``variance + slope * f`` at the grey level f above the mean of the frame. The Gauss-Newton covariance
``s^2 H^-1`` assumes one variance for all pixels of a subset. Gradients of bright spots on a dark ground lie where the noise is strong,
so it is too small there; of dark spots it is too large. With the noise known for each pixel, the covariance of the same estimate is
``H^-1 M H^-1`` with ``M = sum g g^T s^2(f)`` (weighted sums, White 1980, doi:10.2307/1912934). The ratio of both is formed for the
2 x 2 block of u and v, because the gradients of the displacement are nearly orthogonal to it in a square subset.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from semlive.kernels.shot_noise import gradient_grey_sums
from semlive.kernels.subset_matching.interface import SubsetSums

# Difference along both axes that passes least of the speckle: fourth differences, 0.6 grey levels of speckle of 3.3 px.
STENCIL = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
WEIGHTS = STENCIL**2 / np.sum(STENCIL**2)  # of the variance of each pixel in a squared difference, hence of its grey level
STENCIL_GAIN = np.float32(np.sum(STENCIL**2) ** 2)  # sum of squares of the separable stencil
NOISE_IN_LEVEL = float(np.sum(WEIGHTS**2) ** 2)  # fraction of the noise variance that remains in the weighted mean
STRIPS = 6  # horizontal strips of the frame from which the noise is estimated
STRIP_ROWS = 24
MAX_COLUMNS = 512  # central columns; 60,000 pixels determine the slope to 3 % of the variance per standard deviation of the pattern
MAX_DEVIATION = 4.0  # larger differences, in standard deviations, are scratches and edges
MIN_NOISE_GREY = 1.0  # below, rounding and the pattern dominate the differences
SIGNIFICANCE = 6.0  # standard deviations of the slope, of which 4.4 are those of correlated differences
DEPENDENCE = 4.0  # the stencil correlates the squares of 5 x 5 neighbours: variance of their mean against independent ones
MAX_FACTOR = 4.0  # largest factor of a variance


@dataclass(frozen=True, slots=True)
class ShotNoise:
    """Noise of one frame.

    Attributes:
        variance: at the mean grey level of the frame, grey^2.
        slope: increase of the variance per grey level, grey.
    """

    variance: float
    slope: float


@dataclass(frozen=True, slots=True, eq=False)
class NoiseFactors:
    """Effect of shot noise on each point, arrays of (ny, nx).

    Attributes:
        u: factor of the variance of u.
        v: factor of the variance of v.
        level: variance of the noise at the mean grey level of the subset relative to that at the mean of the frame.
    """

    u: NDArray[np.float64]
    v: NDArray[np.float64]
    level: NDArray[np.float64]


def estimate_shot_noise(f: NDArray[np.float32]) -> ShotNoise | None:
    """Return the noise of a frame if its variance grows significantly with the grey level, else None.

    The squared difference of each pixel from its neighbours is fitted with a line in their mean grey level, weighted as they
    contribute to the difference. The noise of this mean is taken out of its variance (errors in variables).

    Args:
        f: (height, width) grey levels without the mean of the frame.
    """
    height, width = f.shape
    if height < STRIP_ROWS or width < STRIP_ROWS:
        return None
    left = max(0, (width - MAX_COLUMNS) // 2)
    tops = np.unique(np.linspace(0, height - STRIP_ROWS, STRIPS).astype(int))
    squares, levels = [], []
    for top in tops:
        strip = f[top : top + STRIP_ROWS, left : left + MAX_COLUMNS]
        difference = cv2.sepFilter2D(strip, cv2.CV_32F, STENCIL, STENCIL)[2:-2, 2:-2]
        squares.append((difference * difference).ravel())
        levels.append(cv2.sepFilter2D(strip, cv2.CV_32F, WEIGHTS, WEIGHTS)[2:-2, 2:-2].ravel())
    square, level = np.concatenate(squares) / STENCIL_GAIN, np.concatenate(levels)
    used = (square > 0.0) & (square < MAX_DEVIATION**2 * max(float(square.mean()), 1e-20))
    square, level = square[used].astype(np.float64), level[used].astype(np.float64)
    if square.size < STRIP_ROWS**2:
        return None
    centred = level - level.mean()
    spread = _dot(centred, centred) - NOISE_IN_LEVEL * float(square.sum())
    if not spread > 0.0:
        return None
    slope = _dot(centred, square) / spread
    variance = float(square.mean() - slope * level.mean())
    residual = square - square.mean() - slope * centred
    sigma = float(np.sqrt(DEPENDENCE * _dot(residual, residual) / square.size / spread))
    if slope < SIGNIFICANCE * sigma or variance < MIN_NOISE_GREY**2:
        return None
    return ShotNoise(variance, slope)


def _dot(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Scalar product whose last bits do not depend on the address of the arrays, as those of BLAS do."""
    return float(np.sum(a * b))


def noise_factors(sums: SubsetSums, noise: ShotNoise) -> NoiseFactors:
    """Return the factors of the variances of u and v for the noise of a frame."""
    xx = sums.lower[..., 0, 0] ** 2
    xy = sums.lower[..., 3, 0] * sums.lower[..., 0, 0]
    yy = np.sum(sums.lower[..., 3, :4] ** 2, axis=-1)
    weighted = gradient_grey_sums(sums)
    mean = noise.variance + noise.slope * sums.mean
    mean = np.maximum(mean, 0.1 * noise.variance)
    m_xx, m_xy, m_yy = (noise.variance * h + noise.slope * w for h, w in zip((xx, xy, yy), weighted, strict=True))
    determinant = np.maximum(xx * yy - xy * xy, 1e-12 * np.maximum(xx * yy, 1e-12))
    # (H^-1 M H^-1) and H^-1, both times the determinant
    u = (yy * yy * m_xx - 2.0 * yy * xy * m_xy + xy * xy * m_yy) / determinant
    v = (xx * xx * m_yy - 2.0 * xx * xy * m_xy + xy * xy * m_xx) / determinant

    def factor(weighted: NDArray[np.float64], plain: NDArray[np.float64]) -> NDArray[np.float64]:
        ratio = weighted / np.maximum(plain * mean, 1e-12)
        return np.clip(ratio, 1.0 / MAX_FACTOR, MAX_FACTOR)

    return NoiseFactors(factor(u, yy), factor(v, xx), mean / noise.variance)
