"""Both components of a bicubic surface with knots of its own at points: the values of `RectBivariateSpline.ev` of scipy.

That function takes one component at a time, and three times as long for both. On x86-64 the values are equal to the last bit.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from semlive.kernels.arrays import checked

Field = NDArray[np.float64]
TERMS = 4


def evaluate_cubic_surface(knots_y: Field, knots_x: Field, surface: Field, y: Field, x: Field) -> Field:
    """(n, 2) both components at points; beyond the outermost knots those of the nearest point on the edge.

    Args:
        knots_y: (ny + 4,) knots along y, ascending, the outermost four times.
        knots_x: (nx + 4,) along x, likewise.
        surface: (2, ny, nx) coefficients of each component.
        y: (n,) where.
        x: (n,) where.

    Raises:
        ValueError: an array is of another type or shape.
    """
    checked(knots_y, "knots_y", np.float64, (None,))
    checked(knots_x, "knots_x", np.float64, (None,))
    if min(len(knots_y), len(knots_x)) < 2 * TERMS:
        raise ValueError(f"a cubic needs {2 * TERMS} knots along each axis or more")
    checked(surface, "surface", np.float64, (2, len(knots_y) - TERMS, len(knots_x) - TERMS))
    checked(y, "y", np.float64, (None,))
    checked(x, "x", np.float64, y.shape)
    total = np.empty((len(y), 2))
    _surface(knots_y, knots_x, surface, y, x, total)
    return total


@njit(nogil=True, cache=True)
def _surface(knots_y, knots_x, surface, y, x, total):
    along_y, along_x, scratch = np.empty(4), np.empty(4), np.empty(4)
    for point in range(y.size):
        low_y = _terms(knots_y, y[point], along_y, scratch)
        low_x = _terms(knots_x, x[point], along_x, scratch)
        first, second = 0.0, 0.0
        for i in range(4):
            for j in range(4):  # the order of both products is that of scipy
                first += surface[0, low_y + i, low_x + j] * along_y[i] * along_x[j]
                second += surface[1, low_y + i, low_x + j] * along_y[i] * along_x[j]
        total[point, 0] = first
        total[point, 1] = second


@njit(nogil=True, cache=True)
def _terms(knots, position, value, scratch):
    """The first of the four terms that are not zero at a position, and their values, by the recurrence of de Boor and Cox."""
    low, high = 3, knots.size - 4
    at = min(max(position, knots[low]), knots[high])
    while high - low > 1:
        middle = (low + high) // 2
        if at < knots[middle]:
            high = middle
        else:
            low = middle
    value[0] = 1.0
    for degree in range(1, 4):
        for i in range(degree):
            scratch[i] = value[i]
        value[0] = 0.0
        for i in range(degree):
            right, left = knots[low + i + 1], knots[low + i + 1 - degree]
            if right == left:
                value[i + 1] = 0.0
            else:
                factor = scratch[i] / (right - left)
                value[i] += factor * (right - at)
                value[i + 1] = factor * (at - left)
    return low - 3
