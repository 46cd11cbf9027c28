"""Cholesky factors and forward substitution for the estimator and the diagnosis, whose matrices have 50 to 1,000 rows.

Gathering the rows and columns of a block with NumPy took a third of the time of its factorisation. The triangular solver of LAPACK copies
right sides in C order and worked at a fifth of the rate of a matrix product; that of BLAS takes their transpose as it is, at the rate of a
product. SciPy's Python functions for both hold the interpreter lock: two threads took twice as long as one. Called by their addresses they
release it.
"""

from __future__ import annotations

from ctypes import CFUNCTYPE, byref, c_char, c_double, c_int, c_void_p

import numpy as np
from numba import njit
from numba.extending import get_cython_function_address
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, get_blas_funcs

_trsm = CFUNCTYPE(None, *[c_void_p] * 11)(get_cython_function_address("scipy.linalg.cython_blas", "dtrsm"))
_potrf = CFUNCTYPE(None, *[c_void_p] * 5)(get_cython_function_address("scipy.linalg.cython_lapack", "dpotrf"))
(_trsv,) = get_blas_funcs(("trsv",), dtype=np.float64)
_LOWER, _RIGHT, _TRANSPOSED, _GENERAL, _ONE = c_char(b"L"), c_char(b"R"), c_char(b"T"), c_char(b"N"), c_double(1.0)

Matrix = NDArray[np.float64]


@njit(nogil=True, cache=True)
def _gather(matrix, at, scale, transposed):
    for row in range(at.size):
        source = matrix[at[row]]
        for column in range(row + 1):
            transposed[column, row] = source[at[column]]
        transposed[row, row] *= scale


@njit(nogil=True, cache=True)
def _clear_above(transposed):
    for row in range(len(transposed)):
        transposed[row, :row] = 0.0


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
    return _factor_in_place(np.array(matrix, dtype=np.float64, order="F"))


def cholesky_in_place(symmetric: Matrix) -> Matrix:
    """Lower Cholesky factor of a symmetric matrix in C order, in its memory: the matrix is overwritten.

    Raises:
        LinAlgError: the matrix is not finite or not positive definite.
    """
    return _factor_in_place(np.ascontiguousarray(symmetric).T)


def _factor_in_place(lower: Matrix) -> Matrix:
    """Factor of a matrix in Fortran order, in its memory, with zeros above the diagonal."""
    if not lower.size:
        return lower
    _require_square(lower, len(lower))
    size, failed = c_int(len(lower)), c_int()
    _potrf(byref(_LOWER), byref(size), lower.ctypes.data, byref(size), byref(failed))
    # A number that is not finite makes the diagonal of the factor not finite, even where LAPACK reports no failure.
    if failed.value or not np.isfinite(np.diagonal(lower)).all():
        raise LinAlgError("the matrix is not finite or not positive definite")
    _clear_above(lower.T)
    return lower


def forward_substitution(lower: Matrix, right: Matrix) -> Matrix:
    """(n,) or (n, k) solution of a lower triangular system with a nonzero diagonal, such as that of a Cholesky factor.

    Raises:
        ValueError: the matrix is not (n, n).
    """
    _require_square(lower, len(right))
    if not right.size:
        return np.zeros(right.shape)
    if right.ndim == 1:
        return np.asarray(_trsv(lower, right, lower=1))
    factor, solved = np.asfortranarray(lower, dtype=np.float64), np.array(right, dtype=np.float64, order="C")
    rows, columns = (c_int(count) for count in solved.shape)
    sides = (byref(_RIGHT), byref(_LOWER), byref(_TRANSPOSED), byref(_GENERAL))  # for BLAS, the solution is transposed
    _trsm(*sides, byref(columns), byref(rows), byref(_ONE), factor.ctypes.data, byref(rows), solved.ctypes.data, byref(columns))
    return solved


def _require_square(matrix: Matrix, size: int) -> None:
    """Check a shape: functions that are called by their addresses would read other memory.

    Raises:
        ValueError: the matrix is not (size, size).
    """
    if matrix.shape != (size, size):
        raise ValueError(f"a matrix of shape {matrix.shape} for {size} rows")
