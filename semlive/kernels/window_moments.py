"""Sums over a square window around every point of a grid, with powers of the distance from its centre."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from semlive.kernels.arrays import checked


def powers(order: int) -> tuple[tuple[int, int], ...]:
    """Powers (a, b) of the distance along x and along y up to an order, as `window_moments` has them."""
    return tuple((a, b) for b in range(order + 1) for a in range(order + 1 - b))


def window_moments(value: NDArray[np.float64], half: int, order: int) -> NDArray[np.float64]:
    """(k, ny, nx) sums of ``value * dx^a * dy^b`` over the window of each point, for all `powers` (a, b) up to an order.

    Args:
        value: (ny, nx); what lies beyond the edge counts as zero.
        half: points on either side of the centre.
        order: >= 0.

    Raises:
        ValueError: not such an array.
    """
    checked(value, "value", np.float64, (None, None))
    along_x, total = np.zeros((order + 1, *value.shape)), np.zeros((len(powers(order)), *value.shape))
    _moments(value, half, order, along_x, total)
    return total


@njit(nogil=True, cache=True)
def _moments(value, half, order, along_x, total):
    height, width = value.shape
    for a in range(order + 1):
        for j in range(height):
            row, out = value[j], along_x[a, j]
            for lag in range(-half, half + 1):
                weight = float(lag) ** a
                for i in range(max(0, -lag), min(width, width - lag)):
                    out[i] += weight * row[i + lag]
    k = 0
    for b in range(order + 1):
        for a in range(order + 1 - b):
            for j in range(height):
                out = total[k, j]
                for lag in range(max(-half, -j), min(half, height - 1 - j) + 1):
                    weight, row = float(lag) ** b, along_x[a, j + lag]
                    for i in range(width):
                        out[i] += weight * row[i]
            k += 1
