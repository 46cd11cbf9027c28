"""Test of one term in a linear regression of a few scalars: value, uncertainty and Bayes factor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

Array = NDArray[np.float64]
MIN_DEGREES_OF_FREEDOM = 4  # minimum number of values beyond the unknowns
_MIN_DETERMINED_FRACTION = 1e-6  # smallest squared fraction of a term that is orthogonal to the others


@dataclass(frozen=True, slots=True)
class RegressionTerm:
    """Result of the regression for one term.

    Attributes:
        value: coefficient of the term.
        sigma: standard uncertainty by the scatter about the fit.
        explained: sum of squares explained by the term.
        residual_ss: residual sum of squares.
        degrees_of_freedom: degrees of freedom of the residual.
    """

    value: float
    sigma: float
    explained: float
    residual_ss: float
    degrees_of_freedom: int


def orthonormal_basis(columns: Array, least: float) -> Array:
    """(n, k) orthonormal basis of the span of (n, q) columns; columns shorter than `least` and dependent ones are left out."""
    size = np.sqrt(np.sum(columns**2, axis=0))
    determined = columns[:, size > least] / size[size > least]
    vectors, values, _ = np.linalg.svd(determined, full_matrices=False)
    return np.asarray(vectors[:, values > 1e-6 * values[0]]) if len(values) else np.zeros((len(columns), 0))


def term(own: Array, values: Array, base: Array) -> RegressionTerm | None:
    """Regression of values (n,) on a term (n,), jointly with an orthonormal basis (n, k); None if it is not determined."""
    column = _orthogonal_part(own, base)
    if len(own) < base.shape[1] + 1 + MIN_DEGREES_OF_FREEDOM or float(column @ column) < _MIN_DETERMINED_FRACTION * max(
        float(own @ own), 1e-9
    ):
        return None
    fitted = _orthogonal_part(values, base)
    amount = float(column @ fitted) / float(column @ column)
    residual = fitted - amount * column
    freedom = len(own) - base.shape[1] - 1
    sigma = float(np.sqrt(residual @ residual / freedom / (column @ column)))
    return RegressionTerm(amount, sigma, amount**2 * float(column @ column), float(residual @ residual), freedom)


def leave_one_out(values: Array, base: Array) -> tuple[Array, Array]:
    """(n,) error of each value predicted from all others, and the variance of that error relative to that of a value."""
    free = np.maximum(1.0 - np.sum(base**2, axis=1), 1e-6)
    return _orthogonal_part(values, base) / free, np.asarray(1.0 / free)


def _orthogonal_part(values: Array, base: Array) -> Array:
    return np.asarray(values - base @ (base.T @ values))


def f_test(terms: list[RegressionTerm]) -> tuple[float, float] | None:
    """p-value of an F-test of all terms, and their log Bayes factor by Schwarz's approximation; None without a residual."""
    explained, residual = sum(value.explained for value in terms), sum(value.residual_ss for value in terms)
    freedom, count = sum(value.degrees_of_freedom for value in terms), len(terms)
    if not count or not residual > 0.0:
        return None
    p_value = float(fdtrc(count, freedom, explained / count / (residual / freedom)))
    odds = 0.5 * (freedom + count) * float(np.log1p(explained / residual)) - 0.5 * count * float(np.log(freedom + count))
    return p_value, odds
