"""Symmetric positive definite block-tridiagonal systems: factor, solve, and the blocks of the inverse within the band."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_triangular

Blocks = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Factor:
    """Factor of a block-tridiagonal matrix by elimination of its blocks in order.

    Attributes:
        pivots: Cholesky factors of the n diagonal blocks after elimination, (m, m) each.
        gains: n - 1 products pivot^-1 (block above the diagonal), (m, m) each.
        log_determinant: natural logarithm of the determinant of the matrix.
    """

    pivots: tuple[NDArray[np.float64], ...]
    gains: tuple[NDArray[np.float64], ...]
    log_determinant: float


def factor(diagonal: Blocks, upper: Blocks) -> Factor:
    """Factor the matrix.

    Args:
        diagonal: (n, m, m) diagonal blocks.
        upper: (n - 1, m, m) blocks right of the diagonal blocks.

    Raises:
        LinAlgError: the matrix is not positive definite.
    """
    pivots, gains, log_determinant = [], [], 0.0
    for k, block in enumerate(diagonal):
        remaining = block - upper[k - 1].T @ gains[-1] if k else block
        pivot = cho_factor(remaining, lower=True, check_finite=False)[0]
        log_determinant += 2.0 * float(np.sum(np.log(np.diag(pivot))))
        pivots.append(pivot)
        if k + 1 < len(diagonal):
            gains.append(cho_solve((pivot, True), upper[k], check_finite=False))
    return Factor(tuple(pivots), tuple(gains), log_determinant)


def solve(f: Factor, right: NDArray[np.float64]) -> NDArray[np.float64]:
    """Solution (n, m) of the system with the right side (n, m)."""
    out = np.empty_like(right)
    carried = right.copy()
    for k, pivot in enumerate(f.pivots):
        out[k] = cho_solve((pivot, True), carried[k], check_finite=False)
        if k + 1 < len(f.pivots):
            carried[k + 1] -= f.gains[k].T @ carried[k]
    for k in range(len(f.pivots) - 2, -1, -1):
        out[k] -= f.gains[k] @ out[k + 1]
    return out


def inverse_blocks(f: Factor) -> tuple[Blocks, Blocks]:
    """Diagonal (n, m, m) and upper (n - 1, m, m) blocks of the inverse (Takahashi's recursion by blocks)."""
    n, m = len(f.pivots), f.pivots[0].shape[0]
    diagonal, upper = np.empty((n, m, m)), np.empty((max(n - 1, 0), m, m))
    unit = np.eye(m)
    for k in range(n - 1, -1, -1):
        own = cho_solve((f.pivots[k], True), unit, check_finite=False)
        if k + 1 < n:
            upper[k] = -f.gains[k] @ diagonal[k + 1]
            own = own - upper[k] @ f.gains[k].T
        diagonal[k] = 0.5 * (own + own.T)
    return diagonal, upper


def product(diagonal: Blocks, upper: Blocks, vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Product (n, m) of the symmetric matrix with a vector (n, m)."""
    out = np.einsum("kij,kj->ki", diagonal, vector)
    out[:-1] += np.einsum("kij,kj->ki", upper, vector[1:])
    out[1:] += np.einsum("kij,ki->kj", upper, vector[:-1])
    return out


def draws(f: Factor, count: int) -> NDArray[np.float64]:
    """Random vectors (n, m, count) whose covariance is the inverse of the matrix; the same ones in every call."""
    normal = np.random.default_rng(1).standard_normal((len(f.pivots), f.pivots[0].shape[0], count))
    out = np.empty_like(normal)
    for k in range(len(f.pivots) - 1, -1, -1):
        out[k] = solve_triangular(f.pivots[k], normal[k], lower=True, trans=1, check_finite=False)
        if k + 1 < len(f.pivots):
            out[k] -= f.gains[k] @ out[k + 1]
    return out
