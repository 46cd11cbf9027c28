"""Limit of the work of a verdict: it ends with what it has, and states it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from blind.experiment import Conditions
from blind.hiding import PROTOTYPE_PX, hidden_effect
from blind.observing import QUICK, observed
from threadpoolctl import threadpool_limits

from semlive.data.diagnosis.effects import Outcome
from semlive.data.grid import Grid
from semlive.diagnose.baseline.model_effects import effect_class
from semlive.diagnose.baseline.observation import Observation
from semlive.diagnose.baseline.unequal_noise import unequal_noise
from semlive.diagnose.maps import search
from semlive.diagnose.maps.repeated_search import SearchResult, repeated_search
from semlive.diagnose.maps.verdict import diagnose

GRID = Grid(101, 101, 45, 17, 14, 43)
EFFECTS = ("magnification_drift", "stage_yaw", "refocus_magnification_step")
ADDED_PX = 0.02  # noise of every fourth frame in addition, so that the maps are searched again
DICTIONARY = [effect_class(name) for name in EFFECTS]


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    """Threads that wait for each other take processor time from other tests."""
    with threadpool_limits(limits=1, user_api="blas"):
        yield


@cache
def equal_noise() -> Observation:
    """A run with three effects."""
    return observed(
        Conditions(7, calibration=5, tension=0), tuple(hidden_effect(name, 8.0 * PROTOTYPE_PX[name], 7)[0] for name in EFFECTS), GRID, QUICK
    )


@cache
def observation() -> Observation:
    """The same run with noise that differs between the frames."""
    disparity_px = equal_noise().disparity_px.copy()
    disparity_px[::4] += np.random.default_rng(1).normal(scale=ADDED_PX, size=disparity_px[::4].shape)
    return replace(equal_noise(), disparity_px=disparity_px)


@cache
def unlimited() -> SearchResult:
    return repeated_search(observation(), DICTIONARY, (), (99, 0))


def names(result: SearchResult) -> list[str]:
    return [effect.names[0] for effect in result.effects]


def test_work_is_that_of_all_searches() -> None:
    assert names(unlimited()) == ["refocus_magnification_step", "stage_yaw"]
    assert unlimited().searches == 2
    assert not unlimited().search.truncated
    assert unlimited().search.allows(0.0)
    assert unlimited().baseline_with_effects.design.whiten.over_frames is not None


def test_noise_that_is_equal_with_the_effects_requires_no_further_search() -> None:
    result = repeated_search(equal_noise(), DICTIONARY, (), (99, 0))
    assert unequal_noise(result.search.baseline) is not None
    assert names(result) == ["refocus_magnification_step", "stage_yaw"]
    assert result.searches == 1


def test_a_search_that_would_exceed_the_limit_is_omitted_and_stated(monkeypatch: pytest.MonkeyPatch) -> None:
    limit = 0.75 * unlimited().search.work
    monkeypatch.setattr(search, "MAX_WORK_PER_FRAME", limit / observation().frames)
    result = repeated_search(observation(), DICTIONARY, (), (99, 0))
    assert set(names(result)) <= set(EFFECTS)
    assert names(result)
    assert result.searches == 1
    assert result.search.truncated
    assert result.search.work <= limit


def test_an_effect_beyond_the_limit_is_not_identified_and_the_verdict_states_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search, "MAX_WORK_PER_FRAME", 0.0)
    verdict = diagnose(observation(), dictionary=DICTIONARY, draws=99)
    assert verdict.truncated
    assert verdict.outcome is Outcome.UNKNOWN
    assert verdict.effects == ()
    assert verdict.closest[0][0] in EFFECTS
