"""One test of adequacy: what is corrected, harmless or the own bias of the correlation gives no warning, any other residual does."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from blind.experiment import Conditions, hidden
from blind.hiding import PROTOTYPE_PX, hidden_effect
from blind.live import decided
from blind.observing import QUICK, observed
from numexp.world import HEIGHT_PX, WIDTH_PX
from threadpoolctl import threadpool_limits

from semlive import estimate
from semlive.data.diagnosis.effects import Outcome
from semlive.data.grid import Grid
from semlive.diagnose.baseline.observation import Observation
from semlive.diagnose.fit_tests.adequacy import Adequacy, adequacy_after, harmless_px
from semlive.diagnose.maps.verdict import diagnose
from semlive.estimate import Solution
from semlive.model.effects import EFFECT_CLASSES
from semlive_simulators.effects.interfaces import Effect

GRID = Grid(101, 101, 60, 13, 10, 43)  # a block is a point
SIX_PAIRS = Conditions(7, calibration=6, tension=0)
CLEAN = replace(SIX_PAIRS, noise_px=1e-3, outliers=0.0)
FEW = tuple(family for family in EFFECT_CLASSES if family.name in ("magnification_drift", "aspect_drift"))


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    """As in the daemon's analysis."""
    with threadpool_limits(limits=1, user_api="blas"):
        yield


@pytest.fixture(scope="module")
def largely_biased() -> Observation:
    """A correlation with a bias of 6e-3 px."""
    return observed(replace(CLEAN, bias_px=0.006), (), GRID, QUICK)


def after_run(conditions: Conditions, effects: tuple[Effect, ...] = ()) -> tuple[Adequacy, Solution]:
    """Result of the test after a complete run, and the solution."""
    state, decisions = estimate.init(QUICK, GRID, WIDTH_PX, HEIGHT_PX), []
    for pair in hidden(conditions, effects, GRID):
        state = estimate.update(state, pair.pose.pair, pair.pose.phase, pair.times, pair.maps)
        decisions.append(decided(pair))
    solution = estimate.solve(state)
    found = adequacy_after(solution, decisions)
    assert found is not None
    return found, solution


def test_a_drift_of_the_raster_that_the_estimate_corrects_gives_no_warning() -> None:
    found, solution = after_run(SIX_PAIRS, hidden_effect("magnification_drift", 0.24, 7))
    assert solution.hyper.raster_px[0] > 0.0
    assert found.notes() == ()


def test_an_effect_that_the_estimate_does_not_correct_gives_a_warning() -> None:
    found, solution = after_run(SIX_PAIRS, hidden_effect("stage_yaw", 4.0 * PROTOTYPE_PX["stage_yaw"], 7))
    assert solution.hyper.raster_px == (0.0, 0.0)
    assert found.most_significant is not None
    assert found.most_significant.p_value < 1e-9


def test_the_own_bias_of_the_correlation_gives_no_warning_and_a_larger_one_does() -> None:
    own, _ = after_run(replace(CLEAN, bias_px=0.0009))
    assert own.notes() == ()
    larger, _ = after_run(replace(CLEAN, bias_px=0.006))
    assert larger.most_significant is not None
    assert larger.most_significant.domain == "fraction"


def test_a_harmless_residual_is_a_small_strain(largely_biased: Observation) -> None:
    geometry = largely_biased.geometry
    position = geometry.address_px[0]
    width_px = float(np.ptp(position, axis=0).max())
    line = np.linspace(0.0, 2e-6 * width_px, 1000)
    assert harmless_px(geometry) == pytest.approx(float(line.std()), rel=0.01)
    assert harmless_px(geometry) < 1e-3


def test_none_is_never_given_where_the_test_fails(largely_biased: Observation) -> None:
    """A wave over the fraction of a pixel is in no class of this dictionary, and no unnamed field describes it."""
    found = diagnose(largely_biased, dictionary=FEW, draws=99)
    assert found.adequacy is not None
    assert not found.adequacy.passed
    assert found.adequacy.domain == "fraction"
    assert found.outcome is Outcome.UNKNOWN


def test_none_passes_the_test() -> None:
    found = diagnose(observed(SIX_PAIRS, (), GRID, QUICK), dictionary=FEW, draws=99)
    assert found.outcome is Outcome.NONE
    assert found.adequacy is not None
    assert found.adequacy.passed
    assert found.closest == ()


def test_the_own_bias_of_the_correlation_is_no_missing_effect(largely_biased: Observation) -> None:
    biased = tuple(family for family in EFFECT_CLASSES if family.name in ("dic_subpixel_bias", "aspect_drift"))
    found = diagnose(observed(replace(CLEAN, bias_px=0.0009), (), GRID, QUICK), dictionary=biased, draws=99)
    assert (found.outcome, found.effects) == (Outcome.NONE, ())
    assert dict(found.evidence)["dic_subpixel_bias"] > 7.0
    larger = diagnose(largely_biased, dictionary=biased, draws=99)
    assert (larger.outcome, [effect.name for effect in larger.effects]) == (Outcome.IDENTIFIED, ["dic_subpixel_bias"])
