"""What the baseline can follow: a drift that wanders, splines that are too coarse, and what held-out pairs cannot know."""

from __future__ import annotations

import numpy as np
import pytest
from blind.cases import CONFOUNDED, GRID, Case
from blind.experiment import Conditions
from blind.hiding import hidden_effect
from blind.observing import QUICK, observed

from semlive.data.diagnosis.effects import ModelEffect, Outcome
from semlive.data.diagnosis.verdict import Diagnosis
from semlive.data.grid import Grid
from semlive.diagnose.baseline.baseline import HyperparameterGrid, build_grid
from semlive.diagnose.baseline.bayes_factor import score_candidates
from semlive.diagnose.baseline.model_effects import add_model_effects, effect_class
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.baseline.priors import DriftPrior
from semlive.diagnose.fit_tests.cross_validation import held_out_misfit
from semlive.diagnose.maps.refinement import refined
from semlive.diagnose.maps.spline_resolution import fine_scale_candidates
from semlive.diagnose.maps.verdict import diagnose
from semlive_simulators.effects.drift import BaselineDistortionUnderresolved, RandomWalkDrift
from semlive_simulators.effects.interfaces import Effect

COARSE = Grid(101, 101, 30, 25, 20, 43)
DRAWS = 99
WANDER = RandomWalkDrift(0.01, 20_000.0, 60.0, 7)
HILLS = BaselineDistortionUnderresolved(0.05, 110.0)


def diagnosis_of(effects: tuple[Effect, ...], grid: Grid = COARSE) -> Diagnosis:
    return diagnose(observed(Conditions(71), effects, grid), draws=DRAWS)


def wandering(baseline: HyperparameterGrid) -> float:
    assert baseline.best.prior_choice is not None
    return baseline.best.prior_choice[0].random_walk_px


@pytest.fixture(scope="module")
def smooth() -> HyperparameterGrid:
    return noise_scaled_baseline(observed(Conditions(71), (), COARSE))


def test_a_random_walk_is_selected_only_where_the_drift_wanders(smooth: HyperparameterGrid) -> None:
    assert wandering(smooth) == 0.0
    walked = noise_scaled_baseline(observed(Conditions(71), (WANDER,), COARSE))
    step_px = 0.01 * np.sqrt(walked.design.observation.state.drift.spline.spacing)  # type: ignore[union-attr]
    assert 0.3 < wandering(walked) / step_px < 3.0
    plain = [item.evidence for item in walked.points if item.prior_choice is not None and not item.prior_choice[0].random_walk_px]
    assert walked.best.evidence > max(plain) + 50.0


def test_less_smooth_drifts_that_explain_less_are_not_evaluated(smooth: HyperparameterGrid) -> None:
    beliefs = [item.prior_choice[0] for item in smooth.points if item.prior_choice is not None]
    assert DriftPrior(0.0, 1.0) not in beliefs
    assert all(item.evidence > smooth.best.evidence - 40.0 or item.occam_factor > smooth.best.occam_factor for item in smooth.points)


def test_a_drift_that_wanders_faster_than_its_knots_is_no_effect() -> None:
    """Its waves of 62 s, between knots 32 s apart, were named an oscillation."""
    found = diagnose(Case(CONFOUNDED, ("random_walk_drift",), 1.0, 22_003).observed(), draws=DRAWS)
    assert (found.outcome, found.effects, found.coarse) == (Outcome.NONE, (), ("baseline_drift_underresolved",))


def test_a_drift_that_walks_within_frames_is_followed_in_each_frame() -> None:
    """Waves over the run followed only periods above 1.25 knots, and the rest of such a walk was identified as a jump."""
    walk, points = RandomWalkDrift(0.01, 3_300.0, 15.0, 7), Grid(101, 101, 45, 17, 14, 43)
    walked = noise_scaled_baseline(observed(Conditions(71, subset_px=43), (walk,), points, QUICK))
    assert wandering(walked) > 0.0
    scored = {item.family.name: item.log_factor for item in score_candidates(walked, fine_scale_candidates(walked))}
    assert scored["baseline_drift_underresolved_in_frames"] > scored["baseline_drift_underresolved"] + 50.0


def test_an_effect_is_named_next_to_a_drift_that_wanders() -> None:
    found = diagnosis_of((WANDER, *hidden_effect("magnification_drift", 0.4, 1)))
    assert (found.outcome, [item.name for item in found.effects]) == (Outcome.IDENTIFIED, ["magnification_drift"])
    assert found.gap is not None
    assert found.gap.closure > 0.7


def test_a_distortion_finer_than_its_knots_is_no_effect() -> None:
    found = diagnosis_of((HILLS,), GRID)
    assert (found.outcome, found.effects, found.coarse) == (Outcome.NONE, (), ("baseline_distortion_underresolved",))


def test_what_draws_leave_of_held_out_frames_is_what_the_data_leave(smooth: HyperparameterGrid) -> None:
    """The floor of closure is neither above nor below the residual of a run without a missing effect."""
    weak = add_model_effects(smooth, [ModelEffect("magnification_drift", (), 0.003)])[0]
    gap = held_out_misfit(smooth, weak, 0)
    assert gap.after_px == pytest.approx(gap.floor_px, rel=0.12)


def test_a_significant_row_time_is_not_rejected_by_uninformative_held_out_frames() -> None:
    baseline = noise_scaled_baseline(observed(Conditions(20_013), hidden_effect("wrong_row_time", 0.3, 1), GRID))
    (received,) = score_candidates(baseline, [effect_class("wrong_row_time")])
    found = refined(baseline, received)
    gap = held_out_misfit(baseline, build_grid(baseline.design.with_effects(found.baseline_effect)), 0)
    assert found.log_factor > 30.0
    assert gap.closure_interval[1] > 0.5
    assert gap.log_odds > 0.0
