"""A term beside others in a regression of a few scalars: how large, how sure, and how much likelier with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as fisher

Array = NDArray[np.float64]
MIN_DEGREES_OF_FREEDOM = 4  # values beyond the unknowns, at least
_MIN_DETERMINED_FRACTION = 1e-6  # of a term, in squares, that the others leave of it


@dataclass(frozen=True, slots=True)
class RegressionTerm:
    """What a regression says of one term.

    Attributes:
        value: of its coefficient.
        sigma: standard uncertainty, by the scatter about the fit.
        explained: sum of squares that it takes.
        residual_ss: sum of squares that stay.
        degrees_of_freedom: degrees of freedom of what stays.
    """

    value: float
    sigma: float
    explained: float
    residual_ss: float
    degrees_of_freedom: int


def orthonormal_basis(columns: Array, least: float) -> Array:
    """(n, k) orthonormal columns that span (n, q) ones, as far as these are longer than `least` and say something new."""
    size = np.sqrt(np.sum(columns**2, axis=0))
    determined = columns[:, size > least] / size[size > least]
    vectors, values, _ = np.linalg.svd(determined, full_matrices=False)
    return np.asarray(vectors[:, values > 1e-6 * values[0]]) if len(values) else np.zeros((len(columns), 0))


def term(own: Array, values: Array, base: Array) -> RegressionTerm | None:
    """One term (n,) of values (n,), beside an orthonormal base (n, k); None where the base leaves nothing of it, or too few values do."""
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
    """(n,) what each value is off from what all others foretell of it, and how much larger its variance is than that of a value."""
    free = np.maximum(1.0 - np.sum(base**2, axis=1), 1e-6)
    return _orthogonal_part(values, base) / free, np.asarray(1.0 / free)


def _orthogonal_part(values: Array, base: Array) -> Array:
    return np.asarray(values - base @ (base.T @ values))


def f_test(terms: list[RegressionTerm]) -> tuple[float, float] | None:
    """p-value of an F-test of all terms together, and the logarithm of their Bayes factor; None where nothing can be said.

    The factor is Schwarz's approximation: so few values bear no finer one.
    """
    explained, residual = sum(value.explained for value in terms), sum(value.residual_ss for value in terms)
    freedom, count = sum(value.degrees_of_freedom for value in terms), len(terms)
    if not count or not residual > 0.0:
        return None
    p_value = float(fisher.sf(explained / count / (residual / freedom), count, freedom))
    odds = 0.5 * (freedom + count) * float(np.log1p(explained / residual)) - 0.5 * count * float(np.log(freedom + count))
    return p_value, odds
