"""Basis fields of which the products alone are stored have the evidence of those whose whitened fields are stored, or of none stored."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from blind.experiment import Conditions
from blind.hiding import PROTOTYPE_PX, hidden_effect
from blind.observing import observed
from threadpoolctl import threadpool_limits

from semlive.data.grid import Grid
from semlive.diagnose.baseline import bayes_factor
from semlive.diagnose.baseline.baseline import HyperparameterGrid, build_grid
from semlive.diagnose.baseline.bayes_factor import NullDraws, project_candidates, score_candidates, with_draws
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.baseline.projection import Projections
from semlive.diagnose.maps.effect_selection import CERTAIN_LOG_FACTOR
from semlive.diagnose.maps.refinement import refined
from semlive.diagnose.maps.unnamed_fields import UNNAMED_CLASSES
from semlive.model.effects import EFFECT_CLASSES

GRID = Grid(101, 101, 45, 17, 14, 43)
EFFECT = "magnification_drift"
FAMILIES = (*EFFECT_CLASSES, *UNNAMED_CLASSES)


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    """Threads that wait for each other take processor time from other tests."""
    with threadpool_limits(limits=1, user_api="blas"):
        yield


@pytest.fixture(scope="module")
def baseline() -> HyperparameterGrid:
    """Of a run with an effect."""
    return noise_scaled_baseline(
        observed(Conditions(7, calibration=5, tension=3), hidden_effect(EFFECT, 8.0 * PROTOTYPE_PX[EFFECT], 7), GRID)
    )


def stored(baseline: HyperparameterGrid, limit_bytes: int) -> Projections:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bayes_factor, "MAX_BYTES", limit_bytes)
        return project_candidates(baseline, FAMILIES)


def test_evidence_and_null_draws_do_not_depend_on_what_is_stored(baseline: HyperparameterGrid) -> None:
    complete, products = stored(baseline, 10**9), stored(baseline, 50_000_000)
    memory = [sum(batch.nbytes for batches in projections.values() for batch in batches) for projections in (complete, products)]
    assert memory[0] > 50_000_000
    assert memory[1] == 0
    assert list(products) == list(complete)

    before = score_candidates(baseline, FAMILIES, products)
    assert [each.log_factor for each in before] == [each.log_factor for each in score_candidates(baseline, FAMILIES, complete)]

    (effect,) = (each for each in before if each.family.name == EFFECT)
    further = build_grid(baseline.design.with_effects(refined(baseline, effect).baseline_effect))
    null = NullDraws.of(further, 19, 1)
    of_complete, of_products = (
        with_draws(further, score_candidates(further, FAMILIES, projections), null, projections) for projections in (complete, products)
    )
    unstored = score_candidates(further, FAMILIES)
    assert max(abs(each.log_factor - old.log_factor) for each, old in zip(unstored, before, strict=True)) > 1.0
    for one, other, third in zip(of_complete, of_products, unstored, strict=True):
        assert other.log_factor == pytest.approx(one.log_factor, rel=1e-9, abs=1e-9)
        assert third.log_factor == pytest.approx(one.log_factor, rel=1e-9, abs=1e-9)
        np.testing.assert_allclose(other.null, one.null, rtol=1e-9, atol=1e-9)


def test_draws_of_the_null_exceed_a_bayes_factor_no_more_often_than_its_inverse(baseline: HyperparameterGrid) -> None:
    """Markov's inequality, which replaces the draws where an effect is certain."""
    drawn = with_draws(baseline, score_candidates(baseline, FAMILIES), NullDraws.of(baseline, 99, 2))
    null = np.stack([each.null for each in drawn])
    for factor in (4.0, 20.0):
        assert np.mean(null > np.log(factor)) < 1.0 / factor
    assert null.max() < 0.5 * CERTAIN_LOG_FACTOR
    assert max(each.log_factor for each in drawn) > CERTAIN_LOG_FACTOR
