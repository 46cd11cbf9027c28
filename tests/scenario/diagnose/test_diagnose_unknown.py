"""A hidden effect that is not in the dictionary gives UNKNOWN, though a listed effect can take its shape without a residual."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest
from blind.cases import ONE, SHORT_PAIRS, TWO, UNLISTED, Case
from blind.experiment import Conditions
from blind.hiding import PROTOTYPE_PX, hidden_effect
from blind.observing import QUICK, observed

from semlive.cli.after_run.confirmation import SimulationRequest, prove
from semlive.data.diagnosis.effects import Outcome
from semlive.data.diagnosis.misfit_reason import MisfitCriterion
from semlive.data.grid import Grid
from semlive.diagnose.baseline.baseline import build_grid
from semlive.diagnose.baseline.bayes_factor import score_candidates
from semlive.diagnose.baseline.model_effects import effect_class
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.baseline.observation import Observation
from semlive.diagnose.maps.effect_selection import SIGNIFICANT_LOG_FACTOR
from semlive.diagnose.maps.refinement import refined
from semlive.diagnose.maps.time_course_test import alternative_time_course_odds
from semlive.diagnose.maps.unnamed_fields import UNNAMED_CLASSES
from semlive.diagnose.maps.verdict import diagnose
from semlive_simulators.effects.charging import ChargingLocalLens

SPARSE = Grid(101, 101, 60, 13, 10, 43)  # a block is a point
GRID = Grid(101, 101, 45, 17, 14, 43)  # a block is a point, too; fewer of them are left than the usual grid has blocks
SHORT = Conditions(505, *SHORT_PAIRS)
DRAWS = 99


def hiding(name: str, times: float = 8.0) -> Observation:
    return observed(SHORT, hidden_effect(name, times * PROTOTYPE_PX[name], 1), GRID, QUICK)


@pytest.fixture(scope="module")
def drifting() -> Observation:
    return hiding("magnification_drift", 16.0)


def test_a_wrong_point_by_itself_is_nothing_without_a_name() -> None:
    right, wrong = (observed(replace(SHORT, outliers=share), (), SPARSE, QUICK) for share in (0.0, 0.001))
    loudest = max(item.log_factor for item in score_candidates(noise_scaled_baseline(wrong), UNNAMED_CLASSES))

    assert len(right.valid_blocks) - 8 <= len(wrong.valid_blocks) < len(right.valid_blocks)  # it is left out, and its neighbours are not
    assert loudest < SIGNIFICANT_LOG_FACTOR


def test_an_effect_that_moves_neighbours_equally_keeps_its_blocks() -> None:
    bump = Case(UNLISTED, ("quadratic_bump",), 0.5, 4003)
    clean = replace(bump.conditions(), calibration=SHORT_PAIRS[0], tension=SHORT_PAIRS[1], outliers=0.0)
    plain, bumped = (observed(clean, effects, SPARSE, QUICK) for effects in ((), bump.effects()))

    assert len(bumped.valid_blocks) == len(plain.valid_blocks)


def course_of(observation: Observation, name: str) -> float:
    """Of what is named whatever else would do."""
    plain = noise_scaled_baseline(observation)
    (received,) = score_candidates(plain, (effect_class(name),))
    named = refined(plain, received)
    return alternative_time_course_odds(build_grid(plain.design.with_effects(named.baseline_effect)), plain.design, [named])


def test_the_law_that_was_hidden_has_no_likelier_course(drifting: Observation) -> None:
    assert course_of(drifting, "magnification_drift") < 3.0


def test_a_wrong_row_time_next_to_a_drift_that_could_walk_has_no_likelier_course() -> None:
    assert course_of(Case(ONE, ("wrong_row_time",), 8.0, 60_007).shortened(GRID, QUICK), "wrong_row_time") < 3.0


def test_a_swing_with_two_shapes_in_a_frame_has_no_likelier_course() -> None:
    assert course_of(Case(ONE, ("thermal_oscillation",), 8.0, 80_004).shortened(GRID, QUICK), "thermal_oscillation") < 3.0


def test_a_charge_that_approaches_its_end_is_one_effect() -> None:
    case = Case(ONE, ("charging_local_lens",), 8.0, 60_007)
    (hidden,) = case.effects()
    assert isinstance(hidden, ChargingLocalLens)
    names = ("charging_local_lens", "magnification_drift", "refocus_magnification_step", "magnification_frame_instability")
    observation = case.observed(GRID, QUICK)
    found = diagnose(observation, dictionary=[effect_class(name) for name in names], draws=DRAWS)
    (reported,) = found.effects
    peak = next(item for item in reported.parameters if item.name == "peak_px")

    assert (found.outcome, reported.name) == (Outcome.IDENTIFIED, "charging_local_lens")
    assert peak.sigma < 0.1 * peak.value
    assert abs(peak.value - hidden.peak_px * -math.expm1(-found.run.duration_s / hidden.charging_s)) < 3.0 * peak.sigma


def test_a_slow_drift_is_no_jump_at_every_step(drifting: Observation) -> None:
    assert course_of(drifting, "refocus_magnification_step") > 7.0


def test_a_jump_within_a_pair_moves_complete_frames_and_is_no_time_course() -> None:
    assert course_of(hiding("jump_within_pair"), "jump_within_pair") < 3.0


def test_without_its_name_an_effect_is_unknown_and_is_not_simulated(drifting: Observation, tmp_path: Path) -> None:
    names = ("refocus_magnification_step", "tilt_with_load", "charging_frame_ramp")
    found = diagnose(drifting, dictionary=[effect_class(name) for name in names], draws=DRAWS)

    assert found.outcome is Outcome.UNKNOWN
    assert [item.name for item in found.effects] == ["refocus_magnification_step"]  # the closest is named
    assert [(reason.criterion, reason.name) for reason in found.unexplained] == [(MisfitCriterion.RESIDUAL, "linear_map_that_wanders")]

    proof = prove(
        found, drifting, tmp_path / "log", lambda path: pytest.fail(f"{path} is written"), SimulationRequest("short", tmp_path), None
    )
    assert (proof.added, proof.comparison, list(tmp_path.iterdir())) == ((), None, [])
    assert "not in the dictionary" in proof.reason
    smooth = next(item for item in proof.channels if item.channel == "x_smooth")
    assert smooth.after is None
    assert smooth.before.value > smooth.expected.value + 5.0 * smooth.expected.sigma


def test_a_bump_that_grows_with_the_square_of_time_is_no_uneven_strain() -> None:
    case = Case(UNLISTED, ("quadratic_bump",), 0.1, 4003)
    few = [effect_class(name) for name in ("inhomogeneous_strain", "magnification_drift", "tilt_with_load")]
    found = diagnose(case.shortened(GRID, QUICK), dictionary=few, draws=DRAWS)

    assert found.outcome is Outcome.UNKNOWN


def test_a_drifting_distortion_is_reported_with_its_undetermined_affine_part() -> None:
    observation = hiding("distortion_scale_drift", 12.0)
    family = effect_class("distortion_scale_drift")
    found = diagnose(observation, dictionary=[family, effect_class("magnification_drift")], draws=DRAWS)
    (as_estimated,) = score_candidates(noise_scaled_baseline(observation), (replace(family, nonlinear_parameters=()),))

    assert found.outcome is Outcome.IDENTIFIED
    assert [item.name for item in found.effects] == ["distortion_scale_drift"]
    assert found.effects[0].log_bayes_factor > as_estimated.log_factor + 3.0


def test_an_effect_that_did_for_two_goes_when_both_are_named() -> None:
    two = ("raster_rotation_drift", "bending_misalignment")
    few = [effect_class(name) for name in (*two, "distortion_scale_drift")]
    found = diagnose(Case(TWO, two, 8.0, 3002).observed(GRID, QUICK), dictionary=few, draws=DRAWS)

    assert found.outcome is Outcome.IDENTIFIED
    assert sorted(item.name for item in found.effects) == sorted(two)
    assert min(item.log_bayes_factor for item in found.effects) > 100.0  # with the other effect, not with the one that replaced both
