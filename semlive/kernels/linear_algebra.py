"""Cholesky factors and forward substitution for the estimator and the diagnosis, whose matrices have 50 to 1,000 rows.

Gathering the rows and columns of a block with NumPy took a third of the time of its factorisation, and the Cholesky routine of NumPy
twice the time of the same LAPACK routine in SciPy, which works in place. The triangular solver of LAPACK copies right sides in C order
and worked at a fifth of the rate of a matrix product; that of BLAS takes their transpose as it is, at the rate of a product.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, get_blas_funcs, get_lapack_funcs

(_potrf,) = get_lapack_funcs(("potrf",), dtype=np.float64)
_trsm, _trsv = get_blas_funcs(("trsm", "trsv"), dtype=np.float64)

Matrix = NDArray[np.float64]


@njit(nogil=True, cache=True)
def _gather(matrix, at, scale, transposed):
    for row in range(at.size):
        source = matrix[at[row]]
        for column in range(row + 1):
            transposed[column, row] = source[at[column]]
        transposed[row, row] *= scale


def cholesky_of_rows(matrix: Matrix, at: NDArray[np.int64], diagonal_scale: float = 1.0) -> Matrix:
    """Lower Cholesky factor of the rows and columns `at` (n,) of a matrix, of which only the lower triangle is read.

    The diagonal is multiplied by `diagonal_scale` before.

    Raises:
        LinAlgError: the block is not finite or not positive definite.
    """
    transposed = np.empty((at.size, at.size))
    _gather(np.ascontiguousarray(matrix), at, diagonal_scale, transposed)
    return _factor_in_place(transposed.T)


def cholesky(matrix: Matrix) -> Matrix:
    """Lower Cholesky factor of a matrix, of which only the lower triangle is read.

    Raises:
        LinAlgError: the matrix is not finite or not positive definite.
    """
    return _factor_in_place(np.array(matrix, order="F"))


def _factor_in_place(lower: Matrix) -> Matrix:
    """Factor of a matrix in Fortran order, in its memory, with zeros above the diagonal."""
    if not lower.size:
        return lower
    factor, failed = _potrf(lower, lower=1, clean=1, overwrite_a=1)
    # A number that is not finite makes the diagonal of the factor not finite, even where LAPACK reports no failure.
    if failed or not np.isfinite(np.diagonal(factor)).all():
        raise LinAlgError("the matrix is not finite or not positive definite")
    return np.asarray(factor)


def forward_substitution(lower: Matrix, right: Matrix) -> Matrix:
    """(n,) or (n, k) solution of a lower triangular system with a nonzero diagonal, such as that of a Cholesky factor."""
    if not right.size:
        return np.zeros(right.shape)
    return np.asarray(_trsv(lower, right, lower=1) if right.ndim == 1 else _trsm(1.0, lower, right.T, side=1, lower=1, trans_a=1).T)
