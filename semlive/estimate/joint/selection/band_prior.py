"""Prior of a temporal spline as a band matrix over its knots, those before its first one given."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import cholesky_banded

from semlive.estimate.joint.elimination.shared_parameters import Matrix, TemporalSpline, Vector
from semlive.estimate.joint.observations.priors import MAX_COUPLED_KNOTS


def prior_band(strand: TemporalSpline, value: Vector) -> tuple[Matrix, float]:
    """Lower band of the prior precision of a temporal spline outside the border, latest first, and the prior cost of all knots."""
    first = strand.first
    own = _band(strand)
    for lag in range(len(own)):
        own[lag, : own.shape[1] - lag] = own[lag, : own.shape[1] - lag][::-1].copy()
    cost = strand.knot_precision * float(value[first:] @ value[first:])
    for penalty in strand.filters:
        begin, rows = strand.since(first), first if strand.severed else max(first - penalty.reach, 0)
        bent = penalty.of(value[begin:], strand.gaps(begin, strand.spline.size))[rows - begin :]
        cost += penalty.precision * float(np.sum(bent**2))
    return own, cost


def log_determinant(strand: TemporalSpline) -> float:
    """Log determinant of the prior precision of a temporal spline outside the border.

    The computation uses differences of the lowest order as parameters. They are equivalent to the knots (unit Jacobian) and much better
    conditioned: thousands of knots free at one end span more decades than a double represents.
    """
    inside = strand.spline.gaps_within(strand.first + 1, strand.spline.size)
    least = 0 if strand.knot_precision or inside else min(penalty.order for penalty in strand.filters)
    return 2.0 * float(np.log(cholesky_banded(_band(strand, least), lower=True, check_finite=False)[0]).sum())


def _band(strand: TemporalSpline, sums: int = 0) -> Matrix:
    """(k, size - first) lower band of the prior precision of the knots of a temporal spline, those before its first one given.

    Args:
        strand: the temporal spline.
        sums: number of times that knots are sums of the parameters; differences of at least this order, without gaps.
    """
    size, first = strand.spline.size, strand.first
    own = np.zeros((max((penalty.reach - sums for penalty in strand.filters), default=0) + 1, size))
    if gaps := strand.gaps(0, size):
        own = np.zeros((coupled_knots(strand) + 1, size))
    own[0] += strand.knot_precision
    for penalty in strand.filters:
        plain = replace(penalty, order=penalty.order - sums)
        weights, begin = plain.weights, max(first - plain.reach, 0)
        across, retained = list(penalty.across(size, gaps)), np.ones(size)
        for rows, _, _ in across:
            retained[rows.start + penalty.reach : rows.stop + penalty.reach] = 0.0
        for later in range(plain.reach + 1):
            for earlier in range(later + 1):
                own[later - earlier, begin + earlier : size - plain.reach + earlier] += (
                    penalty.precision * weights[later] * weights[earlier] * retained[begin + plain.reach :]
                )
        for rows, columns, values in across:
            _add_rows(own, penalty.precision, values[max(first - rows.start - penalty.reach, 0) :], columns, first)
    return own[:, first:]


def _add_rows(own: Matrix, precision: float, rows: Matrix, columns: slice, first: int) -> None:
    """Add, in place, the precision of rows over some knots to a lower band; those before `first` are given."""
    rows = rows[:, max(first - columns.start, 0) :]
    full, begin = precision * (rows.T @ rows), columns.stop - rows.shape[1]
    for lag in range(min(len(full), len(own))):
        own[lag, begin : columns.stop - lag] += np.diag(full, -lag)


def coupled_knots(strand: TemporalSpline) -> int:
    """Largest distance of two knots that the prior of a temporal spline couples."""
    across = min(2 * MAX_COUPLED_KNOTS - 1, strand.spline.size - strand.first - 1)
    return across if strand.spline.gaps else MAX_COUPLED_KNOTS
