"""Planes through what lies around single points of a map."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from semlive.kernels.arrays import checked

SOFT = 0.05  # variance of place, keeps a plane through a single line of points from tipping


@njit(nogil=True, cache=True, error_model="numpy")
def _fit(u, v, trusted, rows, columns, reach, out):
    ny, nx = trusted.shape
    for k in range(rows.size):
        j, i = rows[k], columns[k]
        n = sx = sy = sxx = sxy = syy = 0.0
        su = sv = sux = suy = svx = svy = 0.0
        for row in range(max(j - reach, 0), min(j + reach + 1, ny)):
            y = float(row - j)
            for column in range(max(i - reach, 0), min(i + reach + 1, nx)):
                if trusted[row, column]:
                    x = float(column - i)
                    a, b = u[row, column], v[row, column]
                    n += 1.0
                    sx += x
                    sy += y
                    sxx += x * x
                    sxy += x * y
                    syy += y * y
                    su += a
                    sv += b
                    sux += a * x
                    suy += a * y
                    svx += b * x
                    svy += b * y
        out[k, :] = 0.0
        if n == 0.0:
            continue
        mx, my = sx / n, sy / n
        xx, xy, yy = sxx / n - mx * mx + SOFT, sxy / n - mx * my, syy / n - my * my + SOFT
        det = xx * yy - xy * xy
        for axis in range(2):
            mean = (su if axis == 0 else sv) / n
            cx = (sux if axis == 0 else svx) / n - mean * mx
            cy = (suy if axis == 0 else svy) / n - mean * my
            along_x, along_y = (yy * cx - xy * cy) / det, (xx * cy - xy * cx) / det
            out[k, axis] = mean - along_x * mx - along_y * my
            out[k, 2 + 2 * axis] = along_x
            out[k, 3 + 2 * axis] = along_y
        out[k, 6] = n


def fit_local_planes(
    u: NDArray[np.float64], v: NDArray[np.float64], trusted: NDArray[np.bool_], at: NDArray[np.bool_], reach: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Least-squares planes of u and v through the trusted points within `reach` (a square), at the n points marked in `at`.

    Args:
        u: (ny, nx) values.
        v: (ny, nx) others.
        trusted: (ny, nx) points that count.
        at: (ny, nx) points to fit planes about.
        reach: points on each side.

    Returns:
        u and v of the planes (n,), their slopes per point (n, 4) as du/dx, du/dy, dv/dx, dv/dy, and how many points were there (n,).

    Raises:
        ValueError: arrays of wrong dtype, shape or layout.
    """
    shape = trusted.shape
    checked(u, "u", np.float64, (None, None))
    checked(v, "v", np.float64, shape)
    checked(trusted, "trusted", np.bool_, u.shape)
    checked(at, "at", np.bool_, shape)
    rows, columns = (np.ascontiguousarray(k) for k in np.nonzero(at))  # views otherwise, for which all would be compiled again
    out = np.zeros((rows.size, 7))
    _fit(u, v, trusted, rows, columns, reach, out)
    return out[:, 0], out[:, 1], out[:, 2:6], out[:, 6]
