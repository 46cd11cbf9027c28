"""A model's effects as the SEM simulator's own: a second, separately written implementation of every name."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import yaml

from semlive.errors import BadConfig
from semlive.inputs.files import read_regular
from semlive.inputs.json_text import parse_json
from semlive.service.diagnosis.model_file import MOST_MODEL_BYTES, read_model

WANDERS_S = 3600.0
"""Time constant of what wanders slowly: a model has its change over the run, the simulator an exponential approach."""
CHARGING_S = 900.0
WORKING_DISTANCE_MM = 14.1
POISSON = 0.33
SEED = 1
_WIDE_PX = 1e6  # of a box that was scanned: all that the frames saw

EffectParameters = Mapping[str, float]


def scenario_yaml(model: Path, scenario: str) -> str:
    """A scenario of the simulator with a model's effects in it.

    Args:
        model: as `semlive diagnose LOG -o MODEL.json` writes it.
        scenario: name or path of the scenario that it extends.

    Raises:
        BadConfig: the file is no model, or has an effect that cannot be simulated from what it says.
    """
    read_model(model)
    plain = parse_json(read_regular(model, MOST_MODEL_BYTES))
    run = plain.get("run", {})
    effects = {}
    for one in plain["effects"]:
        name = one["name"]
        found = {key: float(item["value"]) for key, item in one["parameters"].items()} | dict(one["law"]["values"])
        if name not in SIMULATED_EFFECTS:
            raise BadConfig(f"--from {model}: {name} has no counterpart in the simulator; leave it out of the model.")
        try:
            effects[name] = SIMULATED_EFFECTS[name](found, run)
        except KeyError as error:
            raise BadConfig(f"--from {model}: {name} needs {error.args[0]}, which the model does not say; diagnose again.") from error
    return yaml.safe_dump({"extends": scenario, "effects": effects}, sort_keys=False)


def _slow(own: str) -> Callable[[EffectParameters, EffectParameters], dict[str, Any]]:
    def told(found: EffectParameters, run: EffectParameters) -> dict[str, Any]:
        return {own: found[own] / -math.expm1(-run["end_s"] / WANDERS_S), "time_constant_s": WANDERS_S}

    return told


def _scattered(own: str) -> Callable[[EffectParameters, EffectParameters], dict[str, Any]]:
    return lambda found, run: {own: found[own], "seed": SEED}


def _alike(*names: str, **more: float) -> Callable[[EffectParameters, EffectParameters], dict[str, Any]]:
    return lambda found, run: {**{name: found[name] for name in names}, **more}


def _tilt(found: EffectParameters, run: EffectParameters) -> dict[str, Any]:
    distance_px = 1e3 * WORKING_DISTANCE_MM / run["pixel_size_um"]
    return {"tilt_rad_per_n": found["tilt_over_working_distance_per_n"] * distance_px, "working_distance_mm": WORKING_DISTANCE_MM}


def _lift(found: EffectParameters, run: EffectParameters) -> dict[str, Any]:
    del run
    return {"lift_um_per_n": found["strain_per_n"] * 1e3 * WORKING_DISTANCE_MM, "working_distance_mm": WORKING_DISTANCE_MM}


def _bending(found: EffectParameters, run: EffectParameters) -> dict[str, Any]:
    return {"curvature_per_mm_n": found["curvature_per_n"] / (1e-3 * run["pixel_size_um"]), "poissons_ratio": POISSON}


def _swing(found: EffectParameters, run: EffectParameters) -> dict[str, Any]:
    side = found["amplitude_px"] / math.sqrt(2.0)
    return {"x_px": side, "y_px": side, "period_s": found["period_s"], "phase_rad": 0.0}


def _lens(found: EffectParameters, run: EffectParameters) -> dict[str, Any]:
    place = [found["x_px"] + 0.5 * (run["width_px"] - 1.0), found["y_px"] + 0.5 * (run["height_px"] - 1.0)]
    peak_px = found["peak_px"] / -math.expm1(-run["end_s"] / CHARGING_S)  # what is told is the charge at the end of the run
    return {"peak_px": peak_px, "width_px": found["width_px"], "brightness_levels": 0.0, "charging_s": CHARGING_S, "grains_px": [place]}


def _hum(found: EffectParameters, run: EffectParameters) -> dict[str, Any]:
    del run
    wave = {"amplitude_x_px": found["amplitude_x_px"], "amplitude_y_px": found["amplitude_y_px"], "frequency_hz": found["frequency_hz"]}
    return {**wave, "phase_rad": 0.0}


def _charging_jump(found: EffectParameters, run: EffectParameters) -> dict[str, Any]:
    """As many as flashed, at instants of the simulator's own; their size is known only where one of them is in the maps."""
    flashes = sum(name.endswith("at_s") and name.startswith("flash") for name in found)
    sd_px = math.hypot(found.get("x_px", 0.0), found.get("y_px", 0.0)) / math.sqrt(2.0)
    interval_s = run["end_s"] / max(flashes, 1)
    return {"sd_px": sd_px, "mean_interval_s": interval_s, "flash_levels": found["flash_levels"], "flash_s": found["flash_s"], "seed": SEED}


def _mean(found: EffectParameters, *names: str) -> float:
    """Of both axes: the simulator's stage has one value."""
    return sum(found[name] for name in names) / len(names)


def _vibration(found: EffectParameters, run: EffectParameters) -> dict[str, Any]:
    wave = _hum(found, run)
    del wave["phase_rad"]
    return {**wave, "seed": SEED}


SIMULATED_EFFECTS: dict[str, Callable[[EffectParameters, EffectParameters], dict[str, Any]]] = {
    "magnification_drift": _slow("change"),
    "raster_rotation_drift": _slow("change_rad"),
    "scan_shear_drift": _slow("change"),
    "aspect_drift": _slow("change"),
    "distortion_scale_drift": _slow("change"),
    "magnification_frame_instability": _scattered("sd"),
    "refocus_magnification_step": _scattered("sd"),
    "stage_yaw": _scattered("sd_rad"),
    "tilt_with_load": _tilt,
    "bending_misalignment": _bending,
    "creep_in_hold": _alike("strain_per_n", "onset_s", poissons_ratio=POISSON),
    "load_step_transient": _alike("x_px_per_n", "y_px_per_n", "time_constant_s"),
    "stage_step_transient": _alike("fraction", "time_constant_s"),
    "drift_jump": _alike("x_px", "y_px", "at_s"),
    "jump_within_pair": lambda found, run: {"x_px": found["x_px"], "y_px": found["y_px"], "first_frame": round(found["first_frame"])},
    "wrong_row_time": _alike("row_time_error"),
    "frame_integration": lambda found, run: {"scans": round(1.0 / (1.0 + found["row_time_error"]))},
    "interlaced_scan": _alike(),
    "thermal_oscillation": _swing,
    "charging_frame_ramp": _alike("x_px", "y_px", "charging_s", "dose_s", brightness_levels=0.0),
    "charging_local_lens": _lens,
    "mains_hum": _hum,
    "vibration": _vibration,
    "stage_backlash": lambda found, run: {"backlash_um": _mean(found, "backlash_x_px", "backlash_y_px") * run["pixel_size_um"]},
    "stage_quadratic": lambda found, run: {
        "quadratic_per_um": _mean(found, "quadratic_x_per_px", "quadratic_y_per_px") / run["pixel_size_um"]
    },
    "contamination": lambda found, run: {"loss_per_s": found["loss_per_s"], "box_width_px": _WIDE_PX, "box_height_px": _WIDE_PX},
    "defocus": _alike("blur_px_per_s", magnification_per_px=0.0),
    "gamma_change": _alike("gain", "gamma", "offset_levels", "at_s"),
    "charging_jump": _charging_jump,
    "row_jitter": lambda found, run: {"sd_px": found["sd_x_px"], "seed": SEED},
    "load_cell_zero": _alike("zero_n"),
    "load_cell_drift": _alike("rate_n_per_s"),
    "friction_hysteresis": _alike("friction_n"),
    "out_of_plane_translation": _lift,
    "timestamp_offset": _alike("offset_s"),
}
