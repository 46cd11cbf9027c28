"""What a subset of the reference contributes to every later correlation: sums, Gauss-Newton matrix, its factor.

The derivative of the reference by the affine parameters at (dx, dy) from the centre is (gx, gx dx, gx dy, gy, gy dx, gy dy), by
those of second order (gx dx^2 / 2, gx dx dy, gx dy^2 / 2), then likewise with gy. Images come with zeros where a mask is.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from semlive.kernels.warp import AFFINE, QUADRATIC

# Per derivative of second order beyond the affine ones: axis of the gradient, powers of dx and dy, factor.
AXIS = np.array([0, 0, 0, 1, 1, 1, 0, 0, 0, 1, 1, 1])
POWER_X = np.array([0, 1, 0, 0, 1, 0, 2, 1, 0, 2, 1, 0])
POWER_Y = np.array([0, 0, 1, 0, 0, 1, 0, 1, 2, 0, 1, 2])
FACTOR = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.5, 1.0, 0.5, 0.5, 1.0, 0.5])
AFFINE_SUMS, QUADRATIC_SUMS = 20, 30  # column sums needed


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
def _add_high(sum0, sum1, a, b, factor0, factor1):
    for x in range(sum0.size):
        product = a[x] * b[x]
        sum0[x] += factor0 * product
        sum1[x] += factor1 * product


@njit(nogil=True, cache=True, error_model="numpy")
def _add_scaled(total, a, b, factor):
    for x in range(total.size):
        total[x] += factor * (a[x] * b[x])


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def _power_moment(values, powers):
    total = np.float32(0.0)
    for k in range(powers.size):
        total += values[k] * powers[k]
    return np.float64(total)


@njit(nogil=True, cache=True, error_model="numpy")
def _add_squares(total, square, a):
    for x in range(total.size):
        value = np.float64(a[x])
        total[x] += value
        square[x] += value * value


@njit(nogil=True, cache=True, error_model="numpy")
def _total(values):
    total = 0.0
    for k in range(values.size):
        total += np.float64(values[k])
    return total


@njit(nogil=True, cache=True, error_model="numpy")
def factor(matrix):
    """Cholesky factor in place in the lower triangle; False where the matrix is not positive definite."""
    n = matrix.shape[0]
    for j in range(n):
        pivot = matrix[j, j]
        for k in range(j):
            pivot -= matrix[j, k] * matrix[j, k]
        if not pivot > 1e-9 * abs(matrix[j, j]):
            return False
        pivot = np.sqrt(pivot)
        matrix[j, j] = pivot
        for i in range(j + 1, n):
            value = matrix[i, j]
            for k in range(j):
                value -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = value / pivot
    return True


@njit(nogil=True, cache=True, error_model="numpy")
def inverse_diagonal(lower, j):
    """Element (j, j) of the inverse of the matrix whose factor is given."""
    n = lower.shape[0]
    column = np.zeros(n)
    total = 0.0
    for i in range(j, n):
        value = 1.0 if i == j else 0.0
        for k in range(j, i):
            value -= lower[i, k] * column[k]
        column[i] = value / lower[i, i]
        total += column[i] * column[i]
    return total


@njit(nogil=True, cache=True, error_model="numpy")
def _column_sums(image, gradient_x, gradient_y, valid, sums, squares, y_centre, half):
    """Sums over the subset's rows, column by column; `sums` is as long as `AFFINE_SUMS` or `QUADRATIC_SUMS`.

    `squares`, those of the image and its square, are float64: the norm is a small difference of them where grey levels are far
    from the frame's mean (float32: 4e-5 of ZNCC at eight times the contrast).
    """
    sums[:] = np.float32(0.0)
    squares[:] = 0.0
    ones = np.ones(image.shape[1], dtype=np.float32)
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
        _add_squares(squares[0], squares[1], f)
        if valid.shape[0] > 0:
            _add1(sums[19], valid[y], ones)
        if sums.shape[0] == QUADRATIC_SUMS:
            square = dy * dy
            _add_high(sums[20], sums[21], gx, gx, square * dy, square * square)
            _add_high(sums[22], sums[23], gx, gy, square * dy, square * square)
            _add_high(sums[24], sums[25], gy, gy, square * dy, square * square)
            _add_scaled(sums[26], gx, f, square)
            _add_scaled(sums[27], gy, f, square)
            _add_scaled(sums[28], gx, ones, square)
            _add_scaled(sums[29], gy, ones, square)


@njit(nogil=True, cache=True, error_model="numpy")
def _gradient_sum(c, axis, power_y):
    """Column sums of a gradient times dy^power_y."""
    return c[28 + axis] if power_y == 2 else c[13 + 2 * axis + power_y]


@njit(nogil=True, cache=True, error_model="numpy")
def _gradient_image_sum(c, axis, power_y):
    return c[26 + axis] if power_y == 2 else c[9 + 2 * axis + power_y]


@njit(nogil=True, cache=True, error_model="numpy")
def _fill_quadratic(matrix, c, powers):
    """The 12 x 12 Gauss-Newton matrix of a second-order shape function."""
    table = np.empty((3, 5, 5))
    for pair in range(3):
        for power_y in range(5):
            columns = c[3 * pair + power_y] if power_y < 3 else c[20 + 2 * pair + power_y - 3]
            for power_x in range(5 - power_y):
                table[pair, power_x, power_y] = _power_moment(columns, powers[power_x])
    for k in range(QUADRATIC):
        for m in range(k + 1):
            value = table[AXIS[k] + AXIS[m], POWER_X[k] + POWER_X[m], POWER_Y[k] + POWER_Y[m]]
            matrix[k, m] = matrix[m, k] = FACTOR[k] * FACTOR[m] * value


@njit(nogil=True, cache=True, error_model="numpy")
def sum_row(
    image, gradient_x, gradient_y, valid, y_centre, x0, step, half, pixels, mean, norm, gradient_sum, gradient_image_sum, lower,
    variance_u, variance_v, sssig,
):  # fmt: skip
    """Fill one row of POI; `valid` is an image of 0 and 1, or empty if all pixels are.

    Per POI: `pixels` that are valid, their `mean` and `norm` (root of the centred sum of squares), the sums of the
    derivatives, their sums with the centred image, the Cholesky factor of the Gauss-Newton matrix, the variances of u and v
    for unit noise, and `sssig`, the smaller eigenvalue of the 2x2 sum of squared gradients. A matrix that cannot be factored
    leaves `variance_u` zero.
    """
    size = 2 * half + 1
    count = gradient_sum.shape[1]
    offsets = np.arange(-half, half + 1).astype(np.float32)
    powers = np.ones((5, size), dtype=np.float32)
    for k in range(1, 5):
        powers[k] = powers[k - 1] * offsets
    sums = np.empty((AFFINE_SUMS if count == AFFINE else QUADRATIC_SUMS, image.shape[1]), dtype=np.float32)
    squares = np.empty((2, image.shape[1]))
    _column_sums(image, gradient_x, gradient_y, valid, sums, squares, y_centre, half)
    for i in range(mean.size):
        low = x0 + i * step - half
        c = sums[:, low : low + size]
        pixels[i] = _total(c[19]) if valid.shape[0] > 0 else float(size * size)
        total = _total(squares[0, low : low + size])
        mean[i] = total / max(pixels[i], 1.0)
        norm[i] = np.sqrt(max(_total(squares[1, low : low + size]) - total * mean[i], 0.0))
        for k in range(count):
            power_x, power_y = POWER_X[k], POWER_Y[k]
            s = FACTOR[k] * _power_moment(_gradient_sum(c, AXIS[k], power_y), powers[power_x])
            gradient_sum[i, k] = s
            t = FACTOR[k] * _power_moment(_gradient_image_sum(c, AXIS[k], power_y), powers[power_x])
            gradient_image_sum[i, k] = t - mean[i] * s
        matrix = lower[i]
        if count == AFFINE:
            _fill_block(matrix, 0, 0, c[0], c[1], c[2], offsets)
            _fill_block(matrix, 3, 0, c[3], c[4], c[5], offsets)
            _fill_block(matrix, 3, 3, c[6], c[7], c[8], offsets)
        else:
            _fill_quadratic(matrix, c, powers)
        xx, xy, yy = matrix[0, 0], matrix[3, 0], matrix[3, 3]
        sssig[i] = 0.5 * (xx + yy) - np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
        if factor(matrix):
            variance_u[i] = inverse_diagonal(matrix, 0)
            variance_v[i] = inverse_diagonal(matrix, 3)
        else:
            variance_u[i] = 0.0
            variance_v[i] = 0.0
