"""Smoothness and knots of the drift are chosen by a likelihood of held-out data."""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal, localcontext

import numpy as np
import pytest

from semlive.estimate.joint.observations.priors import DifferencePenalty, Kind, Smoothness
from semlive.estimate.joint.selection.marginal_likelihood import (
    CANDIDATES,
    NON_OSCILLATING_PRIORS,
    OSCILLATING_PRIORS,
    STILL_PX,
    LocalLikelihood,
    SmoothnessPrior,
    select_smoothness,
)
from semlive.estimate.joint.selection.marginal_likelihood import _scores as scores
from semlive.model import DriftSpline, UniformSpline

NOISE_PX = 0.01
DRIFT = DriftSpline(UniformSpline(0.0, 30.0, 60))
RNG = np.random.default_rng(8)
TIME_S = np.sort(np.concatenate([200.0 * frame + RNG.uniform(0.0, 95.0, 14) for frame in range(9)]))
ROWS = DRIFT.rows(TIME_S)
BENT_PX = np.cumsum(np.cumsum(RNG.normal(0.0, 0.05, DRIFT.spline.size)))


def likelihood_and_prior(value_px: np.ndarray) -> tuple[LocalLikelihood, SmoothnessPrior]:
    """Likelihood and prior of one drift component for values with noise."""
    data = LocalLikelihood(ROWS.T @ ROWS / NOISE_PX**2, ROWS.T @ value_px / NOISE_PX**2, np.zeros(DRIFT.spline.size))
    return data, SmoothnessPrior(DRIFT, np.zeros((DRIFT.spline.size,) * 2))


def held_out(value_px: np.ndarray, belief: np.ndarray) -> float:
    """Logarithm of the likelihood of each value as predicted by those before it, added up."""
    spread, total = ROWS @ np.linalg.inv(belief) @ ROWS.T + NOISE_PX**2 * np.eye(len(ROWS)), 0.0
    for count, value in enumerate(value_px):
        weights = np.linalg.solve(spread[:count, :count], spread[:count, count]) if count else np.zeros(0)
        variance = spread[count, count] - weights @ spread[:count, count]
        total -= 0.5 * ((value - weights @ value_px[:count]) ** 2 / variance + np.log(variance))
    return float(total)


@pytest.mark.parametrize("kind", [(3, 0.0), (2, 0.0), next(iter(OSCILLATING_PRIORS))])
def test_the_choice_is_by_how_well_earlier_values_predict_later_ones(kind: Kind) -> None:
    value_px = np.sin(TIME_S / 90.0) + RNG.normal(0.0, NOISE_PX, len(TIME_S))
    data, prior = likelihood_and_prior(value_px)
    sizes = np.array([0.01, 0.1, 0.5])
    found = scores(data.with_prior(prior.base), prior, kind, sizes)
    required = [held_out(value_px, prior.base + Smoothness(kind[0], size, kind[1]).roughness(DRIFT)) for size in sizes]
    np.testing.assert_allclose(np.diff(found), np.diff(required), rtol=1e-4)


@pytest.mark.parametrize("kind", [(2, 0.0), list(OSCILLATING_PRIORS)[-2], list(OSCILLATING_PRIORS)[-1]])
def test_beliefs_that_are_far_too_tight_are_as_likely_as_they_are(kind: Kind) -> None:
    """Long swings and small sizes: the logarithm is right to 0.05, where rounding once put 15 into it."""
    value_px = 1e-3 * TIME_S + 1e-8 * TIME_S**2 + RNG.normal(0.0, NOISE_PX, len(TIME_S))
    data, prior = likelihood_and_prior(value_px)
    start = LocalLikelihood(data.precision, data.gradient - data.precision @ BENT_PX, BENT_PX)
    some = [0, 4, 16, -1]
    found = scores(start.with_prior(prior.base), prior, kind, CANDIDATES)[some]
    rows = Smoothness(kind[0], 1.0, kind[1]).filter.rows(DRIFT.spline.size)
    required = [in_many_digits(value_px, prior.base, rows, size) for size in CANDIDATES[some]]
    np.testing.assert_allclose(np.diff(found), np.diff(required), atol=0.05)


def in_many_digits(value_px: np.ndarray, base: np.ndarray, rows: np.ndarray, size_px: float) -> float:
    """Logarithm of the likelihood of all values at once, with 60 digits."""
    with localcontext() as digits:
        digits.prec = 60
        exact: Callable[[np.ndarray], np.ndarray] = np.vectorize(Decimal, otypes=[object])
        observed, filtered, tight = exact(ROWS / NOISE_PX), exact(rows), 1 / Decimal(size_px) ** 2
        belief = exact(base) + filtered.T.dot(filtered) * tight
        precision, pull = belief + observed.T.dot(observed), observed.T.dot(exact(value_px / NOISE_PX))
        (before, _), (after, fit) = reduced(belief, pull), reduced(precision, pull)
        return float((fit + before - after) / 2)


def reduced(matrix: np.ndarray, pull: np.ndarray) -> tuple[Decimal, Decimal]:
    """Logarithm of a determinant, and pull^T matrix^-1 pull, by elimination."""
    left, pull, total, fit = matrix.copy(), pull.copy(), Decimal(0), Decimal(0)
    for at in range(len(left)):
        pivot, below = left[at, at], slice(at + 1, None)
        factor = left[below, at] / pivot
        left[below, below] -= np.outer(factor, left[at, below])
        fit, total = fit + pull[at] ** 2 / pivot, total + pivot.ln()
        pull[below] -= factor * pull[at]
    return total, fit


def test_an_oscillating_drift_is_separated_from_a_wandering_and_a_creeping_one() -> None:
    noise = RNG.normal(0.0, NOISE_PX, (3, len(TIME_S)))
    bends = np.concatenate(([0.0, 0.0], np.cumsum(np.cumsum(RNG.normal(0.0, 0.05, DRIFT.spline.size - 2)))))
    swing, wander, creep = 0.4 * np.sin(2.0 * np.pi * TIME_S / 255.0), ROWS @ bends, 1e-3 * TIME_S + 1e-7 * TIME_S**2
    found = [
        select_smoothness(*likelihood_and_prior(value + item), NON_OSCILLATING_PRIORS, CANDIDATES)
        for value, item in zip((swing, wander, creep), noise, strict=True)
    ]
    assert found[0].oscillation_period_knots == pytest.approx(255.0 / 30.0, rel=0.25)
    assert found[1].size_px == pytest.approx(0.05, rel=0.6)
    assert found[2].size_px < STILL_PX
    assert found[2].oscillation_period_knots == 0.0


def test_a_filter_is_its_matrix_and_its_transpose() -> None:
    value = RNG.normal(size=12)
    for item in (DifferencePenalty(2, 1.0), DifferencePenalty(3, 1.0), Smoothness(2, 0.1, 7.0).filter):
        rows = item.rows(12)
        np.testing.assert_allclose(item.of(value), rows @ value, atol=1e-12)
        np.testing.assert_allclose(item.reversed(item.of(value)), rows.T @ rows @ value, atol=1e-9)
        assert item.of(value[: item.reach]).size == 0
    np.testing.assert_allclose(DifferencePenalty(3, 1.0).rows(9), np.diff(np.eye(9), n=3, axis=0))
