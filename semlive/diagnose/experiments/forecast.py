"""Forecast of possible next experiments: expected log odds and beam time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import permutations

import numpy as np

from semlive.data.diagnosis.effects import ModelEffect, Outcome
from semlive.data.diagnosis.verdict import Diagnosis, ExperimentForecast
from semlive.data.experiment import Phase
from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.bayes_factor import score_candidates
from semlive.diagnose.baseline.model_effects import add_model_effects, effect_class, observable_effects
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.baseline.observation import MIN_PAIRS, Observation
from semlive.diagnose.experiments.expected_odds import NOTHING, expected_odds, predict_effect
from semlive.diagnose.experiments.proposals import ExperimentKind
from semlive.diagnose.experiments.protocols import Protocol, protocol_for
from semlive.diagnose.experiments.simulated_run import PlannedRun, PlannedStep, simulate_baseline
from semlive.diagnose.maps.refinement import RefinedEffect, refined
from semlive.errors import IllPosed
from semlive.model.effects import EFFECT_CLASSES

MAX_PAIRS = 32  # limit of the diagnosis
UNLOADED_KINDS = (ExperimentKind.STATIONARY_SERIES, ExperimentKind.REPEAT, ExperimentKind.REVERSED, ExperimentKind.CHANGED_SCAN_TIMES)
SCAN_TIME_RATIOS = (0.5, 2.0)
LOADED_KINDS = (ExperimentKind.LONGER_HOLD, ExperimentKind.ZERO_LOAD_STEPS, ExperimentKind.UNLOAD)


def forecast_experiments(
    observation: Observation, verdict: Diagnosis, model_effects: Sequence[ModelEffect] = ()
) -> tuple[ExperimentForecast, ...]:
    """Forecasts of possible experiments for the remaining candidates (one effect: against none), best log odds per minute first.

    The experiments use the equipment of the run: loads, moves, another dwell. A rotated scan is not included, because no basis field
    describes effects that rotate with the scan. The result is empty if the candidates have one common basis field.

    Args:
        observation: observation of the run.
        verdict: the verdict.
        model_effects: effects of the model before the diagnosis.
    """
    effects = {family.name for family in EFFECT_CLASSES}
    between = verdict.ambiguous or tuple(effect.name for effect in verdict.effects)
    candidate_names = dict.fromkeys(
        effect.model_effect.name for effect in verdict.effects if effect.name in between and effect.model_effect.name in effects
    )
    candidate_names |= dict.fromkeys(name for name in between if name in effects)
    if not candidate_names or (verdict.outcome is Outcome.AMBIGUOUS and len(candidate_names) < 2):
        return ()
    common_effects = [
        model_effect
        for model_effect in (*model_effects, *(effect.model_effect for effect in verdict.effects))
        if model_effect.name in effects and model_effect.name not in candidate_names
    ]
    common_effects = observable_effects(observation, common_effects)
    before = add_model_effects(noise_scaled_baseline(observation), common_effects)[0]
    rivals = [refined(before, candidate) for candidate in score_candidates(before, [effect_class(name) for name in candidate_names])]
    forecasts = [_forecast(kind, run, before, rivals, common_effects) for kind, run in _possible_runs(observation)]
    return tuple(sorted((value for value in forecasts if value is not None), key=lambda candidate: -candidate.log_odds_per_minute))


def _forecast(
    kind: ExperimentKind,
    run: PlannedRun,
    before: HyperparameterGrid,
    rivals: Sequence[RefinedEffect],
    common_effects: Sequence[ModelEffect],
) -> ExperimentForecast | None:
    try:
        simulated = simulate_baseline(before, run, common_effects)
    except IllPosed:
        return None  # too few data for a diagnosis
    predictions = [predict_effect(simulated, before, rival) for rival in rivals]
    if not any(len(value.mean) for value in predictions):
        return None  # none of the effects is observable
    predictions += [NOTHING] if len(predictions) == 1 else []
    odds = expected_odds(simulated, predictions)
    true, rival = min(permutations(range(len(predictions)), 2), key=lambda pair: float(odds[pair]))
    return ExperimentForecast(
        kind.value, run.scan_time_ratio, run.duration_s / 60.0, float(odds[true, rival]), predictions[true].name, predictions[rival].name
    )


def _possible_runs(observation: Observation) -> Iterator[tuple[ExperimentKind, PlannedRun]]:
    protocol = _protocol(observation)
    moved, loaded = any(any(value) for value in protocol["calibration_shifts_px"]), any(protocol["loads_n"])
    for kind in (*(UNLOADED_KINDS if moved else (ExperimentKind.STATIONARY_SERIES,)), *(LOADED_KINDS if loaded else ())):
        for scan_time_ratio in SCAN_TIME_RATIOS if kind is ExperimentKind.CHANGED_SCAN_TIMES else (1.0,):
            run = planned_run(observation, kind, scan_time_ratio)
            if MIN_PAIRS <= len(run.steps) <= MAX_PAIRS:
                yield kind, run


def _protocol(observation: Observation) -> Protocol:
    """The run as the protocol section of a configuration."""
    scene = observation.geometry
    place = np.cumsum(scene.steps.move_px[::2], axis=0)
    loads = 0.5 * (scene.steps.load_n[::2] + scene.steps.load_n[1::2])
    return {
        "calibration_shifts_px": place[~scene.steps.gradient_free[::2]].tolist(),
        "loads_n": loads[scene.steps.loaded[::2]].tolist(),
        "hold_s": float(scene.steps.since_step_s[0]),
    }


def planned_run(observation: Observation, kind: ExperimentKind, scan_time_ratio: float = 1.0) -> PlannedRun:
    """A planned experiment with the timing of a run, extended by longer holds and scans.

    Args:
        observation: observation of the run.
        kind: kind of the experiment.
        scan_time_ratio: dwell, row and frame time, as a multiple of those of the run.
    """
    scene, protocol = observation.geometry, protocol_for(_protocol(observation), kind)
    extra_scan_s = (scan_time_ratio - 1.0) * observation.state.frame_time(int(scene.frame[0])).timing.duration_s
    extra_hold_s = protocol["hold_s"] - float(scene.steps.since_step_s[0])
    interval_s = float(np.median(scene.start_s[1::2] - scene.start_s[::2])) + extra_scan_s
    pair_interval_s = float(np.median(np.diff(scene.start_s[::2]) / np.diff(scene.pair[::2]))) + 2.0 * extra_scan_s + extra_hold_s
    steps = [(Phase.CALIBRATION, 0.0, tuple(value)) for value in protocol["calibration_shifts_px"]]
    steps += [(Phase.TENSION, load, (0.0, 0.0)) for load in protocol["loads_n"]]
    planned_steps = [
        PlannedStep(phase, load, shift, protocol["hold_s"], (pair_interval_s * at, pair_interval_s * at + interval_s))
        for at, (phase, load, shift) in enumerate(steps)
    ]
    return PlannedRun(tuple(planned_steps), scan_time_ratio, pair_interval_s * len(planned_steps))
