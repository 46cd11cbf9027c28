"""Noise of the residual of a pair: variance by place and by row, and its correlation over neighbouring pixels."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from semlive.dic.global_method.filters import smoothed

Image = NDArray[np.float32]
Array = NDArray[np.float64]

AREA_PX = 20.0  # standard deviation of the window of the local variance
ROUNDING_VARIANCE = 1.0 / 12.0  # grey^2
DEGREES = 4.0  # degrees of freedom of Student's t distribution of the residual
REACH_PX = 12  # largest lag of the correlation
GAIN_PRIOR = 1.0  # pixels of usual contrast with which the gain of a row is drawn to 1
MIN_ROW_PIXELS = 8


def row_levels(residual: Image, reference: Image, used: Image) -> tuple[Image, Image]:
    """Offset and relative gain of each row, (height,) each, by least squares of the residual on the reference.

    Args:
        residual: (height, width) current frame at the displaced positions minus reference, zero where not used.
        reference: (height, width) grey levels.
        used: (height, width) 1 where both frames are known, else 0.
    """
    count = used.sum(axis=1) + 1e-6
    first, second = (used * reference).sum(axis=1), (used * reference**2).sum(axis=1)
    second = second + GAIN_PRIOR * float(np.sum(second)) / max(float(np.sum(count)), 1.0)
    total, product = residual.sum(axis=1), (residual * reference).sum(axis=1)
    determinant = np.maximum(count * second - first**2, 1e-9)
    offset = (second * total - first * product) / determinant
    gain = (count * product - first * total) / determinant
    return offset.astype(np.float32), gain.astype(np.float32)


def variance_map(residual: Image, used: Image) -> Image:
    """(height, width) variance of the residual: mean around each pixel, larger in rows with larger residuals, grey^2."""
    count = smoothed(used, AREA_PX, cv2.BORDER_CONSTANT)
    local = smoothed(residual**2 * used, AREA_PX, cv2.BORDER_CONSTANT) / np.maximum(count, 1e-3)
    local = np.maximum(local, ROUNDING_VARIANCE)
    pixels = used.sum(axis=1)
    ratio = (residual**2 * used / local).sum(axis=1) / np.maximum(pixels, 1.0)
    ratio = np.where(pixels > MIN_ROW_PIXELS, np.maximum(ratio, 1.0), 1.0)
    return np.asarray(local * ratio[:, None], dtype=np.float32)


def robust_weight(residual: Image, used: Image, variance: Image) -> Image:
    """Weight of each pixel for a residual with Student's t distribution, 1/grey^2."""
    weight = used * (DEGREES + 1.0) / (DEGREES + residual**2 / variance) / variance
    return np.asarray(weight, dtype=np.float32)


def pixels_per_independent(residual: Image, gradient: tuple[Image, Image], weight: Image) -> float:
    """Number of pixels that carry the information of one independent pixel, at least 1.

    The information of a sum over pixels, with the weights of white noise, is too large by the sum over lags of the product of the
    correlations of the residual and of the gradient.
    """
    root = np.sqrt(weight)
    residual_part = _correlation(root * residual)
    taper = 1.0 - np.abs(np.arange(-REACH_PX, REACH_PX + 1)) / (REACH_PX + 1.0)
    window = residual_part * taper[:, None] * taper
    return max(1.0, *(float(np.sum(window * _correlation(root * part))) for part in gradient))


def _correlation(values: Image) -> Array:
    """Autocorrelation at lags up to REACH_PX along both axes."""
    size = [int(fft.next_fast_len(n + REACH_PX, real=True) or n + REACH_PX) for n in values.shape]
    spectrum = np.asarray(fft.rfft2(values, s=size))
    surface = np.asarray(fft.irfft2(np.abs(spectrum) ** 2, s=size), dtype=np.float64)
    lag = np.arange(-REACH_PX, REACH_PX + 1)
    return surface[np.ix_(lag % size[0], lag % size[1])] / max(float(surface[0, 0]), 1e-30)
