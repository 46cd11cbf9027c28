"""Translation of a model's effects into parameters of the SEM simulator, which implements them independently."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import yaml

from semlive.errors import BadConfig
from semlive.inputs.files import read_regular
from semlive.inputs.json_text import parse_json
from semlive.model.effects.maps.apparent_motion import CHARGING_LOCAL_LENS
from semlive.service.diagnosis.model_file import MAX_MODEL_BYTES, read_model

WANDERS_S = 3600.0
"""Time constant of slow drifts in the simulator, an exponential approach; a model contains the change over the run."""
CHARGING_S = 900.0
WORKING_DISTANCE_MM = 14.1
POISSON = 0.33
SEED = 1
_WIDE_PX = 1e6  # size of the contaminated box: larger than the frames

EffectParameters = Mapping[str, float]


def scenario_yaml(model: Path, scenario: str) -> str:
    """A scenario of the simulator with the effects of a model.

    Args:
        model: path of a file by `semlive diagnose LOG -o MODEL.json`.
        scenario: name or path of the scenario to extend.

    Raises:
        BadConfig: the file is no model, or contains an effect that cannot be simulated from its parameters.
    """
    read_model(model)
    plain = parse_json(read_regular(model, MAX_MODEL_BYTES))
    run = plain.get("run", {})
    effects: dict[str, dict[str, object]] = {}
    spots: list[EffectParameters] = []
    for effect in plain["effects"]:
        name = effect["name"]
        values = {key: float(item["value"]) for key, item in effect["parameters"].items()} | dict(effect["law"]["values"])
        if name not in SIMULATED_EFFECTS:
            raise BadConfig(f"--from {model}: {name} has no counterpart in the simulator; leave it out of the model.")
        try:
            effects[name] = SIMULATED_EFFECTS[name](values, run)
        except KeyError as error:
            raise BadConfig(f"--from {model}: {name} needs {error.args[0]}, which the model does not contain; diagnose again.") from error
        spots += [values] if name == CHARGING_LOCAL_LENS.name else []
    if len(spots) > 1:
        effects[CHARGING_LOCAL_LENS.name] = _lenses(spots, run)
    return yaml.safe_dump({"extends": scenario, "effects": effects}, sort_keys=False)


def _slow(own: str) -> Callable[[EffectParameters, EffectParameters], dict[str, object]]:
    def with_time_constant(values: EffectParameters, run: EffectParameters) -> dict[str, object]:
        return {own: values[own] / -math.expm1(-run["end_s"] / WANDERS_S), "time_constant_s": WANDERS_S}

    return with_time_constant


def _scattered(own: str) -> Callable[[EffectParameters, EffectParameters], dict[str, object]]:
    return lambda values, run: {own: values[own], "seed": SEED}


def _same_names(*names: str, **more: float) -> Callable[[EffectParameters, EffectParameters], dict[str, object]]:
    return lambda values, run: {**{name: values[name] for name in names}, **more}


def _tilt(values: EffectParameters, run: EffectParameters) -> dict[str, object]:
    distance_px = 1e3 * WORKING_DISTANCE_MM / run["pixel_size_um"]
    return {"tilt_rad_per_n": values["tilt_over_working_distance_per_n"] * distance_px, "working_distance_mm": WORKING_DISTANCE_MM}


def _lift(values: EffectParameters, run: EffectParameters) -> dict[str, object]:
    del run
    return {"lift_um_per_n": values["strain_per_n"] * 1e3 * WORKING_DISTANCE_MM, "working_distance_mm": WORKING_DISTANCE_MM}


def _bending(values: EffectParameters, run: EffectParameters) -> dict[str, object]:
    return {"curvature_per_mm_n": values["curvature_per_n"] / (1e-3 * run["pixel_size_um"]), "poissons_ratio": POISSON}


def _swing(values: EffectParameters, run: EffectParameters) -> dict[str, object]:
    side = values["amplitude_px"] / math.sqrt(2.0)
    return {"x_px": side, "y_px": side, "period_s": values["period_s"], "phase_rad": 0.0}


def _lens(values: EffectParameters, run: EffectParameters) -> dict[str, object]:
    return _lenses([values], run)


def _lenses(spots: Sequence[EffectParameters], run: EffectParameters) -> dict[str, object]:
    """One effect with all spots of a model, which contains the charge of each at the end of the run."""
    first = spots[0]
    return {
        "peak_px": first["peak_px"] / -math.expm1(-run["end_s"] / CHARGING_S),
        "width_px": first["width_px"],
        "brightness_levels": 0.0,
        "charging_s": CHARGING_S,
        "grains_px": [[spot["x_px"] + 0.5 * (run["width_px"] - 1.0), spot["y_px"] + 0.5 * (run["height_px"] - 1.0)] for spot in spots],
        "sizes": [[spot["peak_px"] / first["peak_px"], spot["width_px"] / first["width_px"]] for spot in spots],
    }


def _hum(values: EffectParameters, run: EffectParameters) -> dict[str, object]:
    del run
    wave = {"amplitude_x_px": values["amplitude_x_px"], "amplitude_y_px": values["amplitude_y_px"], "frequency_hz": values["frequency_hz"]}
    return {**wave, "phase_rad": 0.0}


def _charging_jump(values: EffectParameters, run: EffectParameters) -> dict[str, object]:
    """As many jumps as flashes, at random instants; their size is known only if the maps show one of them."""
    flashes = sum(name.endswith("at_s") and name.startswith("flash") for name in values)
    sd_px = math.hypot(values.get("x_px", 0.0), values.get("y_px", 0.0)) / math.sqrt(2.0)
    interval_s = run["end_s"] / max(flashes, 1)
    return {
        "sd_px": sd_px,
        "mean_interval_s": interval_s,
        "flash_levels": values["flash_levels"],
        "flash_s": values["flash_s"],
        "seed": SEED,
    }


def _mean(values: EffectParameters, *names: str) -> float:
    """Mean over both axes, because the simulator's stage has one value."""
    return sum(values[name] for name in names) / len(names)


def _vibration(values: EffectParameters, run: EffectParameters) -> dict[str, object]:
    wave = _hum(values, run)
    del wave["phase_rad"]
    return {**wave, "seed": SEED}


SIMULATED_EFFECTS: dict[str, Callable[[EffectParameters, EffectParameters], dict[str, object]]] = {
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
    "creep_in_hold": _same_names("strain_per_n", "onset_s", poissons_ratio=POISSON),
    "load_step_transient": _same_names("x_px_per_n", "y_px_per_n", "time_constant_s"),
    "stage_step_transient": _same_names("fraction", "time_constant_s"),
    "drift_jump": _same_names("x_px", "y_px", "at_s"),
    "jump_within_pair": lambda values, run: {"x_px": values["x_px"], "y_px": values["y_px"], "first_frame": round(values["first_frame"])},
    "wrong_row_time": _same_names("row_time_error"),
    "frame_integration": lambda values, run: {"scans": round(1.0 / (1.0 + values["row_time_error"]))},
    "interlaced_scan": _same_names(),
    "thermal_oscillation": _swing,
    "charging_frame_ramp": _same_names("x_px", "y_px", "charging_s", "dose_s", brightness_levels=0.0),
    "charging_local_lens": _lens,
    "mains_hum": _hum,
    "vibration": _vibration,
    "stage_backlash": lambda values, run: {"backlash_um": _mean(values, "backlash_x_px", "backlash_y_px") * run["pixel_size_um"]},
    "stage_quadratic": lambda values, run: {
        "quadratic_per_um": _mean(values, "quadratic_x_per_px", "quadratic_y_per_px") / run["pixel_size_um"]
    },
    "contamination": lambda values, run: {"loss_per_s": values["loss_per_s"], "box_width_px": _WIDE_PX, "box_height_px": _WIDE_PX},
    "defocus": _same_names("blur_px_per_s", magnification_per_px=0.0),
    "gamma_change": _same_names("gain", "gamma", "offset_levels", "at_s"),
    "charging_jump": _charging_jump,
    "row_jitter": lambda values, run: {"sd_px": values["sd_x_px"], "seed": SEED},
    "load_cell_zero": _same_names("zero_n"),
    "load_cell_drift": _same_names("rate_n_per_s"),
    "friction_hysteresis": _same_names("friction_n"),
    "out_of_plane_translation": _lift,
    "timestamp_offset": _same_names("offset_s"),
}
