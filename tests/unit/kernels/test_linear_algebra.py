"""Cholesky factors and forward substitution are those of LAPACK, and refuse what has no factor."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, solve_triangular

from semlive.kernels.linear_algebra import cholesky, cholesky_in_place, cholesky_of_rows, forward_substitution


def positive_definite(size: int) -> NDArray[np.float64]:
    rows = np.random.default_rng(size).normal(size=(size, 2 * size))
    return rows @ rows.T


@pytest.mark.parametrize("size", [1, 40, 64, 150])
def test_a_factor_is_that_of_numpy_and_only_the_lower_triangle_is_read(size: int) -> None:
    matrix = positive_definite(size)
    expected = np.linalg.cholesky(matrix)
    upper = np.triu_indices(size, 1)
    for given in (matrix, np.asfortranarray(matrix)):
        given = given.copy(order="K")
        given[upper] = np.nan
        np.testing.assert_allclose(cholesky(given), expected, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(cholesky_of_rows(given, np.arange(size)), expected, rtol=1e-12, atol=1e-12)


def test_a_symmetric_matrix_is_factorised_in_its_memory() -> None:
    matrix = positive_definite(90)
    given = matrix.copy()
    factor = cholesky_in_place(given)
    np.testing.assert_allclose(factor, np.linalg.cholesky(matrix), rtol=1e-12, atol=1e-12)
    assert np.shares_memory(factor, given)


def test_a_block_is_factorised_with_its_diagonal_scaled() -> None:
    matrix, at = positive_definite(90), np.arange(1, 90, 3)
    block = matrix[np.ix_(at, at)]
    expected = np.linalg.cholesky(block + 0.25 * np.diag(np.diag(block)))
    np.testing.assert_allclose(cholesky_of_rows(matrix, at, 1.25), expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("where", [(0, 0), (7, 7), (149, 149), (9, 2), (149, 3), (149, 148)])
def test_a_number_that_is_not_finite_is_refused_anywhere(where: tuple[int, int], value: float) -> None:
    matrix = positive_definite(150)
    matrix[where] = value
    for factorise in (cholesky, lambda each: cholesky_of_rows(each, np.arange(150))):
        with pytest.raises(LinAlgError, match="not finite or not positive definite"):
            factorise(matrix)


def test_a_matrix_that_is_not_positive_definite_is_refused() -> None:
    with pytest.raises(LinAlgError, match="not positive definite"):
        cholesky(np.diag([1.0, -1.0]))


@pytest.mark.parametrize("count", [0, 1, 23, 24, 200])
@pytest.mark.parametrize("size", [0, 1, 63, 64, 65, 200])
def test_many_right_sides_give_what_the_triangular_solver_gives(size: int, count: int) -> None:
    lower = np.linalg.cholesky(positive_definite(size)) + np.triu(np.full((size, size), 7.0), 1)  # what lies above is not read
    right = np.random.default_rng(count).normal(size=(size, count))
    expected = solve_triangular(lower, right, lower=True) if right.size else right
    np.testing.assert_allclose(forward_substitution(lower, right), expected, rtol=1e-9, atol=1e-12)
    if count and size:
        np.testing.assert_allclose(forward_substitution(lower, right[:, 0]), expected[:, 0], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("shape", [(3, 3), (4, 3), (5, 5)])
def test_shapes_that_do_not_fit_are_refused(shape: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match="4 rows"):
        forward_substitution(np.ones(shape), np.ones((4, 2)))


def test_a_matrix_that_is_not_square_is_refused_and_integers_are_converted() -> None:
    with pytest.raises(ValueError, match="4 rows"):
        cholesky(np.ones((4, 3)))
    np.testing.assert_array_equal(cholesky(np.diag([4, 9])), np.diag([2.0, 3.0]))
