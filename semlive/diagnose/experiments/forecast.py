"""What the experiments that a run could be followed by are expected to decide, and how much beam time they take."""

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

MOST_PAIRS = 32  # that diagnosis takes
UNLOADED_KINDS = (ExperimentKind.STATIONARY_SERIES, ExperimentKind.REPEAT, ExperimentKind.REVERSED, ExperimentKind.CHANGED_SCAN_TIMES)
SCAN_TIME_RATIOS = (0.5, 2.0)
LOADED = (ExperimentKind.LONGER_HOLD, ExperimentKind.ZERO_LOAD_STEPS, ExperimentKind.UNLOAD)


def forecast_experiments(
    observation: Observation, found: Diagnosis, model_effects: Sequence[ModelEffect] = ()
) -> tuple[ExperimentForecast, ...]:
    """What each experiment would decide between the effects that are left open, or of one effect against nothing; the most a minute first.

    Experiments are those that need nothing the run did not have: loads, moves, another dwell. What turns with the scan is in no law, so
    a turned scan is not among them. None where the names that are left open are one effect to a map.

    Args:
        observation: what the run shows.
        found: the verdict.
        model_effects: effects that the model had before.
    """
    effects = {family.name for family in EFFECT_CLASSES}
    between = found.ambiguous or tuple(effect.name for effect in found.effects)
    gradient = dict.fromkeys(
        effect.model_effect.name for effect in found.effects if effect.name in between and effect.model_effect.name in effects
    )
    gradient |= dict.fromkeys(name for name in between if name in effects)
    if not gradient or (found.outcome is Outcome.AMBIGUOUS and len(gradient) < 2):
        return ()
    common_effects = [
        model_effect
        for model_effect in (*model_effects, *(effect.model_effect for effect in found.effects))
        if model_effect.name in effects and model_effect.name not in gradient
    ]
    common_effects = observable_effects(observation, common_effects)
    before = add_model_effects(noise_scaled_baseline(observation), common_effects)[0]
    rivals = [refined(before, score_candidate) for score_candidate in score_candidates(before, [effect_class(name) for name in gradient])]
    forecasts = [_told(kind, run, before, rivals, common_effects) for kind, run in _menu(observation)]
    return tuple(sorted((value for value in forecasts if value is not None), key=lambda candidate: -candidate.log_odds_per_minute))


def _told(
    kind: ExperimentKind,
    run: PlannedRun,
    before: HyperparameterGrid,
    rivals: Sequence[RefinedEffect],
    common_effects: Sequence[ModelEffect],
) -> ExperimentForecast | None:
    try:
        ahead = simulate_baseline(before, run, common_effects)
    except IllPosed:
        return None  # it leaves too little to diagnose
    predictions = [predict_effect(ahead, before, rival) for rival in rivals]
    if not any(len(value.mean) for value in predictions):
        return None  # it shows none of them
    predictions += [NOTHING] if len(predictions) == 1 else []
    odds = expected_odds(ahead, predictions)
    true, other = min(permutations(range(len(predictions)), 2), key=lambda pair: float(odds[pair]))
    return ExperimentForecast(
        kind.value, run.scan_time_ratio, run.duration_s / 60.0, float(odds[true, other]), predictions[true].name, predictions[other].name
    )


def _menu(observation: Observation) -> Iterator[tuple[ExperimentKind, PlannedRun]]:
    protocol = _protocol(observation)
    moved, loaded = any(any(value) for value in protocol["calibration_shifts_px"]), any(protocol["loads_n"])
    for kind in (*(UNLOADED_KINDS if moved else (ExperimentKind.STATIONARY_SERIES,)), *(LOADED if loaded else ())):
        for dwell in SCAN_TIME_RATIOS if kind is ExperimentKind.CHANGED_SCAN_TIMES else (1.0,):
            run = planned_run(observation, kind, dwell)
            if MIN_PAIRS <= len(run.steps) <= MOST_PAIRS:
                yield kind, run


def _protocol(observation: Observation) -> Protocol:
    """What the run did, as its configuration would say it."""
    scene = observation.geometry
    place = np.cumsum(scene.move_px[::2], axis=0)
    loads = 0.5 * (scene.load_n[::2] + scene.load_n[1::2])
    return {
        "calibration_shifts_px": place[~scene.gradient_free[::2]].tolist(),
        "loads_n": loads[scene.loaded[::2]].tolist(),
        "hold_s": float(scene.since_step_s[0]),
    }


def planned_run(observation: Observation, kind: ExperimentKind, dwell: float = 1.0) -> PlannedRun:
    """An experiment after a run: in time as the run was, longer by what is held or scanned longer.

    Args:
        observation: what the run shows.
        kind: of the experiment.
        dwell: dwell, row and frame time, of those of the run.
    """
    scene, protocol = observation.geometry, protocol_for(_protocol(observation), kind)
    longer_s = (dwell - 1.0) * observation.state.frame_time(int(scene.frame[0])).timing.duration_s
    held_s = protocol["hold_s"] - float(scene.since_step_s[0])
    apart_s = float(np.median(scene.start_s[1::2] - scene.start_s[::2])) + longer_s
    each_s = float(np.median(np.diff(scene.start_s[::2]))) + 2.0 * longer_s + held_s
    steps = [(Phase.CALIBRATION, 0.0, tuple(value)) for value in protocol["calibration_shifts_px"]]
    steps += [(Phase.TENSION, load, (0.0, 0.0)) for load in protocol["loads_n"]]
    orders = [
        PlannedStep(phase, load, shift, protocol["hold_s"], (each_s * at, each_s * at + apart_s))
        for at, (phase, load, shift) in enumerate(steps)
    ]
    return PlannedRun(tuple(orders), dwell, each_s * len(orders))
