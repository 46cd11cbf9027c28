"""What a subset of the reference contributes to every later correlation: sums, Gauss-Newton matrix, its factor.

Affine parameters are ordered (u, du/dx, du/dy, v, dv/dx, dv/dy); the derivative of the reference by them at (dx, dy) from
the centre is (gx, gx dx, gx dy, gy, gy dx, gy dy).
"""

from __future__ import annotations

import numpy as np
from numba import njit

PARAMETERS = 6


@njit(nogil=True, cache=True, error_model="numpy")
def sobel_rows(image, gradient_x, gradient_y, first, last, width):
    """Sobel derivatives (grey per px) of rows first..last-1 of a row-padded image; zero on the frame's edge."""
    height = image.shape[0]
    eighth = np.float32(0.125)
    two = np.float32(2.0)
    for y in range(max(first, 1), min(last, height - 1)):
        above = image[y - 1, :width]
        here = image[y, :width]
        below = image[y + 1, :width]
        out_x = gradient_x[y, :width]
        out_y = gradient_y[y, :width]
        for x in range(1, width - 1):
            out_x[x] = eighth * (above[x + 1] - above[x - 1] + below[x + 1] - below[x - 1] + two * (here[x + 1] - here[x - 1]))
            out_y[x] = eighth * (below[x - 1] - above[x - 1] + below[x + 1] - above[x + 1] + two * (below[x] - above[x]))


# One helper per number of moments: with all sums in one loop the alias checks of 19 arrays defeat vectorising (5x slower).
@njit(nogil=True, cache=True, error_model="numpy")
def _add3(sum0, sum1, sum2, a, b, dy):
    for x in range(sum0.size):
        product = a[x] * b[x]
        sum0[x] += product
        sum1[x] += dy * product
        sum2[x] += dy * dy * product


@njit(nogil=True, cache=True, error_model="numpy")
def _add2(sum0, sum1, a, b, dy):
    for x in range(sum0.size):
        product = a[x] * b[x]
        sum0[x] += product
        sum1[x] += dy * product


@njit(nogil=True, cache=True, error_model="numpy")
def _add1(sum0, a, b):
    for x in range(sum0.size):
        sum0[x] += a[x] * b[x]


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def _moments(values, offsets):
    s0 = np.float32(0.0)
    s1 = np.float32(0.0)
    s2 = np.float32(0.0)
    for k in range(offsets.size):
        v = values[k]
        o = offsets[k]
        s0 += v
        s1 += v * o
        s2 += v * o * o
    return np.float64(s0), np.float64(s1), np.float64(s2)


@njit(nogil=True, cache=True, error_model="numpy")
def _fill_block(matrix, row, column, c0, c1, c2, offsets):
    """One 3x3 block of the Gauss-Newton matrix from column sums weighted with dy^0, dy^1, dy^2."""
    m00, m10, m20 = _moments(c0, offsets)
    m01, m11, _ = _moments(c1, offsets)
    m02, _, _ = _moments(c2, offsets)
    matrix[row, column] = m00
    matrix[row, column + 1] = m10
    matrix[row, column + 2] = m01
    matrix[row + 1, column] = m10
    matrix[row + 1, column + 1] = m20
    matrix[row + 1, column + 2] = m11
    matrix[row + 2, column] = m01
    matrix[row + 2, column + 1] = m11
    matrix[row + 2, column + 2] = m02


@njit(nogil=True, cache=True, error_model="numpy")
def factor(matrix):
    """Cholesky factor in place in the lower triangle; False where the matrix is not positive definite."""
    for j in range(PARAMETERS):
        pivot = matrix[j, j]
        for k in range(j):
            pivot -= matrix[j, k] * matrix[j, k]
        if not pivot > 1e-9 * abs(matrix[j, j]):
            return False
        pivot = np.sqrt(pivot)
        matrix[j, j] = pivot
        for i in range(j + 1, PARAMETERS):
            value = matrix[i, j]
            for k in range(j):
                value -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = value / pivot
    return True


@njit(nogil=True, cache=True, error_model="numpy")
def inverse_diagonal(lower, j):
    """Element (j, j) of the inverse of the matrix whose factor is given."""
    column = np.zeros(PARAMETERS)
    total = 0.0
    for i in range(j, PARAMETERS):
        value = 1.0 if i == j else 0.0
        for k in range(j, i):
            value -= lower[i, k] * column[k]
        column[i] = value / lower[i, i]
        total += column[i] * column[i]
    return total


@njit(nogil=True, cache=True, error_model="numpy")
def _column_sums(image, gradient_x, gradient_y, ones, sums, y_centre, half):
    sums[:] = np.float32(0.0)
    for y in range(y_centre - half, y_centre + half + 1):
        dy = np.float32(y - y_centre)
        f, gx, gy = image[y], gradient_x[y], gradient_y[y]
        _add3(sums[0], sums[1], sums[2], gx, gx, dy)
        _add3(sums[3], sums[4], sums[5], gx, gy, dy)
        _add3(sums[6], sums[7], sums[8], gy, gy, dy)
        _add2(sums[9], sums[10], gx, f, dy)
        _add2(sums[11], sums[12], gy, f, dy)
        _add2(sums[13], sums[14], gx, ones, dy)
        _add2(sums[15], sums[16], gy, ones, dy)
        _add1(sums[17], f, ones)
        _add1(sums[18], f, f)


@njit(nogil=True, cache=True, error_model="numpy")
def sum_row(
    image,
    gradient_x,
    gradient_y,
    y_centre,
    x0,
    step,
    half,
    mean,
    norm,
    gradient_sum,
    gradient_image_sum,
    lower,
    variance_u,
    variance_v,
    sssig,
):
    """Fill one row of POI.

    Per POI: `mean` and `norm` (root of the centred sum of squares) of the subset, the sums of the 6 derivatives, their sums
    with the centred image, the Cholesky factor of the Gauss-Newton matrix, the variances of u and v for unit noise, and
    `sssig`, the smaller eigenvalue of the 2x2 sum of squared gradients. A matrix that cannot be factored leaves
    `variance_u` zero.
    """
    size = 2 * half + 1
    pixels = float(size * size)
    offsets = np.arange(-half, half + 1).astype(np.float32)
    ones = np.ones(image.shape[1], dtype=np.float32)
    sums = np.empty((19, image.shape[1]), dtype=np.float32)
    _column_sums(image, gradient_x, gradient_y, ones, sums, y_centre, half)
    for i in range(mean.size):
        low = x0 + i * step - half
        c = sums[:, low : low + size]
        total, _, _ = _moments(c[17], offsets)
        square, _, _ = _moments(c[18], offsets)
        mean[i] = total / pixels
        norm[i] = np.sqrt(max(square - total * mean[i], 0.0))
        for axis in range(2):
            s0, s1, _ = _moments(c[13 + 2 * axis], offsets)
            s2, _, _ = _moments(c[14 + 2 * axis], offsets)
            f0, f1, _ = _moments(c[9 + 2 * axis], offsets)
            f2, _, _ = _moments(c[10 + 2 * axis], offsets)
            at = 3 * axis
            gradient_sum[i, at] = s0
            gradient_sum[i, at + 1] = s1
            gradient_sum[i, at + 2] = s2
            gradient_image_sum[i, at] = f0 - mean[i] * s0
            gradient_image_sum[i, at + 1] = f1 - mean[i] * s1
            gradient_image_sum[i, at + 2] = f2 - mean[i] * s2
        matrix = lower[i]
        _fill_block(matrix, 0, 0, c[0], c[1], c[2], offsets)
        _fill_block(matrix, 3, 0, c[3], c[4], c[5], offsets)
        _fill_block(matrix, 3, 3, c[6], c[7], c[8], offsets)
        xx, xy, yy = matrix[0, 0], matrix[3, 0], matrix[3, 3]
        sssig[i] = 0.5 * (xx + yy) - np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
        if factor(matrix):
            variance_u[i] = inverse_diagonal(matrix, 0)
            variance_v[i] = inverse_diagonal(matrix, 3)
        else:
            variance_u[i] = 0.0
            variance_v[i] = 0.0
