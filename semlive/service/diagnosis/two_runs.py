"""Decision between what one run leaves open: its log beside that of the experiment that was proposed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from semlive.data.diagnosis.effects import ModelEffect
from semlive.data.diagnosis.two_runs import ScanRotation, SharedEffect, TwoRunVerdict
from semlive.diagnose.baseline.model_effects import add_model_effects, observable_effects
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.two_runs.decide import compare_runs
from semlive.model.effects.stage import non_map_effect
from semlive.service.diagnosis.run import load_observation, parameters_json


def compare_logs(
    logs: Sequence[Path], watch: Callable[[str, int, int], None] | None = None, model_effects: Sequence[ModelEffect] = ()
) -> TwoRunVerdict:
    """What runs of one specimen with different scans show together.

    Args:
        logs: files, or run folders.
        watch: told what is done, how much of it, of how much.
        known: effects that the model has already.

    Raises:
        BadInput: a log cannot be read, its data are too few, or the runs do not fit each other.
    """
    in_maps = [one for one in model_effects if non_map_effect(one.name) is None]
    runs = []
    for log in logs:
        seen = load_observation(log, watch)
        runs.append(add_model_effects(noise_scaled_baseline(seen), observable_effects(seen, in_maps))[0])
    return compare_runs(runs)


def decision_json(found: TwoRunVerdict) -> dict[str, Any]:
    """As other programs read it (`semlive experiment decide LOG OTHER --json`); only ever extended."""
    return {
        "outcome": found.outcome.value,
        "effect": None if found.effect is None else _effect_json(found.effect),
        "effects": [_effect_json(one) for one in found.effects],
        "ambiguous": list(found.ambiguous),
        "evidence": dict(found.evidence),
        "apart": found.separate_log_odds,
        "turned": None if found.turned is None else _turned_json(found.turned),
    }


def _effect_json(one: SharedEffect) -> dict[str, Any]:
    return {"name": one.name, "peak_px": one.peak_px, "parameters": parameters_json(one.parameters)}


def _turned_json(one: ScanRotation) -> dict[str, Any]:
    told = parameters_json((one.angle_rad, one.x_excess, one.skew))
    return {"parameters": told, "distortion_of": one.follows or None, "of_scan": one.of_scan}
