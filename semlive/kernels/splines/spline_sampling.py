"""Cubic spline image at arbitrary positions: value and derivatives along x and y."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from semlive.kernels.arrays import checked, lines_at_once
from semlive.kernels.threads import parallel_chunks

Image = NDArray[np.float32]


def sample(coefficients: Image, x_px: Image, y_px: Image) -> tuple[Image, Image, Image, NDArray[np.bool_]]:
    """Value and derivatives of a cubic spline image at given positions.

    Args:
        coefficients: (height, width) from `images.coefficients`, cubic.
        x_px: (ny, nx) columns of the positions.
        y_px: (ny, nx) rows of the positions.

    Returns:
        Value in grey levels, derivative along x and along y in grey levels per px, and True where the position lies between the
        second and the last but one sample along both axes; the other three are zero elsewhere. (ny, nx) each.

    Raises:
        ValueError: an array is of another type, shape or layout.
    """
    checked(coefficients, "coefficients", np.float32, (None, None))
    checked(x_px, "x_px", np.float32, (None, None))
    checked(y_px, "y_px", np.float32, x_px.shape)
    value, along_x, along_y = (np.zeros_like(x_px) for _ in range(3))
    inside = np.zeros(x_px.shape, dtype=np.bool_)
    arrays = (coefficients, x_px, y_px, value, along_x, along_y, inside)
    parallel_chunks(lambda first, last: _rows(first, last, *arrays), x_px.shape[0], lines_at_once(x_px.shape[1]))
    return value, along_x, along_y, inside


@njit(nogil=True, cache=True, error_model="numpy")
def _weights(t, value, slope):
    """Four weights of the cubic B-spline at phase t in 0..1, and of its derivative."""
    o = np.float32(1.0) - t
    half, three, four, six = np.float32(0.5), np.float32(3.0), np.float32(4.0), np.float32(6.0)
    value[0] = o * o * o / six
    value[1] = (four + t * t * (three * t - six)) / six
    value[2] = (four + o * o * (three * o - six)) / six
    value[3] = t * t * t / six
    slope[0] = -half * o * o
    slope[1] = half * t * (three * t - four)
    slope[2] = -half * o * (three * o - four)
    slope[3] = half * t * t


@njit(nogil=True, cache=True, error_model="numpy")
def _rows(first, last, c, x_px, y_px, value, along_x, along_y, inside):
    height, width = c.shape
    wx, sx = np.empty(4, np.float32), np.empty(4, np.float32)
    wy, sy = np.empty(4, np.float32), np.empty(4, np.float32)
    for j in range(first, last):
        for i in range(x_px.shape[1]):
            x, y = x_px[j, i], y_px[j, i]
            if not (x >= 1.0 and y >= 1.0 and x < width - 2 and y < height - 2):
                continue
            column, row = int(x), int(y)
            _weights(np.float32(x - column), wx, sx)
            _weights(np.float32(y - row), wy, sy)
            grey, dx, dy = np.float32(0.0), np.float32(0.0), np.float32(0.0)
            for n in range(4):
                across, steep = np.float32(0.0), np.float32(0.0)
                for m in range(4):
                    k = c[row - 1 + n, column - 1 + m]
                    across += wx[m] * k
                    steep += sx[m] * k
                grey += wy[n] * across
                dx += wy[n] * steep
                dy += sy[n] * across
            value[j, i], along_x[j, i], along_y[j, i] = grey, dx, dy
            inside[j, i] = True
