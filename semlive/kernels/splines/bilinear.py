"""Fields of one grid between its points: bilinear in the cell that a place lies in."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from semlive.kernels.arrays import checked

Field = NDArray[np.float64]


def interpolate_bilinear(
    x: Field, y: Field, fields: Field, status: NDArray[np.uint8]
) -> tuple[Field, Field, NDArray[np.uint8], NDArray[np.bool_]]:
    """Fields at places between their points.

    Args:
        x: (n,) place along columns, in points; what lies outside counts as at the edge.
        y: (n,) along rows.
        fields: (k, ny, nx) values at the points.
        status: (ny, nx) of the points.

    Returns:
        (k, n) values at the places; (2, n) how far the corners of the cell differ in the first two fields; (n,) the largest status of the
        corners; (n,) whether it is 0 at all of them.

    Raises:
        ValueError: an array is of another type or shape.
    """
    checked(x, "x", np.float64, (None,))
    checked(y, "y", np.float64, x.shape)
    checked(fields, "fields", np.float64, (None, None, None))
    checked(status, "status", np.uint8, fields.shape[1:])
    if len(fields) < 2 or not status.size:
        raise ValueError("fields must be two at least, with a point at least")
    value, spread = np.empty((len(fields), len(x))), np.empty((2, len(x)))
    worst, sound = np.empty(len(x), dtype=np.uint8), np.empty(len(x), dtype=np.bool_)
    _cells(x, y, fields, status, value, spread, worst, sound)
    return value, spread, worst, sound


@njit(nogil=True, cache=True)
def _cells(x, y, fields, status, value, spread, worst, sound):
    count, ny, nx = fields.shape
    for point in range(x.size):
        # A place that is no number is at the first point.
        i = int(min(max(np.floor(x[point]), 0.0), max(nx - 2, 0))) if x[point] == x[point] else 0
        j = int(min(max(np.floor(y[point]), 0.0), max(ny - 2, 0))) if y[point] == y[point] else 0
        i1, j1 = min(i + 1, nx - 1), min(j + 1, ny - 1)
        tx, ty = min(max(x[point] - i, 0.0), 1.0), min(max(y[point] - j, 0.0), 1.0)
        w00, w01, w10, w11 = (1 - ty) * (1 - tx), (1 - ty) * tx, ty * (1 - tx), ty * tx
        for k in range(count):
            a, b, c, d = fields[k, j, i], fields[k, j, i1], fields[k, j1, i], fields[k, j1, i1]
            value[k, point] = w00 * a + w01 * b + w10 * c + w11 * d
            if k < 2:
                spread[k, point] = max(a, b, c, d) - min(a, b, c, d)
        worst[point] = max(status[j, i], status[j, i1], status[j1, i], status[j1, i1])
        sound[point] = worst[point] == 0
