"""The p-value for anything outside the catalogue: exact for exchangeable scores, with its coverage on laws left out of the calibration."""

from __future__ import annotations

from pathlib import Path

import blind
import numpy as np
import pytest
from bench_diagnose import verdicts
from blind.cases import Case, Counts, cases
from blind.hiding import DETECTABLE_PX
from blind.outside import experiments, held_out, unlisted
from blind.scoring import Verdict

from semlive.data.diagnosis.effects import Outcome
from semlive.diagnose.fit_tests.outside_catalogue import calibration_scores, conformal_p_value, outside_test

FINAL = Path(next(iter(blind.__path__))) / "final"
COUNTS = Counts(seeds=16, nulls=773, doubles=100, strange=25, deformed=10, removed=3, confounded=30)


@pytest.fixture(scope="module")
def scored() -> list[tuple[Case, Verdict]]:
    """All verdicts of the final set."""
    found = verdicts(FINAL)
    listed = cases("final", COUNTS, [2.0, 4.0, 8.0], list(DETECTABLE_PX))
    return [(case, found[case.key]) for case in listed if case.key in found]


@pytest.mark.parametrize("level", [0.05, 0.1, 0.5])
def test_a_p_value_is_small_no_more_often_than_it_states(level: float) -> None:
    """Scores with many ties, as outcomes have; 20 000 calibrations of 39 experiments."""
    scores = np.random.default_rng(5).choice(3, p=(0.9, 0.07, 0.03), size=(20_000, 40))
    p_values = (1 + np.sum(scores[:, 1:] >= scores[:, :1], axis=1)) / 40.0
    assert np.mean(p_values <= level) <= level + 3.0 * np.sqrt(level / len(scores))
    assert p_values[0] == conformal_p_value(int(scores[0, 0]), scores[0, 1:].tolist())


def test_the_stored_scores_are_those_of_the_verdicts(scored: list[tuple[Case, Verdict]]) -> None:
    groups = experiments(scored).values()
    assert [sorted(group) for group in calibration_scores()] == [sorted(group.values()) for group in groups]


def test_p_values_cover_laws_outside_the_calibration(scored: list[tuple[Case, Verdict]]) -> None:
    laws = held_out(scored)
    every = np.array([value for own in laws.values() for value in own])
    assert len(laws) == 35
    assert len(every) == 1312
    for level in (0.01, 0.02, 0.05):
        assert np.mean(every <= level) <= level
        assert all(np.mean(np.array(own) <= level) <= level + 2.0 / len(own) for own in laws.values())


def test_unlisted_effects_have_small_p_values(scored: list[tuple[Case, Verdict]]) -> None:
    p_values = unlisted(scored)
    assert np.mean(np.array(p_values) <= 0.01) > 0.95


def test_only_unknown_and_rejected_are_evidence() -> None:
    p_values = [outside_test(outcome).p_value for outcome in (Outcome.NONE, Outcome.IDENTIFIED, Outcome.AMBIGUOUS)]
    assert p_values == [1.0, 1.0, 1.0]
    assert outside_test(Outcome.UNKNOWN).p_value < outside_test(Outcome.REJECTED).p_value < 0.02
