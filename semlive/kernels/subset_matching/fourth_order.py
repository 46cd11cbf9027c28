"""Shape function of fourth order: IC-GN that starts from the second-order solution.

The mean over a subset of a weighted least-squares polynomial is a Savitzky-Golay filter of the displacement (Schreier, Sutton 2002,
doi:10.1007/BF02410987). The order determines how sharp its cut-off is, the edge of the subset where it is.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy import uint64

from semlive.kernels.arrays import copy_line
from semlive.kernels.interpolate import SCALE, cubic_at, quintic_at
from semlive.kernels.subset_matching.fourth_order_matrix import (
    DEGREE,
    EXPONENT_X,
    EXPONENT_Y,
    PAIRS,
    POWERS,
    QUARTIC,
    TERMS,
    fill_matrix,
    powers_of,
    term,
)
from semlive.kernels.subset_matching.icgn import (
    CONVERGED,
    INITIAL_LEARNING_RATE,
    LOW_ZNCC,
    MAX_GRADIENT,
    MIN_LEARNING_RATE,
    NOT_CONVERGED,
    OUTSIDE_IMAGE,
)
from semlive.kernels.subset_matching.subsets import factor
from semlive.kernels.subset_matching.warp import solve

SECOND_ORDER = 6  # the first terms, in the order of the parameters of second order
FACTOR = np.array([1.0, 1.0, 1.0, 2.0, 1.0, 2.0])  # derivative over coefficient
CUBIC_GAIN, QUINTIC_GAIN = np.float32(1.0 / SCALE[3]), np.float32(1.0 / SCALE[5])
MAX_SHIFT_PX = 2.0  # from the second-order solution; its attenuation of a wave is a part of the amplitude
BEYOND_EDGE_PX = 0.5  # of the corners of a subset at the edge of the frame, where noise bends them; the spline is mirrored there


@njit(nogil=True, cache=True, error_model="numpy")
def _row_polynomials(p, eta, line):
    """(2, DEGREE + 1): u and v on the row at dy / half = `eta` as polynomials of dx / half."""
    for axis in range(2):
        for n in range(DEGREE + 1):
            value = 0.0
            for k in range(DEGREE - n, -1, -1):
                value = value * eta + p[axis * TERMS + term(n, k)]
            line[axis, n] = np.float32(value)


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def _interpolate_row(c, stride, order, width, height, x, y, row, half, p, mean, g, line, cell, phase_x, phase_y):
    """A row of the deformed subset about (x, y), less `mean`; False if a part of it is outside the frame."""
    size = 2 * half + 1
    _row_polynomials(p, (row - half) / half, line)
    u, v = line[0], line[1]
    u0, u1, u2, u3, u4 = u[0], u[1], u[2], u[3], u[4]
    v0, v1, v2, v3, v4 = v[0], v[1], v[2], v[3], v[4]
    inverse = np.float32(1.0 / half)
    # relative to (x, y): where a subset lies in the frame must not change how its positions are rounded
    low_x, high_x = np.float32(-x - BEYOND_EDGE_PX), np.float32(width - 1 - x + BEYOND_EDGE_PX)
    low_y, high_y = np.float32(-y - BEYOND_EDGE_PX), np.float32(height - 1 - y + BEYOND_EDGE_PX)
    outside = 0
    for i in range(size):
        dx = np.float32(i - half)
        t = dx * inverse
        at_x = dx + (u0 + t * (u1 + t * (u2 + t * (u3 + t * u4))))
        at_y = np.float32(row - half) + (v0 + t * (v1 + t * (v2 + t * (v3 + t * v4))))
        inside_x, inside_y = min(max(at_x, low_x), high_x), min(max(at_y, low_y), high_y)
        outside += (inside_x != at_x) + (inside_y != at_y)
        cell_x, cell_y = np.floor(inside_x), np.floor(inside_y)
        phase_x[i], phase_y[i] = inside_x - cell_x, inside_y - cell_y
        # the border minus the taps before a pixel is 1 for any order
        cell[i] = (y + np.int64(cell_y) + 1) * stride + x + np.int64(cell_x) + 1
    # within a run the taps are contiguous, which the vectoriser needs
    first = 0
    while first < size:
        last = first + 1
        while last < size and cell[last] - cell[first] == last - first:
            last += 1
        tap, to = uint64(cell[first]), uint64(row * size + first)
        if order == 3:
            for i in range(uint64(last - first)):
                k = uint64(first) + i
                g[to + i] = CUBIC_GAIN * cubic_at(c, tap + i, uint64(stride), phase_x[k], phase_y[k]) - mean
        else:
            for i in range(uint64(last - first)):
                k = uint64(first) + i
                g[to + i] = QUINTIC_GAIN * quintic_at(c, tap + i, uint64(stride), phase_x[k], phase_y[k]) - mean
        first = last
    return outside == 0


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def _image_sums(planes, valid, pitch, x, y, half, mean, g, total):
    """`total` = (g, g g, g f) of the deformed subset; sets masked pixels of g to zero."""
    size = 2 * half + 1
    total[:] = 0.0
    for row in range(size):
        line = y - half + row
        pixel = uint64(line * 3 * pitch + x - half)
        if valid.size > 0:
            for i in range(size):
                g[row * size + i] *= valid[line * pitch + x - half + i]
        s0 = s1 = s2 = np.float32(0.0)
        for i in range(size):
            value = g[row * size + i]
            s0 += value
            s1 += value * value
            s2 += value * (planes[pixel + uint64(i)] - mean)
        total[0] += s0
        total[1] += s1
        total[2] += s2


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def _project(planes, pitch, x, y, half, powers, mean, g, g_mean, ratio, b):
    """`b` = the residual times the derivatives of the reference; the gradients are zero in masked pixels."""
    size = 2 * half + 1
    b[:] = 0.0
    residual = np.empty((2, size), dtype=np.float32)
    for row in range(size):
        pixel = uint64((y - half + row) * 3 * pitch + x - half)
        for i in range(size):
            k = pixel + uint64(i)
            r = ratio * (g[row * size + i] - g_mean) - (planes[k] - mean)
            residual[0, i] = r * planes[k + uint64(pitch)]
            residual[1, i] = r * planes[k + uint64(2 * pitch)]
        for axis in range(2):
            for n in range(DEGREE + 1):
                total = np.float32(0.0)
                for i in range(size):
                    total += residual[axis, i] * powers[n, i]
                value = np.float64(total)
                for k in range(DEGREE + 1 - n):
                    b[axis * TERMS + term(n, k)] += value
                    value *= (row - half) / half


@njit(nogil=True, cache=True, error_model="numpy")
def _compose_inverse(p, d, half, old):
    """W(p) <- W(p) o W(d)^-1 to first order in d, terms above the degree dropped; exact where the iteration ends, at d = 0."""
    copy_line(old, p)
    for k in range(QUARTIC):
        p[k] -= d[k]
    for axis in range(2):
        for k in range(1, TERMS):
            a, b = EXPONENT_X[k], EXPONENT_Y[k]
            coefficient = old[axis * TERMS + k] / half
            for m in range(TERMS):
                ma, mb = a + EXPONENT_X[m], b + EXPONENT_Y[m]
                if ma + mb - 1 > DEGREE:
                    continue
                if a > 0:
                    p[axis * TERMS + term(ma - 1, mb)] -= coefficient * a * d[m]
                if b > 0:
                    p[axis * TERMS + term(ma, mb - 1)] -= coefficient * b * d[TERMS + m]


@njit(nogil=True, cache=True, error_model="numpy")
def _strayed(p, start_u, start_v, half):
    if not abs(p[0] - start_u) + abs(p[TERMS] - start_v) <= MAX_SHIFT_PX:
        return True
    largest = 0.0
    for k in range(1, TERMS):
        largest = max(largest, abs(p[k]), abs(p[TERMS + k]))
    return not largest <= MAX_GRADIENT * half


@njit(nogil=True, cache=True, error_model="numpy")
def _largest_motion(d):
    """Upper bound of the displacement over a subset."""
    u = v = 0.0
    for k in range(TERMS):
        u += abs(d[k])
        v += abs(d[TERMS + k])
    return np.hypot(u, v)


@njit(nogil=True, cache=True, error_model="numpy")
def refine_rows(
    first, last, c, stride_c, order, planes, valid, pitch, width, y0, x0, step, half, pixels, mean, norm, max_iterations, tolerance_px,
    min_zncc, affine, curvature, zncc, status, iterations,
):  # fmt: skip
    """Refine the converged points of rows first..last-1 of POI; images as for `icgn.correlate_row`.

    `affine`, (ny, nx, 6), and `curvature`, (ny, nx, 6), are the second-order solutions, and become the derivatives of the solution of
    fourth order at the centre. Points that do not converge get another status. The criterion of convergence is that of `correlate_row`.
    """
    size = 2 * half + 1
    height = c.size // stride_c - 2 * (order // 2 + 1)
    powers = np.zeros((POWERS, size))
    powers_of(half, powers)
    single = powers.astype(np.float32)
    products = np.zeros(PAIRS * size, dtype=np.float32)
    sums = np.zeros(PAIRS * POWERS * size, dtype=np.float32)
    moments = np.zeros((PAIRS, POWERS, POWERS))
    matrix = np.zeros((QUARTIC, QUARTIC))
    g = np.zeros(size * size, dtype=np.float32)
    line = np.zeros((2, DEGREE + 1), dtype=np.float32)
    cell = np.zeros(size, dtype=np.int64)
    phase_x, phase_y = np.zeros(size, dtype=np.float32), np.zeros(size, dtype=np.float32)
    total, p, d, old = np.zeros(3), np.zeros(QUARTIC), np.zeros(QUARTIC), np.zeros(QUARTIC)
    for j in range(first, last):
        y = y0 + j * step
        for i in range(status.shape[1]):
            if status[j, i] != CONVERGED:
                continue
            x = x0 + i * step
            fill_matrix(planes, pitch, (y - half) * 3 * pitch + x - half, half, powers, products, sums, moments, matrix)
            status[j, i] = NOT_CONVERGED
            if not factor(matrix):
                continue
            p[:] = 0.0
            for axis in range(2):
                for k in range(SECOND_ORDER):
                    value = affine[j, i, 3 * axis + k] if k < 3 else curvature[j, i, 3 * axis + k - 3]
                    p[axis * TERMS + k] = value * float(half) ** (EXPONENT_X[k] + EXPONENT_Y[k]) / FACTOR[k]
            start_u, start_v = p[0], p[TERMS]
            centre = np.float32(mean[j, i])
            previous = 0.0
            for spent in range(max_iterations):
                inside = True
                for row in range(size):
                    here = _interpolate_row(
                        c, stride_c, order, width, height, x, y, row, half, p, centre, g, line, cell, phase_x, phase_y
                    )  # fmt: skip
                    inside = inside and here
                if not inside:
                    status[j, i] = OUTSIDE_IMAGE
                    break
                iterations[j, i] += 1
                _image_sums(planes, valid, pitch, x, y, half, centre, g, total)
                g_mean = total[0] / pixels[j, i]
                g_norm = np.sqrt(max(total[1] - total[0] * g_mean, 0.0))
                if not g_norm > 1e-6 * norm[j, i]:
                    status[j, i] = LOW_ZNCC
                    break
                zncc[j, i] = (total[2] - total[0] * (mean[j, i] - np.float64(centre))) / (norm[j, i] * g_norm)
                ratio = np.float32(norm[j, i] / g_norm)
                _project(planes, pitch, x, y, half, single, np.float32(mean[j, i]), g, np.float32(g_mean), ratio, d)
                solve(matrix, d)
                _compose_inverse(p, d, float(half), old)
                if _strayed(p, start_u, start_v, half):
                    break
                moved = _largest_motion(d)
                rate = INITIAL_LEARNING_RATE if spent == 0 else min(moved / previous, 1.0)
                previous = moved
                if 4.0 * max(rate, MIN_LEARNING_RATE) * moved <= tolerance_px:
                    status[j, i] = CONVERGED if zncc[j, i] >= min_zncc else LOW_ZNCC
                    break
            for axis in range(2):
                for k in range(SECOND_ORDER):
                    value = p[axis * TERMS + k] * FACTOR[k] / float(half) ** (EXPONENT_X[k] + EXPONENT_Y[k])
                    if k < 3:
                        affine[j, i, 3 * axis + k] = value
                    else:
                        curvature[j, i, 3 * axis + k - 3] = value
