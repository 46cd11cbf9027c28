"""What a subset of the reference contributes to every later correlation: sums, Gauss-Newton matrix, its factor.

The derivative of the reference by the affine parameters at (dx, dy) from the centre is (gx, gx dx, gx dy, gy, gy dx, gy dy), by
those of second order (gx dx^2 / 2, gx dx dy, gx dy^2 / 2), then likewise with gy. Images come with zeros where a mask is.

Sums over a subset are taken in two steps. Products are summed over the subset's rows, column by column, once for a row of POI,
`BLOCK` columns at a time, so that the running sums stay in the nearest cache at places the vectoriser knows not to overlap.
They are laid out by the column's remainder on division by the step: then the k-th column of all the row's subsets is a stretch
of memory, and columns are summed for all subsets at once instead of one by one (23 ms of processor time in place of 43).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy import uint64

from semlive.kernels.arrays import copy_line
from semlive.kernels.interpolate import EIGHT
from semlive.kernels.subset_matching.warp import AFFINE

# Per derivative of second order beyond the affine ones: axis of the gradient, powers of dx and dy, factor.
AXIS = np.array([0, 0, 0, 1, 1, 1, 0, 0, 0, 1, 1, 1])
POWER_X = np.array([0, 1, 0, 0, 1, 0, 2, 1, 0, 2, 1, 0])
POWER_Y = np.array([0, 0, 1, 0, 0, 1, 0, 1, 2, 0, 1, 2])
FACTOR = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.5, 1.0, 0.5, 0.5, 1.0, 0.5])
BLOCK = 256  # columns, a constant
AFFINE_COLUMN_SUMS, QUADRATIC_SUMS = 18, 28  # column sums of float32
# Their places: pairs gx gx, gx gy, gy gy by three powers of dy each; gx f, gy f, gx, gy by two; valid; the rest for second order.
PRODUCT, WITH_IMAGE, ALONE, VALID, PRODUCT_HIGH, WITH_IMAGE_HIGH, ALONE_HIGH = 0, 9, 13, 17, 18, 24, 26
POWERS = 5  # of dx and dy in the products of second order
TOP_AFFINE = np.array([2, 1, 0, 2, 1, 0, 2, 1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 0])  # power of dx of each sum
TOP_QUADRATIC = np.array([4, 3, 2, 4, 3, 2, 4, 3, 2, 2, 1, 2, 1, 2, 1, 2, 1, 0, 1, 0, 1, 0, 1, 0, 0, 0, 0, 0])


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


@njit(nogil=True, cache=True, error_model="numpy")
def noise_stencils(image, step, out):
    """Fill `out` with the amounts of the second difference both ways along every `step`-th line, zeros left out; how many there are."""
    height, width = image.shape
    two = np.float32(2.0)
    across = np.empty(width, dtype=np.float32)
    n = 0
    for y in range(0, height - 2, step):
        above, here, below = image[y], image[y + 1], image[y + 2]
        for x in range(width):
            across[x] = above[x] - two * here[x] + below[x]
        for x in range(width - 2):
            amount = abs(across[x] - two * across[x + 1] + across[x + 2])
            out[n] = amount
            n += amount > 0.0
    return n


@njit(nogil=True, cache=True, error_model="numpy")
def fill_planes(image, weights, planes, first, last, gain_x, gain_y):
    """Rows first..last-1 of `planes`: grey levels and scaled Sobel derivatives of an image, zero in the padding and where `weights` is.

    The derivatives are those of `sobel_rows`, written directly to their destination, without a temporary image.
    """
    height, width = image.shape
    eighth, two, zero = np.float32(0.125), np.float32(2.0), np.float32(0.0)
    for y in range(first, last):
        here = image[y]
        grey, out_x, out_y = planes[y, 0], planes[y, 1], planes[y, 2]
        copy_line(grey[:width], here)
        grey[width:] = zero
        out_x[width - 1 :] = zero
        out_y[width - 1 :] = zero
        if y == 0 or y == height - 1:
            out_x[:] = zero
            out_y[:] = zero
        else:
            above, below = image[y - 1], image[y + 1]
            out_x[0] = out_y[0] = zero
            for x in range(1, width - 1):
                across = eighth * (above[x + 1] - above[x - 1] + below[x + 1] - below[x - 1] + two * (here[x + 1] - here[x - 1]))
                down = eighth * (below[x - 1] - above[x - 1] + below[x + 1] - above[x + 1] + two * (below[x] - above[x]))
                out_x[x] = gain_x * across
                out_y[x] = gain_y * down
        if weights.size > 0:
            valid = weights[y]
            for x in range(width):
                grey[x] *= valid[x]
                out_x[x] *= valid[x]
                out_y[x] *= valid[x]


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
def inverse_diagonal(lower, j, column):
    """Element (j, j) of the inverse of the matrix whose factor is given; `column` becomes that of the inverse factor, from j on."""
    n = lower.shape[0]
    total = 0.0
    for i in range(j, n):
        value = 1.0 if i == j else 0.0
        for k in range(j, i):
            value -= lower[i, k] * column[k]
        column[i] = value / lower[i, i]
        total += column[i] * column[i]
    return total


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def _add_rows(planes, pitch, at, size, count, sums):
    """Affine column sums of `count` columns over `size` rows; `at` is the place of the first pixel of the first row."""
    b = uint64(BLOCK)
    for row in range(size):
        dy = np.float32(row - size // 2)
        pixel = at + uint64(row) * uint64(3) * pitch
        for i in range(count // EIGHT * EIGHT):
            f = planes[pixel + i]
            gx = planes[pixel + pitch + i]
            gy = planes[pixel + pitch + pitch + i]
            xx, xy, yy = gx * gx, gx * gy, gy * gy
            sums[i] += xx
            sums[b + i] += dy * xx
            sums[uint64(2) * b + i] += dy * dy * xx
            sums[uint64(3) * b + i] += xy
            sums[uint64(4) * b + i] += dy * xy
            sums[uint64(5) * b + i] += dy * dy * xy
            sums[uint64(6) * b + i] += yy
            sums[uint64(7) * b + i] += dy * yy
            sums[uint64(8) * b + i] += dy * dy * yy
            xf, yf = gx * f, gy * f
            sums[uint64(9) * b + i] += xf
            sums[uint64(10) * b + i] += dy * xf
            sums[uint64(11) * b + i] += yf
            sums[uint64(12) * b + i] += dy * yf
            sums[uint64(13) * b + i] += gx
            sums[uint64(14) * b + i] += dy * gx
            sums[uint64(15) * b + i] += gy
            sums[uint64(16) * b + i] += dy * gy


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def _add_rows_high(planes, pitch, at, size, count, sums):
    """What a second-order shape function needs beyond `_add_rows`."""
    b = uint64(BLOCK)
    for row in range(size):
        dy = np.float32(row - size // 2)
        pixel = at + uint64(row) * uint64(3) * pitch
        for i in range(count // EIGHT * EIGHT):
            f = planes[pixel + i]
            gx = dy * planes[pixel + pitch + i]
            gy = dy * planes[pixel + pitch + pitch + i]
            xx, xy, yy = dy * gx * gx, dy * gx * gy, dy * gy * gy
            sums[uint64(18) * b + i] += xx
            sums[uint64(19) * b + i] += dy * xx
            sums[uint64(20) * b + i] += xy
            sums[uint64(21) * b + i] += dy * xy
            sums[uint64(22) * b + i] += yy
            sums[uint64(23) * b + i] += dy * yy
            sums[uint64(24) * b + i] += dy * gx * f
            sums[uint64(25) * b + i] += dy * gy * f
            sums[uint64(26) * b + i] += dy * gx
            sums[uint64(27) * b + i] += dy * gy


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def _add_valid(valid, pitch, at, size, count, sums):
    b = uint64(VALID * BLOCK)
    for row in range(size):
        pixel = at + uint64(row) * pitch
        for i in range(count // EIGHT * EIGHT):
            sums[b + i] += valid[pixel + i]


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def _add_squares(planes, pitch, at, size, count, squares):
    """Sums of the image and its square in float64.

    The norm is a small difference of them where grey levels are far from the frame's mean (float32: 4e-5 of ZNCC at eight times
    the contrast).
    """
    for row in range(size):
        pixel = at + uint64(row) * uint64(3) * pitch
        for i in range(count // EIGHT * EIGHT):
            value = np.float64(planes[pixel + i])
            squares[i] += value
            squares[uint64(BLOCK) + i] += value * value


@njit(nogil=True, cache=True, error_model="numpy")
def _column_sums(planes, valid, pitch, x_first, y_first, size, step, length, columns, kinds, sums, squares, phases):
    """Fill `phases`, (kinds + 2, step, length): sums of column x_first + i step + k at [:, k % step, i + k // step]."""
    for first in range(0, columns, BLOCK):
        width = min(BLOCK, columns - first)
        count = uint64((width + 7) // 8 * 8)
        sums[:] = np.float32(0.0)
        squares[:] = 0.0
        at = uint64(y_first * 3 * pitch + x_first + first)
        _add_rows(planes, uint64(pitch), at, size, count, sums)
        _add_squares(planes, uint64(pitch), at, size, count, squares)
        if valid.size > 0:
            _add_valid(valid, uint64(pitch), uint64(y_first * pitch + x_first + first), size, count, sums)
        if kinds == QUADRATIC_SUMS:
            _add_rows_high(planes, uint64(pitch), at, size, count, sums)
        for phase in range(step):
            skip = (phase - first) % step
            place = (first + skip) // step
            for kind in range(kinds):
                to = (kind * step + phase) * length + place
                for n in range((width - skip + step - 1) // step):
                    phases[to + n] = sums[kind * BLOCK + skip + n * step]
            for kind in range(2):
                to = ((kinds + kind) * step + phase) * length + place
                for n in range((width - skip + step - 1) // step):
                    phases[to + n] = squares[kind * BLOCK + skip + n * step]


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def _accumulate(phases, at, moments, to, count, factor):
    for i in range(count):
        moments[to + i] += factor * phases[at + i]


@njit(nogil=True, cache=True, error_model="numpy")
def _moments(phases, step, length, size, count, top, moments):
    """Fill `moments`, (kinds + 2, POWERS, count): sums over each subset's columns, weighted with powers of dx up to `top`."""
    moments[:] = 0.0
    for kind in range(top.size + 2):
        highest = top[kind] if kind < top.size else 0
        for k in range(size):
            at = uint64((kind * step + k % step) * length + k // step)
            factor = 1.0
            for power in range(highest + 1):
                _accumulate(phases, at, moments, uint64((kind * POWERS + power) * count), uint64(count), factor)
                factor *= k - size // 2


@njit(nogil=True, cache=True, error_model="numpy")
def _product_kind(pair, power_y):
    """Place of the sum of a product of two gradients times dy^power_y."""
    return PRODUCT + 3 * pair + power_y if power_y < 3 else PRODUCT_HIGH + 2 * pair + power_y - 3


@njit(nogil=True, cache=True, error_model="numpy")
def _fill(matrix, moments, i, count):
    """The Gauss-Newton matrix (lower triangle and diagonal) of POI i."""
    for k in range(count):
        for m in range(k + 1):
            kind = _product_kind(AXIS[k] + AXIS[m], POWER_Y[k] + POWER_Y[m])
            matrix[k, m] = FACTOR[k] * FACTOR[m] * moments[kind, POWER_X[k] + POWER_X[m], i]


@njit(nogil=True, cache=True, error_model="numpy")
def sum_rows(
    planes, valid, pitch, first, last, x0, y0, step, half, pixels, mean, norm, gradient_sum, gradient_image_sum, lower, variance_u,
    variance_v, covariance, sssig,
):  # fmt: skip
    """Fill rows first..last-1 of POI.

    `planes` contains for each row of the image its grey levels and both gradients, `pitch` floats each; `valid` is an image of 0
    and 1 laid out with the same pitch, or empty if all pixels count.

    Per POI: `pixels` that are valid, their `mean` and `norm` (root of the centred sum of squares), the sums of the
    derivatives, their sums with the centred image, the Cholesky factor of the Gauss-Newton matrix, the variances of u and v
    for unit noise and their covariance, and `sssig`, the smaller eigenvalue of the 2x2 sum of squared gradients. If the matrix
    cannot be factored, `variance_u` is zero.
    """
    size = 2 * half + 1
    nx, count = gradient_sum.shape[1:]
    kinds = AFFINE_COLUMN_SUMS if count == AFFINE else QUADRATIC_SUMS
    top = TOP_AFFINE if count == AFFINE else TOP_QUADRATIC
    length = nx + (size - 1) // step + 1
    sums = np.zeros(kinds * BLOCK, dtype=np.float32)
    squares = np.zeros(2 * BLOCK)
    phases = np.zeros((kinds + 2) * step * length)
    flat = np.zeros((kinds + 2) * POWERS * nx)
    moments = flat.reshape((kinds + 2, POWERS, nx))
    column_u, column_v = np.zeros(count), np.zeros(count)
    for j in range(first, last):
        columns = (nx - 1) * step + size
        _column_sums(planes, valid, pitch, x0 - half, y0 + j * step - half, size, step, length, columns, kinds, sums, squares, phases)
        _moments(phases, step, length, size, nx, top, flat)
        for i in range(nx):
            pixels[j, i] = moments[VALID, 0, i] if valid.size > 0 else float(size * size)
            total = moments[kinds, 0, i]
            mean[j, i] = total / max(pixels[j, i], 1.0)
            norm[j, i] = np.sqrt(max(moments[kinds + 1, 0, i] - total * mean[j, i], 0.0))
            for k in range(count):
                axis, power_x, power_y = AXIS[k], POWER_X[k], POWER_Y[k]
                s = FACTOR[k] * moments[ALONE_HIGH + axis if power_y == 2 else ALONE + 2 * axis + power_y, power_x, i]
                gradient_sum[j, i, k] = s
                t = FACTOR[k] * moments[WITH_IMAGE_HIGH + axis if power_y == 2 else WITH_IMAGE + 2 * axis + power_y, power_x, i]
                gradient_image_sum[j, i, k] = t - mean[j, i] * s
            matrix = lower[j, i]
            _fill(matrix, moments, i, count)
            xx, xy, yy = matrix[0, 0], matrix[3, 0], matrix[3, 3]
            sssig[j, i] = 0.5 * (xx + yy) - np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
            if factor(matrix):
                variance_u[j, i] = inverse_diagonal(matrix, 0, column_u)
                variance_v[j, i] = inverse_diagonal(matrix, 3, column_v)
                total = 0.0
                for k in range(3, count):
                    total += column_u[k] * column_v[k]
                covariance[j, i] = total
            else:
                covariance[j, i] = 0.0
                variance_u[j, i] = 0.0
                variance_v[j, i] = 0.0
