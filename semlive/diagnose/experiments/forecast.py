"""What the experiments that a run could be followed by are expected to decide, and how much beam time they take."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import permutations

import numpy as np

from semlive.data.diagnosis import Diagnosis, ExperimentForecast, ModelEffect, Outcome
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


def forecast_experiments(seen: Observation, found: Diagnosis, known: Sequence[ModelEffect] = ()) -> tuple[ExperimentForecast, ...]:
    """What each experiment would decide between the effects that are left open, or of one effect against nothing; the most a minute first.

    Experiments are those that need nothing the run did not have: loads, moves, another dwell. What turns with the scan is in no law, so
    a turned scan is not among them. None where the names that are left open are one effect to a map.

    Args:
        seen: what the run shows.
        found: the verdict.
        known: effects that the model had before.
    """
    named = {one.name for one in EFFECT_CLASSES}
    between = found.ambiguous or tuple(one.name for one in found.effects)
    asked = dict.fromkeys(one.model_effect.name for one in found.effects if one.name in between and one.model_effect.name in named)
    asked |= dict.fromkeys(name for name in between if name in named)
    if not asked or (found.outcome is Outcome.AMBIGUOUS and len(asked) < 2):
        return ()
    beside = [one for one in (*known, *(one.model_effect for one in found.effects)) if one.name in named and one.name not in asked]
    beside = observable_effects(seen, beside)
    before = add_model_effects(noise_scaled_baseline(seen), beside)[0]
    rivals = [refined(before, one) for one in score_candidates(before, [effect_class(name) for name in asked])]
    told = [_told(kind, run, before, rivals, beside) for kind, run in _menu(seen)]
    return tuple(sorted((one for one in told if one is not None), key=lambda one: -one.log_odds_per_minute))


def _told(
    kind: ExperimentKind, run: PlannedRun, before: HyperparameterGrid, rivals: Sequence[RefinedEffect], beside: Sequence[ModelEffect]
) -> ExperimentForecast | None:
    try:
        ahead = simulate_baseline(before, run, beside)
    except IllPosed:
        return None  # it leaves too little to diagnose
    said = [predict_effect(ahead, before, one) for one in rivals]
    if not any(len(one.mean) for one in said):
        return None  # it shows none of them
    said += [NOTHING] if len(said) == 1 else []
    odds = expected_odds(ahead, said)
    true, other = min(permutations(range(len(said)), 2), key=lambda pair: float(odds[pair]))
    return ExperimentForecast(
        kind.value, run.scan_time_ratio, run.duration_s / 60.0, float(odds[true, other]), said[true].name, said[other].name
    )


def _menu(seen: Observation) -> Iterator[tuple[ExperimentKind, PlannedRun]]:
    protocol = _protocol(seen)
    moved, loaded = any(any(one) for one in protocol["calibration_shifts_px"]), any(protocol["loads_n"])
    for kind in (*(UNLOADED_KINDS if moved else (ExperimentKind.STATIONARY_SERIES,)), *(LOADED if loaded else ())):
        for dwell in SCAN_TIME_RATIOS if kind is ExperimentKind.CHANGED_SCAN_TIMES else (1.0,):
            run = planned_run(seen, kind, dwell)
            if MIN_PAIRS <= len(run.steps) <= MOST_PAIRS:
                yield kind, run


def _protocol(seen: Observation) -> Protocol:
    """What the run did, as its configuration would say it."""
    scene = seen.geometry
    place = np.cumsum(scene.move_px[::2], axis=0)
    loads = 0.5 * (scene.load_n[::2] + scene.load_n[1::2])
    return {
        "calibration_shifts_px": place[~scene.gradient_free[::2]].tolist(),
        "loads_n": loads[scene.loaded[::2]].tolist(),
        "hold_s": float(scene.since_step_s[0]),
    }


def planned_run(seen: Observation, kind: ExperimentKind, dwell: float = 1.0) -> PlannedRun:
    """An experiment after a run: in time as the run was, longer by what is held or scanned longer.

    Args:
        seen: what the run shows.
        kind: of the experiment.
        dwell: dwell, row and frame time, of those of the run.
    """
    scene, protocol = seen.geometry, protocol_for(_protocol(seen), kind)
    longer_s = (dwell - 1.0) * seen.state.frame_time(int(scene.frame[0])).timing.duration_s
    held_s = protocol["hold_s"] - float(scene.since_step_s[0])
    apart_s = float(np.median(scene.start_s[1::2] - scene.start_s[::2])) + longer_s
    each_s = float(np.median(np.diff(scene.start_s[::2]))) + 2.0 * longer_s + held_s
    steps = [(Phase.CALIBRATION, 0.0, tuple(one)) for one in protocol["calibration_shifts_px"]]
    steps += [(Phase.TENSION, load, (0.0, 0.0)) for load in protocol["loads_n"]]
    told = [
        PlannedStep(phase, load, shift, protocol["hold_s"], (each_s * at, each_s * at + apart_s))
        for at, (phase, load, shift) in enumerate(steps)
    ]
    return PlannedRun(tuple(told), dwell, each_s * len(told))
