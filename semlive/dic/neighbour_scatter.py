"""Uncertainty from the scatter of neighbouring points, where it exceeds what image noise explains.

Errors of image noise are those of a moving polynomial fit: overlapping subsets share pixels, so the covariance of two points follows from
the fit alone. Fourth differences along a line of points remove what is smooth in the displacement. Shifts of rows and charging leave
residuals that are correlated over many pixels. The scatter is then larger than that of white noise of the same variance, on which the
Gauss-Newton covariance is based.

Charging also displaces a complete pattern in one direction, which no scatter shows. It displaces fine and coarse structure differently, so
the difference of two band-passed copies (`second_estimate`) shows it.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap
from semlive.data.grid import Grid
from semlive.data.settings import DicSettings
from semlive.dic.second_estimate import SecondEstimates
from semlive.kernels.order_statistics import median_of

Array = NDArray[np.float64]

DIFFERENCE = (1.0, -4.0, 6.0, -4.0, 1.0)
# Of a subset between the points of a difference; at shorter distances the edges of subsets dominate. The smaller scatter counts, so both
# must exceed the limit: a wave of one period (the spline's own bias under strain) is amplified at one distance only, noise that a filter
# has correlated scatters more at the short one, and a displacement that is not smooth over four subsets at the long one.
DISTANCES = (1.0 / 3.0, 1.0)
MIN_DIFFERENCES = 100  # fewer do not determine the scatter
SPREAD = 1.6  # standard deviation of the relative variance for one independent difference, from moving means of white noise
SIGMAS = 3.0  # of this spread by which the scatter exceeds the limit
NORMAL_MEDIAN = 0.4549364  # median of the square of a standard normal variable
MAX_RATIO = 1.1  # of the scatter to that of white noise
MAX_RATIO_SHORT = 1.7  # the same where lost points or a small map leave the short distance alone
MIN_EXCESS_PX = 0.01  # smaller scatter is that of a scan generator in good order: 0.03 px of jitter of single rows cause 0.007 px
WHITE_SHARE = 0.5  # mean squared difference of the bands with white noise, relative to the variance: 0.2 to 0.7 in rendered textures
BAND_FACTOR = 2.5  # variance of the error relative to the mean squared difference of the bands, in rendered scenes with charging
DEGREES = {"affine": 1, "quadratic": 2, "quartic": 4}


def scatters(disparity: DisparityMap, settings: DicSettings) -> bool:
    """Whether u or v scatter more than the stated uncertainty explains in a uniform texture.

    Args:
        disparity: map of subsets.
        settings: of the correlation.
    """
    if not disparity.valid.any():
        return False
    for values, sigma in ((disparity.u_px, disparity.sigma_u_px), (disparity.v_px, disparity.sigma_v_px)):
        for axis in range(2):
            relative, limit = _scatter(values, sigma, disparity.valid, disparity.grid, DEGREES[settings.shape_function], axis)
            if relative > limit and relative - 1.0 > (MIN_EXCESS_PX / float(median_of(sigma[disparity.valid]))) ** 2:
                return True
    return False


def scatter_ratio(values: Array, sigma: Array, valid: NDArray[np.bool_], grid: Grid, degree: int) -> float:
    """Standard deviation of fourth differences relative to that of white noise in a uniform texture, the larger of those along x and y.

    Args:
        values: (ny, nx) displacement in px.
        sigma: (ny, nx) standard uncertainty in px.
        valid: (ny, nx) points to use.
        grid: grid of the points.
        degree: of the polynomial that is the shape function.

    Returns:
        The ratio; 0 if there are too few points.
    """
    return max(_scatter(values, sigma, valid, grid, degree, axis)[0] for axis in range(2)) ** 0.5


def _scatter(values: Array, sigma: Array, valid: NDArray[np.bool_], grid: Grid, degree: int, axis: int) -> tuple[float, float]:
    """Variance of differences along an axis relative to white noise, the smaller of both distances, and its limit; 0 if unknown."""
    found: list[tuple[float, float]] = []
    for lag in sorted({math.ceil(distance * grid.subset_px / grid.step_px) for distance in DISTANCES}):
        count = values.shape[axis] - (len(DIFFERENCE) - 1) * lag
        at = [(slice(None),) * axis + (slice(k * lag, k * lag + max(count, 0)),) for k in range(len(DIFFERENCE))]
        usable = np.logical_and.reduce([valid[part] for part in at])
        if (points := np.count_nonzero(usable)) < MIN_DIFFERENCES:
            max_ratio = MAX_RATIO_SHORT
            break
        difference = np.asarray(sum(weight * values[part] for weight, part in zip(DIFFERENCE, at, strict=True)))
        square = (difference[usable] / sigma[at[2]][usable]) ** 2
        expected = NORMAL_MEDIAN * _variance_of_difference(grid.subset_px, lag * grid.step_px, degree)
        independent = points * min(1.0, grid.step_px**2 / (grid.subset_px * min(lag * grid.step_px, grid.subset_px)))
        found.append((float(median_of(square)) / expected, SIGMAS * SPREAD / independent**0.5))
    else:
        max_ratio = MAX_RATIO
    relative, sampling = min(found, default=(0.0, 0.0))
    return relative, max_ratio**2 + sampling


@lru_cache
def _variance_of_difference(subset_px: int, lag_px: int, degree: int) -> float:
    """Variance of the fourth difference of points lag_px apart, in units of the variance of one point."""
    half = subset_px // 2
    y, x = (a.ravel() for a in np.mgrid[-half : half + 1, -half : half + 1] / max(half, 1))
    terms = np.stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)], axis=1)
    kernel = np.linalg.pinv(terms)[0].reshape(2 * half + 1, 2 * half + 1)  # weights of the pixels in the value at the centre
    covariance = np.zeros(len(DIFFERENCE))
    for k in range(len(DIFFERENCE)):
        if (offset := k * lag_px) <= 2 * half:
            covariance[k] = np.sum(kernel[:, offset:] * kernel[:, : 2 * half + 1 - offset])
    distance = np.abs(np.subtract.outer(range(len(DIFFERENCE)), range(len(DIFFERENCE))))
    weights = np.array(DIFFERENCE)
    return float(weights @ (covariance[distance] / covariance[0]) @ weights)


def widened(disparity: DisparityMap, second: SecondEstimates, settings: DicSettings) -> DisparityMap:
    """The map with standard uncertainties that cover its scatter and the difference of the two bands.

    Args:
        disparity: map of subsets.
        second: its estimates in two bands.
        settings: of the correlation.
    """
    grid, valid = disparity.grid, disparity.valid
    found = valid & np.all(second.found, axis=0)
    out: list[Array] = []
    for k, (values, sigma) in enumerate(((disparity.u_px, disparity.sigma_u_px), (disparity.v_px, disparity.sigma_v_px))):
        ratio = scatter_ratio(values, sigma, valid, grid, DEGREES[settings.shape_function])
        square = _mean_around(np.mean(second.difference_px[..., k] ** 2, axis=0), found, grid)
        variance = sigma**2
        of_bands = variance + BAND_FACTOR * np.maximum(square - WHITE_SHARE * variance, 0.0)
        out.append(np.where(valid, np.sqrt(np.maximum(variance * max(ratio, 1.0) ** 2, of_bands)), 0.0))
    return replace(disparity, sigma_u_px=out[0], sigma_v_px=out[1])


def _mean_around(values: Array, where: NDArray[np.bool_], grid: Grid) -> Array:
    """(ny, nx) mean of the marked values within half a subset of each point; zero without any."""
    width = 2 * max(1, round(0.5 * grid.subset_px / grid.step_px)) + 1
    total, count = (
        cv2.blur(a, (width, width), borderType=cv2.BORDER_CONSTANT) for a in (np.where(where, values, 0.0), where.astype(np.float64))
    )
    return np.asarray(np.where(count > 1e-9, total / np.maximum(count, 1e-9), 0.0), dtype=np.float64)
