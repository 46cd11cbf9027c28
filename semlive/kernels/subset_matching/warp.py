"""Shape functions: affine (6 parameters) and second-order (12), and the small algebra on them.

Parameters are ordered (u, du/dx, du/dy, v, dv/dx, dv/dy), then for second order (d2u/dx2, d2u/dxdy, d2u/dy2, d2v/dx2,
d2v/dxdy, d2v/dy2): u(dx, dy) = u + ux dx + uy dy + uxx dx^2 / 2 + uxy dx dy + uyy dy^2 / 2.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from semlive.kernels.arrays import copy_line

AFFINE, QUADRATIC = 6, 12


@njit(nogil=True, cache=True, error_model="numpy")
def solve(lower, b):
    """Solve L L^T x = b in place."""
    n = b.size
    for i in range(n):
        value = b[i]
        for k in range(i):
            value -= lower[i, k] * b[k]
        b[i] = value / lower[i, i]
    for i in range(n - 1, -1, -1):
        value = b[i]
        for k in range(i + 1, n):
            value -= lower[k, i] * b[k]
        b[i] = value / lower[i, i]


@njit(nogil=True, cache=True, error_model="numpy")
def _compose_inverse_affine(p, d):
    a, b, c, e = 1.0 + d[1], d[2], d[4], 1.0 + d[5]
    det = a * e - b * c
    ia, ib, ic, ie = e / det, -b / det, -c / det, a / det
    tx = -(ia * d[0] + ib * d[3])
    ty = -(ic * d[0] + ie * d[3])
    for k in range(0, 6, 3):
        along_x = p[k + 1] + (1.0 if k == 0 else 0.0)
        along_y = p[k + 2] + (0.0 if k == 0 else 1.0)
        p[k] += along_x * tx + along_y * ty
        p[k + 1] = along_x * ia + along_y * ic - (1.0 if k == 0 else 0.0)
        p[k + 2] = along_x * ib + along_y * ie - (0.0 if k == 0 else 1.0)


@njit(nogil=True, cache=True, error_model="numpy")
def _position_polynomial(p, axis, out):
    """Coefficients of the warped position by (1, dx, dy, dx^2, dxdy, dy^2)."""
    at = 3 * axis
    out[0], out[1], out[2] = p[at], p[at + 1], p[at + 2]
    out[1 + axis] += 1.0
    out[3], out[4], out[5] = 0.5 * p[6 + at], p[7 + at], 0.5 * p[8 + at]


@njit(nogil=True, cache=True, error_model="numpy")
def _product(a, b, out):
    """Product of two polynomials of second order, higher orders dropped."""
    out[0] = a[0] * b[0]
    out[1] = a[0] * b[1] + a[1] * b[0]
    out[2] = a[0] * b[2] + a[2] * b[0]
    out[3] = a[0] * b[3] + a[3] * b[0] + a[1] * b[1]
    out[4] = a[0] * b[4] + a[4] * b[0] + a[1] * b[2] + a[2] * b[1]
    out[5] = a[0] * b[5] + a[5] * b[0] + a[2] * b[2]


@njit(nogil=True, cache=True, error_model="numpy")
def _solve_general(matrix, x):
    """Solve matrix x = x in place for the columns of x; matrix is close to unit, no pivoting."""
    n = matrix.shape[0]
    for j in range(n):
        for i in range(j + 1, n):
            factor = matrix[i, j] / matrix[j, j]
            for k in range(j, n):
                matrix[i, k] -= factor * matrix[j, k]
            for k in range(x.shape[1]):
                x[i, k] -= factor * x[j, k]
    for i in range(n - 1, -1, -1):
        for k in range(x.shape[1]):
            value = x[i, k]
            for j in range(i + 1, n):
                value -= matrix[i, j] * x[j, k]
            x[i, k] = value / matrix[i, i]


@njit(nogil=True, cache=True, error_model="numpy")
def _compose_inverse_quadratic(p, d):
    """Lu, Cary 2000 (doi:10.1007/BF02326485): a warp as a matrix on (1, dx, dy, dx^2, dxdy, dy^2), third order dropped."""
    m = np.empty((6, 6))
    rows = np.empty((6, 2))
    m[0, :] = 0.0
    m[0, 0] = 1.0
    _position_polynomial(d, 0, m[1])
    _position_polynomial(d, 1, m[2])
    _product(m[1], m[1], m[3])
    _product(m[1], m[2], m[4])
    _product(m[2], m[2], m[5])
    _position_polynomial(p, 0, rows[:, 0])
    _position_polynomial(p, 1, rows[:, 1])
    # rows @ inverse(m), transposed
    transposed = np.empty((6, 6))
    for i in range(6):
        for j in range(6):
            transposed[i, j] = m[j, i]
    _solve_general(transposed, rows)
    for axis in range(2):
        at = 3 * axis
        p[at], p[at + 1], p[at + 2] = rows[0, axis], rows[1, axis], rows[2, axis]
        p[at + 1 + axis] -= 1.0
        p[6 + at], p[7 + at], p[8 + at] = 2.0 * rows[3, axis], rows[4, axis], 2.0 * rows[5, axis]


@njit(nogil=True, cache=True, error_model="numpy")
def compose_inverse(p, d, count):
    """Warp p followed after the inverse of warp d, in place in p: W(p) <- W(p) o W(d)^-1; the first `count` of 12 parameters."""
    if count == AFFINE:
        _compose_inverse_affine(p, d)
    else:
        _compose_inverse_quadratic(p, d)


@njit(nogil=True, cache=True, error_model="numpy")
def reach(p, at, half):
    """Upper bound of |u| (at = 0) or |v| (at = 3) over a subset, without the unit gradient."""
    return half * (abs(p[at + 1]) + abs(p[at + 2])) + half * half * (0.5 * (abs(p[at + 6]) + abs(p[at + 8])) + abs(p[at + 7]))


@njit(nogil=True, cache=True, error_model="numpy")
def move(p, q, dx):
    """Continue warp p to a subset `dx` px further right: q <- p seen from there."""
    for at in range(0, 6, 3):
        q[at] = p[at] + dx * (p[at + 1] + 0.5 * dx * p[at + 6])
        q[at + 1] = p[at + 1] + dx * p[at + 6]
        q[at + 2] = p[at + 2] + dx * p[at + 7]
    copy_line(q[6:], p[6:])
