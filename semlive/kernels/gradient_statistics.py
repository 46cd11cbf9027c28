"""How well Sobel's derivative follows the interpolating spline's along lines of an image, and its grey levels about their mean."""

from __future__ import annotations

import numpy as np
from numba import njit

from semlive.kernels.arrays import copy_line
from semlive.kernels.splines.spline import ROWS_PER_BATCH, filter_rows


@njit(nogil=True, cache=True, error_model="numpy")
def _take(image, axis, first, step, count, lines):
    """Fill the first `count` of `lines`: rows of an image (axis 1) or columns (axis 0), from `first` on, every `step`-th."""
    if axis == 1:
        for k in range(count):
            copy_line(lines[k], image[first + k * step])
    else:
        for x in range(lines.shape[1]):
            for k in range(count):
                lines[k, x] = image[x, first + k * step]


@njit(nogil=True, cache=True, error_model="numpy")
def _multiply(before, here, after, c, usable, with_spline, squared):
    """Sobel's derivative along one line times that of the spline with coefficients `c`, and its square, at the inner samples."""
    eighth, two, half = np.float32(0.125), np.float32(2.0), np.float32(0.5)
    for x in range(1, here.size - 1):
        sobel = before[x + 1] - before[x - 1] + after[x + 1] - after[x - 1]
        sobel = eighth * (sobel + two * (here[x + 1] - here[x - 1])) * usable[x]
        with_spline[x] = sobel * (half * (c[x + 1] - c[x - 1]))
        squared[x] = sobel * sobel


@njit(nogil=True, cache=True, error_model="numpy")
def gradient_products(image, step, axis, usable, z, gain):
    """Means of Sobel's derivative along every `step`-th line times the spline's, and of its square; it is zero where `usable` is.

    A few lines at a time, which stay in the processor's cache; `z` and `gain` are the spline's pole and gain.
    """
    count, length = image.shape[1 - axis], image.shape[axis]
    n = (count - 2 + step - 1) // step
    before = np.empty((ROWS_PER_BATCH, length), dtype=np.float32)
    here, after, c = np.empty_like(before), np.empty_like(before), np.empty_like(before)
    counted = np.ones_like(before)
    with_spline, squared = np.empty(length, dtype=np.float32), np.empty(length, dtype=np.float32)
    overlap = energy = 0.0
    for first in range(0, n, ROWS_PER_BATCH):
        some = min(ROWS_PER_BATCH, n - first)
        at = first * step
        _take(image, axis, at, step, some, before)
        _take(image, axis, at + 1, step, some, here)
        _take(image, axis, at + 2, step, some, after)
        if usable.size > 0:
            _take(usable, axis, at + 1, step, some, counted)
        for k in range(some):
            copy_line(c[k], here[k])
        filter_rows(c, 0, some, 0, length, z, gain)
        for k in range(some):
            _multiply(before[k], here[k], after[k], c[k], counted[k], with_spline, squared)
            for x in range(1, length - 1):
                overlap += np.float64(with_spline[x])
                energy += np.float64(squared[x])
    places = max(n * (length - 2), 1)
    return overlap / places, energy / places


@njit(nogil=True, cache=True)
def subtract_mean(image, out):
    """Fill `out` with the grey levels of an image less their mean, both lines of pixels; sums of whole numbers are exact."""
    total = np.uint64(0)
    for k in range(image.size):
        total += np.uint64(image[k])
    mean = np.float32(np.float64(total) / np.float64(image.size))
    for k in range(image.size):
        out[k] = np.float32(image[k]) - mean
