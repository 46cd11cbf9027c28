"""What experiments are foretold to decide, against what simulations of them decide."""

from __future__ import annotations

from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
from blind.experiment import Conditions
from blind.hiding import hidden_effect
from blind.observing import QUICK, observed
from numexp.world import SCAN
from rich.console import Console

from semlive.cli.after_run.forecast_table import forecast_table
from semlive.data.diagnosis.effects import IdentifiedEffect, ModelEffect, Outcome
from semlive.data.diagnosis.verdict import Diagnosis, ExperimentForecast, ExperimentProposal
from semlive.data.grid import Grid
from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.bayes_factor import score_candidates
from semlive.diagnose.baseline.model_effects import effect_class
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.baseline.observation import Observation
from semlive.diagnose.experiments.expected_odds import NOTHING, expected_odds, log_odds, predict_effect
from semlive.diagnose.experiments.forecast import forecast_experiments, planned_run
from semlive.diagnose.experiments.proposals import ExperimentKind, choose_proposal, ranked
from semlive.diagnose.experiments.simulated_run import simulate_baseline
from semlive.diagnose.maps.refinement import RefinedEffect, refined

GRID = Grid(101, 101, 45, 17, 14, 43)
CONFUSABLE = ("raster_rotation_drift", "stage_yaw")


@pytest.fixture(scope="module")
def turning() -> Observation:
    return observed(Conditions(7), hidden_effect(CONFUSABLE[0], 0.08, 7), GRID, QUICK)


@pytest.fixture(scope="module")
def before(turning: Observation) -> HyperparameterGrid:
    return noise_scaled_baseline(turning)


def found(before: HyperparameterGrid, *names: str) -> list[RefinedEffect]:
    return [refined(before, entry) for entry in score_candidates(before, [effect_class(name) for name in names])]


def verdict(*names: str, ambiguous: bool = True) -> Diagnosis:
    effect = IdentifiedEffect(names[0], (), 0.1, 20.0, 0.003, False, ModelEffect(names[0], (), 0.1))
    outcome = Outcome.AMBIGUOUS if ambiguous else Outcome.IDENTIFIED
    return Diagnosis(outcome, (effect,), names if ambiguous else (), None, None, None, (), 0.01)


@pytest.mark.parametrize("dwell", [1.0, 2.0])
def test_simulations_of_an_experiment_give_the_odds_that_were_predicted(
    turning: Observation, before: HyperparameterGrid, dwell: float
) -> None:
    rivals = found(before, *CONFUSABLE)
    ahead = simulate_baseline(
        before, planned_run(turning, ExperimentKind.REPEAT if dwell == 1.0 else ExperimentKind.CHANGED_SCAN_TIMES, dwell)
    )
    expected = expected_odds(ahead, [predict_effect(ahead, before, entry) for entry in rivals])
    scan = replace(SCAN, dwell_time_s=dwell * SCAN.dwell_time_s, frame_time_s=dwell * SCAN.frame_time_s)

    given = []
    for seed in (21, 22, 23):
        conditions = Conditions(seed, tension=0, bent_like=7, scan=scan, noise_px=0.02 / dwell**0.5)
        after = noise_scaled_baseline(observed(conditions, hidden_effect(CONFUSABLE[0], 0.08, 7), GRID, QUICK))
        given.append(log_odds(after, [predict_effect(after, before, entry) for entry in rivals])[0, 1])

    assert expected[0, 1] > 5.0
    assert 0.5 < np.mean(given) / expected[0, 1] < 1.6
    assert np.array_equal(np.diag(expected), np.zeros(2))


def test_a_rehearsal_has_the_blocks_noise_and_smoothness_of_the_run_before(turning: Observation, before: HyperparameterGrid) -> None:
    ahead = simulate_baseline(before, planned_run(turning, ExperimentKind.CHANGED_SCAN_TIMES, 4.0))

    assert np.array_equal(ahead.design.observation.valid_blocks, turning.valid_blocks)
    assert ahead.design.whiten.sigma_px == pytest.approx(0.5 * before.design.whiten.sigma_px)
    assert ahead.best.hyper == before.best.hyper
    scene = ahead.design.observation.geometry
    assert scene.time_in_row_s.max() == pytest.approx(4.0 * turning.geometry.time_in_row_s.max(), rel=0.02)
    # A picture that stays in its place shows no distortion: the drift of the run before is in it, and the moves.
    moved = scene.disparity_px.mean(axis=1)
    assert np.ptp(moved, axis=0).min() > 20.0


def test_an_error_of_the_row_time_is_the_same_where_rows_take_twice_as_long(turning: Observation, before: HyperparameterGrid) -> None:
    (entry,) = found(before, "wrong_row_time")
    ahead = simulate_baseline(before, planned_run(turning, ExperimentKind.CHANGED_SCAN_TIMES, 2.0))
    printed, scene = predict_effect(ahead, before, entry), ahead.design.observation.geometry
    (error,) = (item.value for item in entry.parameters if item.name == "row_time_error")

    assert scene.time_in_frame_s.max() > 1.9 * turning.geometry.time_in_frame_s.max()
    assert printed.field_px @ printed.mean == pytest.approx(error * scene.drift_rate_px_s * scene.time_in_frame_s[..., None], abs=1e-9)


def test_experiments_differ_in_time_loads_and_moves(turning: Observation) -> None:
    runs = {kind: planned_run(turning, kind) for kind in ExperimentKind if kind is not ExperimentKind.ROTATED_SCAN}
    again = runs[ExperimentKind.REPEAT]

    assert len(again.steps) == 8
    assert not any(entry.load_n for entry in again.steps)
    assert len(runs[ExperimentKind.STATIONARY_SERIES].steps) == 10
    assert not any(any(entry.shift_px) for entry in runs[ExperimentKind.STATIONARY_SERIES].steps)
    assert len(runs[ExperimentKind.UNLOAD].steps) == 8 + 7 + 6
    assert len(runs[ExperimentKind.ZERO_LOAD_STEPS].steps) == 8 + 14
    longer = runs[ExperimentKind.LONGER_HOLD]
    assert {entry.hold_s for entry in longer.steps} == {120.0}
    assert longer.duration_s == pytest.approx(15 * (again.duration_s / 8 + 90.0))
    assert (
        planned_run(turning, ExperimentKind.CHANGED_SCAN_TIMES, 0.5).duration_s
        < again.duration_s
        < planned_run(turning, ExperimentKind.CHANGED_SCAN_TIMES, 2.0).duration_s
    )


def test_what_has_happened_or_goes_with_moves_reports_nothing_of_a_parked_run(turning: Observation, before: HyperparameterGrid) -> None:
    ahead = simulate_baseline(before, planned_run(turning, ExperimentKind.STATIONARY_SERIES))
    yaw, rotation = (predict_effect(ahead, before, entry) for entry in found(before, "stage_yaw", "raster_rotation_drift"))
    (jump,) = (predict_effect(ahead, before, entry) for entry in found(before, "jump_within_pair"))

    assert (len(yaw.mean), len(jump.mean), len(rotation.mean)) == (0, 0, 4)
    printed = expected_odds(ahead, [yaw, jump, rotation])
    assert printed[0, 1] == printed[1, 0] == 0.0
    assert printed[0, 2] == pytest.approx(printed[1, 2])
    assert printed[0, 2] > 0.0  # no effect is detected, which is evidence against one that should be visible


def test_an_open_question_gets_experiments_ordered_by_information_per_minute(turning: Observation) -> None:
    menu = forecast_experiments(turning, verdict(*CONFUSABLE))

    kinds = {(entry.kind, entry.dwell) for entry in menu}
    unloaded = {("parked", 1.0), ("again", 1.0), ("reversed", 1.0), ("other_scan", 0.5), ("other_scan", 2.0)}
    assert kinds == unloaded | {("longer_hold", 1.0), ("dummy_steps", 1.0), ("unload", 1.0)}
    rates = [entry.log_odds_per_minute for entry in menu]
    assert rates == sorted(rates, reverse=True)
    assert {(entry.true, entry.other) for entry in menu} <= {CONFUSABLE, CONFUSABLE[::-1]}
    # Nothing turns with moves in a parked run, but drift and a distortion that it does not show take a turning raster up.
    least = {entry.kind: entry.log_odds for entry in menu if entry.dwell == 1.0}
    assert least["parked"] < least["again"] < least["reversed"]


def test_an_effect_is_separable_from_none_and_a_synonym_is_not_predictable(turning: Observation) -> None:
    alone = forecast_experiments(turning, verdict(CONFUSABLE[0], ambiguous=False))
    assert {entry for each in alone for entry in (each.true, each.other)} == {CONFUSABLE[0], "nothing"}
    assert forecast_experiments(turning, verdict(CONFUSABLE[0], "hv_drift")) == ()
    assert NOTHING.name == "nothing"


def test_the_experiment_that_decides_in_the_least_time_is_proposed() -> None:
    slow = ExperimentForecast("other_scan", 2.0, 60.0, 12.0, *CONFUSABLE)
    weak = ExperimentForecast("parked", 1.0, 5.0, 2.0, *CONFUSABLE)
    requests = replace(verdict(*CONFUSABLE), experiment=ExperimentProposal(CONFUSABLE, "park the stage", (weak, slow)))

    chosen = choose_proposal(requests)
    assert chosen is not None
    assert (chosen.kind, chosen.forecast) == (ExperimentKind.CHANGED_SCAN_TIMES, slow)
    undecided = choose_proposal(replace(requests, experiment=ExperimentProposal(CONFUSABLE, "park the stage", (weak,))))
    assert undecided is not None
    assert (undecided.kind, undecided.forecast) == (ExperimentKind.STATIONARY_SERIES, None)
    assert weak.log_odds_per_minute == pytest.approx(0.4)
    assert slow.summary == "other scan, 2 times the dwell"

    reported = ranked(ExperimentProposal(CONFUSABLE, "park the stage"), (weak, slow))
    assert reported.about.startswith("other scan, 2 times the dwell, 60 minutes: effects that follow the dwell")
    assert reported.about.endswith("(or: park the stage)")
    assert reported.forecasts == (weak, slow)
    assert ranked(ExperimentProposal(CONFUSABLE, "park the stage"), (weak,)).about == "park the stage"

    console = Console(width=160, record=True, file=StringIO())
    console.print(forecast_table((weak, slow)))
    lines = [line.split("│") for line in console.export_text().splitlines() if "│" in line]
    assert [[cell.strip() for cell in line[1:5]] for line in lines] == [
        ["parked", "5", "2.0", "0.40"],
        ["other scan, 2 times the dwell", "60", "12.0", "0.20"],
    ]
