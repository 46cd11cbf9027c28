"""Shape function of fourth order: terms and Gauss-Newton matrix of a subset.

u and v are polynomials of total degree 4 in (dx, dy) / half, 15 coefficients each, those of u first. In these coordinates, which
reach from -1 to 1, sums in float32 are sufficient.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy import uint64

from semlive.kernels.subset_matching.subsets import factor, inverse_diagonal

DEGREE, TERMS, QUARTIC = 4, 15, 30
POWERS = 2 * DEGREE + 1  # of a coordinate in the products of two terms
# exponents of dx and dy of each term, by degree
EXPONENT_X = np.array([n - k for n in range(DEGREE + 1) for k in range(n + 1)])
EXPONENT_Y = np.array([k for n in range(DEGREE + 1) for k in range(n + 1)])
PAIRS = 3  # products gx gx, gx gy, gy gy


@njit(nogil=True, cache=True, error_model="numpy")
def term(exponent_x, exponent_y):
    """Number of a term."""
    n = exponent_x + exponent_y
    return n * (n + 1) // 2 + exponent_y


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def _column_sums(planes, pitch, at, half, products, sums):
    """Sums over the rows of a subset of the products of gradients times powers of dy, (PAIRS, POWERS, size)."""
    size = uint64(2 * half + 1)
    sums[:] = np.float32(0.0)
    for row in range(2 * half + 1):
        pixel = uint64(at + row * 3 * pitch)
        for i in range(size):
            gx, gy = planes[pixel + uint64(pitch) + i], planes[pixel + uint64(2 * pitch) + i]
            products[i] = gx * gx
            products[size + i] = gx * gy
            products[size + size + i] = gy * gy
        for pair in range(PAIRS):
            source = uint64(pair) * size
            power = np.float32(1.0)
            for k in range(POWERS):
                to = uint64(pair * POWERS + k) * size
                for i in range(size):
                    sums[to + i] += power * products[source + i]
                power *= np.float32((row - half) / half)


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def _reduce(sums, powers, size, moments):
    """`moments`, (PAIRS, POWERS of dx, POWERS of dy): the sums over columns."""
    for pair in range(PAIRS):
        for k in range(POWERS):
            at = (pair * POWERS + k) * size
            for n in range(POWERS - k):
                total = 0.0
                for i in range(size):
                    total += powers[n, i] * sums[at + i]
                moments[pair, n, k] = total


@njit(nogil=True, cache=True, error_model="numpy")
def fill_matrix(planes, pitch, at, half, powers, products, sums, moments, matrix):
    """The Gauss-Newton matrix (lower triangle and diagonal) of a subset whose first pixel is at `at`."""
    _column_sums(planes, pitch, at, half, products, sums)
    _reduce(sums, powers, 2 * half + 1, moments)
    for k in range(QUARTIC):
        x0, y0 = EXPONENT_X[k % TERMS], EXPONENT_Y[k % TERMS]
        for m in range(k + 1):
            matrix[k, m] = moments[k // TERMS + m // TERMS, x0 + EXPONENT_X[m % TERMS], y0 + EXPONENT_Y[m % TERMS]]


@njit(nogil=True, cache=True, error_model="numpy")
def powers_of(half, powers):
    """(POWERS, size) powers of dx / half."""
    for i in range(2 * half + 1):
        power = 1.0
        for k in range(powers.shape[0]):
            powers[k, i] = power
            power *= (i - half) / half


@njit(nogil=True, cache=True, error_model="numpy")
def variance_rows(planes, pitch, first, last, x0, y0, step, half, variance_u, variance_v, covariance):
    """Fill rows first..last-1 of POI: variances and covariance of u and v for unit noise; zero if the matrix cannot be factored."""
    size = 2 * half + 1
    powers = np.zeros((POWERS, size))
    powers_of(half, powers)
    products = np.zeros(PAIRS * size, dtype=np.float32)
    sums = np.zeros(PAIRS * POWERS * size, dtype=np.float32)
    moments = np.zeros((PAIRS, POWERS, POWERS))
    matrix = np.zeros((QUARTIC, QUARTIC))
    column_u, column_v = np.zeros(QUARTIC), np.zeros(QUARTIC)
    for j in range(first, last):
        for i in range(variance_u.shape[1]):
            at = (y0 + j * step - half) * 3 * pitch + x0 + i * step - half
            fill_matrix(planes, pitch, at, half, powers, products, sums, moments, matrix)
            variance_u[j, i] = variance_v[j, i] = covariance[j, i] = 0.0
            if factor(matrix):
                variance_u[j, i] = inverse_diagonal(matrix, 0, column_u)
                variance_v[j, i] = inverse_diagonal(matrix, TERMS, column_v)
                total = 0.0
                for k in range(TERMS, QUARTIC):
                    total += column_u[k] * column_v[k]
                covariance[j, i] = total
