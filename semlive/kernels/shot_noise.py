"""Sums of products of gradients with the grey level over each subset, for noise whose variance depends on the grey level."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from semlive.kernels.arrays import ROW_CHUNK
from semlive.kernels.subset_matching.interface import SubsetSums
from semlive.kernels.threads import parallel_chunks

SUMS = 3  # gx gx f, gx gy f, gy gy f


def gradient_grey_sums(reference: SubsetSums) -> NDArray[np.float64]:
    """(3, ny, nx) sums of gx^2 f, gx gy f and gy^2 f over each subset, with the scaled gradients and grey levels of the reference.

    The order of the additions depends on the subset alone, so a part of a frame gives the same bytes as the complete frame.
    """
    r = reference
    out = np.zeros((SUMS, *r.mean.shape))

    def rows(first: int, last: int) -> None:
        _sum_rows(r.planes, first, last, r.x0_px, r.y0_px, r.step_px, r.half_px, out)

    parallel_chunks(rows, r.mean.shape[0], ROW_CHUNK)
    return out


@njit(nogil=True, cache=True, error_model="numpy")
def _add_row(f, gx, gy, xx, xy, yy):
    for i in range(f.size):
        x, y = gx[i], gy[i]
        xx[i] += x * x * f[i]
        xy[i] += x * y * f[i]
        yy[i] += y * y * f[i]


@njit(nogil=True, cache=True, error_model="numpy")
def _sum_rows(planes, first, last, x0, y0, step, half, out):
    """Rows first..last-1 of the points of `out`: columns are summed once for a row of points, then over each subset."""
    nx, size = out.shape[2], 2 * half + 1
    first_column, columns = x0 - half, (nx - 1) * step + size
    sums = np.empty((SUMS, columns), dtype=np.float32)
    for j in range(first, last):
        sums[:] = np.float32(0.0)
        top = y0 + j * step - half
        for y in range(top, top + size):
            row = planes[y]
            _add_row(
                row[0, first_column : first_column + columns],
                row[1, first_column : first_column + columns],
                row[2, first_column : first_column + columns],
                sums[0],
                sums[1],
                sums[2],
            )
        for kind in range(SUMS):
            for i in range(nx):
                total = 0.0
                for k in range(i * step, i * step + size):
                    total += sums[kind, k]
                out[kind, j, i] = total
