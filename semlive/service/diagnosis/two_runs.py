"""Comparison of the logs of two runs, the second one the proposed experiment."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from semlive.data.diagnosis.effects import ModelEffect
from semlive.data.diagnosis.two_runs import ScanRotation, SharedEffect, TwoRunVerdict
from semlive.diagnose.baseline.model_effects import add_model_effects, observable_effects
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.two_runs.decide import compare_runs
from semlive.model.effects.stage import non_map_effect
from semlive.service.diagnosis.run import load_observation
from semlive.service.diagnosis.verdict_json import parameters_json
from semlive.service.log.opened_log import OpenedLog


def compare_logs(
    logs: Sequence[OpenedLog], watch: Callable[[str, int, int], None] | None = None, model_effects: Sequence[ModelEffect] = ()
) -> TwoRunVerdict:
    """Joint verdict of runs of one specimen with different scans.

    Args:
        logs: logs whose messages were not read yet.
        watch: called with the name of the task, the finished part and the total.
        model_effects: effects already in the model.

    Raises:
        BadInput: a log cannot be read, its data are too few, or the runs cannot be compared.
    """
    in_maps = [effect for effect in model_effects if non_map_effect(effect.name) is None]
    runs = []
    for log in logs:
        observation = load_observation(log, watch)
        runs.append(add_model_effects(noise_scaled_baseline(observation), observable_effects(observation, in_maps))[0])
    return compare_runs(runs)


def decision_json(verdict: TwoRunVerdict) -> dict[str, object]:
    """JSON object of the verdict (`semlive experiment decide LOG OTHER --json`); it is only extended."""
    return {
        "outcome": verdict.outcome.value,
        "effect": None if verdict.effect is None else _effect_json(verdict.effect),
        "effects": [_effect_json(effect) for effect in verdict.effects],
        "ambiguous": list(verdict.ambiguous),
        "evidence": dict(verdict.evidence),
        "apart": verdict.separate_log_odds,
        "turned": None if verdict.turned is None else _turned_json(verdict.turned),
        "pixel_ratio": verdict.pixel_ratio,
    }


def _effect_json(effect: SharedEffect) -> dict[str, object]:
    return {"name": effect.name, "peak_px": effect.peak_px, "parameters": parameters_json(effect.parameters)}


def _turned_json(rotation: ScanRotation) -> dict[str, object]:
    parameters = parameters_json((rotation.angle_rad, rotation.x_excess, rotation.skew))
    return {"parameters": parameters, "distortion_of": rotation.follows or None, "of_scan": rotation.of_scan}
