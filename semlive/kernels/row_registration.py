"""Sums from which every row of a pair is registered, and their door.

For each row and x-segment of the reference the sums of two gradients (instruments), the difference d between the displaced
current image and the reference, and their products: all that a least-squares shift with an offset of its own needs.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from semlive.kernels.arrays import checked
from semlive.kernels.threads import parallel_chunks

MARGIN_PX = 3  # no row or column nearer to the frame's edge: gradients reach 3 px, taps of the spline 2
# Meaning of the last axis of the sums.
COUNT, X, Y, D, XX, XY, YY, XD, YD, DD, V = range(11)
SUMS = 11
_CHUNK = 32


@njit(nogil=True, cache=True, error_model="numpy")
def _smooth_row(field, affine, x0, y0, step, y, out):
    """Displacement along one row: an affine field plus bilinear residuals on the grid's nodes, held constant outside."""
    ny, nx = field.shape
    at_y = min(max((y - y0) / step, 0.0), ny - 1.0)
    j = min(int(at_y), max(ny - 2, 0))
    below = np.float32(at_y - j)
    j1 = min(j + 1, ny - 1)
    for x in range(out.size):
        at_x = min(max((x - x0) / step, 0.0), nx - 1.0)
        i = min(int(at_x), max(nx - 2, 0))
        right = np.float32(at_x - i)
        i1 = min(i + 1, nx - 1)
        top = field[j, i] + right * (field[j, i1] - field[j, i])
        bottom = field[j1, i] + right * (field[j1, i1] - field[j1, i])
        out[x] = np.float32(affine[0] + affine[1] * x + affine[2] * y) + top + below * (bottom - top)


@njit(nogil=True, cache=True, error_model="numpy")
def _spline_at(c, x, y):
    """Cubic B-spline with coefficients c; taps inside are the caller's business."""
    ix, iy = int(np.floor(x)), int(np.floor(y))
    t, s = np.float32(x - ix), np.float32(y - iy)
    one, three, four, six = np.float32(1.0), np.float32(3.0), np.float32(4.0), np.float32(6.0)
    o = one - t
    x0, x3 = o * o * o, t * t * t
    x1 = four + t * t * (three * t - six)
    x2 = six - x0 - x1 - x3
    o = one - s
    y0, y3 = o * o * o, s * s * s
    y1 = four + s * s * (three * s - six)
    y2 = six - y0 - y1 - y3
    a, b, e, h = c[iy - 1], c[iy], c[iy + 1], c[iy + 2]
    total = (
        y0 * (x0 * a[ix - 1] + x1 * a[ix] + x2 * a[ix + 1] + x3 * a[ix + 2])
        + y1 * (x0 * b[ix - 1] + x1 * b[ix] + x2 * b[ix + 1] + x3 * b[ix + 2])
        + y2 * (x0 * e[ix - 1] + x1 * e[ix] + x2 * e[ix + 1] + x3 * e[ix + 2])
        + y3 * (x0 * h[ix - 1] + x1 * h[ix] + x2 * h[ix + 1] + x3 * h[ix + 2])
    )
    return total / np.float32(36.0)


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def _sum_piece(gx, gy, d, used, total):
    """Sums over one piece of a row; all operands are finite, and sums in any order are what makes the loop vectorise."""
    zero = np.float32(0.0)
    n = x = y = s = xx = xy = yy = xd = yd = dd = zero
    for k in range(d.size):
        w = used[k]
        a, b, c = w * gx[k], w * gy[k], d[k]
        n += w
        x += a
        y += b
        s += c
        xx += a * a
        xy += a * b
        yy += b * b
        xd += a * c
        yd += b * c
        dd += c * c
    total[COUNT], total[X], total[Y], total[D] = n, x, y, s
    total[XX], total[XY], total[YY], total[XD], total[YD], total[DD] = xx, xy, yy, xd, yd, dd


@njit(nogil=True, cache=True, error_model="numpy")
def _sum_rows(first, last, f, gx, gy, c, gain, usable, edges, u_nodes, v_nodes, u_affine, v_affine, x0, y0, step, du, dv, sums):
    width = f.shape[1]
    high, wide = c.shape
    u = np.empty(width, dtype=np.float32)
    v = np.empty(width, dtype=np.float32)
    d = np.zeros(width, dtype=np.float32)
    used = np.zeros(width, dtype=np.float32)
    for y in range(first, last):
        _smooth_row(u_nodes, u_affine, x0, y0, step, y, u)
        _smooth_row(v_nodes, v_affine, x0, y0, step, y, v)
        for x in range(edges[0], edges[-1]):
            at_x = x + (u[x] + du[y])
            at_y = y + (v[x] + dv[y])
            if usable[y, x] and 1.0 <= at_x < wide - 2.0 and 1.0 <= at_y < high - 2.0:
                d[x] = gain * _spline_at(c, at_x, at_y) - f[y, x]
                used[x] = np.float32(1.0)
            else:
                d[x] = np.float32(0.0)
                used[x] = np.float32(0.0)
        for k in range(edges.size - 1):
            a, b = edges[k], edges[k + 1]
            _sum_piece(gx[y, a:b], gy[y, a:b], d[a:b], used[a:b], sums[y, k])
            for x in range(a, b):
                sums[y, k, V] += used[x] * (v[x] + dv[y])


def sum_rows(
    reference: NDArray[np.float32],
    gradient_x: NDArray[np.float32],
    gradient_y: NDArray[np.float32],
    coefficients: NDArray[np.float32],
    usable: NDArray[np.bool_],
    edges_px: NDArray[np.int64],
    nodes: tuple[NDArray[np.float32], NDArray[np.float32]],
    affine: tuple[NDArray[np.float64], NDArray[np.float64]],
    lattice_px: tuple[int, int, int],
    shift_px: tuple[NDArray[np.float64], NDArray[np.float64]],
    gain: float,
) -> NDArray[np.float64]:
    """(height, segments, SUMS) sums over every row and segment; rows nearer than MARGIN_PX to the edge are zero.

    Args:
        reference: (height, width) grey levels.
        gradient_x: (height, width) instrument for u.
        gradient_y: (height, width) instrument for v.
        coefficients: (h, w) cubic B-spline coefficients of the current image.
        usable: (height, width) pixels of the reference to be used.
        edges_px: (segments + 1,) ascending columns, at least MARGIN_PX from the edges.
        nodes: u and v, (ny, nx) each: the smooth field at the grid's nodes, its affine part taken off.
        affine: u and v: constant, slope along x, slope along y of that part.
        lattice_px: x0, y0, step of the nodes.
        shift_px: u and v, (height,) each: shifts of the rows found so far.
        gain: factor on the current image.

    Raises:
        ValueError: arrays of wrong dtype, shape or layout.
    """
    checked(reference, "reference", np.float32, (None, None))
    height, width = reference.shape
    for name, array in (("gradient_x", gradient_x), ("gradient_y", gradient_y)):
        checked(array, name, np.float32, (height, width))
    checked(coefficients, "coefficients", np.float32, (None, None))
    checked(usable, "usable", np.bool_, (height, width))
    checked(edges_px, "edges_px", np.int64, (None,))
    if np.any(np.diff(edges_px) < 1) or edges_px[0] < MARGIN_PX or edges_px[-1] > width - MARGIN_PX:
        raise ValueError(f"edges_px must ascend from {MARGIN_PX} to {width - MARGIN_PX}, not {edges_px.tolist()}")
    segments = edges_px.size - 1
    checked(nodes[0], "u nodes", np.float32, (None, None))
    checked(nodes[1], "v nodes", np.float32, nodes[0].shape)
    for axis in range(2):
        checked(affine[axis], "affine", np.float64, (3,))
        checked(shift_px[axis], "shift_px", np.float64, (height,))
    sums = np.zeros((height, segments, SUMS))

    x0_px, y0_px, step_px = (float(value) for value in lattice_px)

    def work(first: int, last: int) -> None:
        _sum_rows(
            first + MARGIN_PX, last + MARGIN_PX, reference, gradient_x, gradient_y, coefficients, np.float32(gain),
            usable, edges_px, nodes[0], nodes[1], affine[0], affine[1], x0_px, y0_px, step_px, shift_px[0], shift_px[1], sums,
        )  # fmt: skip

    parallel_chunks(work, height - 2 * MARGIN_PX, _CHUNK)
    return sums
