"""Thinning of long runs before a diagnosis."""

from __future__ import annotations

import pytest

from semlive.data.settings import EstimateSettings
from semlive.service.diagnosis.long_runs import FIRST_PAIRS, OTHER_PAIRS, coarser_drift, thinned


@pytest.mark.parametrize("count", [0, 5, 15, 32])
def test_runs_of_one_matrix_are_complete(count: int) -> None:
    assert list(thinned(range(count), count)) == list(range(count))
    assert coarser_drift(EstimateSettings(), count) == EstimateSettings()


@pytest.mark.parametrize("count", [33, 34, 77, 100, 333, 500])
def test_long_runs_retain_their_start_and_pairs_up_to_their_end(count: int) -> None:
    retained = list(thinned(range(count), count))
    assert retained[:FIRST_PAIRS] == list(range(FIRST_PAIRS))
    assert 15 < len(retained) <= FIRST_PAIRS + OTHER_PAIRS
    steps = {b - a for a, b in zip(retained[FIRST_PAIRS:-1], retained[FIRST_PAIRS + 1 :], strict=True)}
    assert len(steps) == 1
    assert count - 1 - retained[-1] < steps.pop()


def test_the_drift_has_as_many_knots_as_for_the_retained_pairs() -> None:
    knots = coarser_drift(EstimateSettings(), 200).drift_knots_per_frame * 200
    assert knots == pytest.approx(EstimateSettings().drift_knots_per_frame * (FIRST_PAIRS + OTHER_PAIRS))
