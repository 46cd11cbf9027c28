"""What is hidden: the simulators' effects by name, as large as asked for in px, and the sizes that can be detected."""

from __future__ import annotations

import json
import math
from dataclasses import fields
from pathlib import Path
from typing import Any

from blind.experiment import AREA_MM2, TOP_STRAIN, YOUNGS_GPA

from semlive_simulators.effects.interfaces import Effect
from semlive_simulators.effects.library import LIBRARY

HALF_WIDTH_PX, HALF_HEIGHT_PX, PIXEL_MM = 512.0, 442.0, 1.25e-3
TOP_N = TOP_STRAIN * YOUNGS_GPA * 1e3 * AREA_MM2
STEP_N = TOP_N / 6.0
WORKING_DISTANCE_MM = 14.1
WORKING_DISTANCE_PX = WORKING_DISTANCE_MM / PIXEL_MM
END_S = 29 * (94.6764 + 120.0) + 94.6764  # of 15 pairs

_FROZEN = json.loads((Path(__file__).parent / "detectable.json").read_text(encoding="utf-8"))
DETECTABLE_PX: dict[str, float] = {name: one["detectable_px"] for name, one in _FROZEN.items()}
"""Peak px that 15 pairs with 0.02 px of noise shared over 43 px subsets show at 90 % power and 1 % false alarms: as `bench_detectable.py`
measured them, frozen."""
PROTOTYPE_PX: dict[str, float] = {name: one["prototype_px"] for name, one in _FROZEN.items()}
"""What they were taken to be before, from another experiment; tests hide effects of so many px."""
PHYSICAL_PX: dict[str, tuple[float, float]] = {name: tuple(one["physical_px"]) for name, one in _FROZEN.items()}
"""The least and the largest peak that is met at x200."""


def hidden_effect(name: str, peak_px: float, seed: int) -> tuple[Effect, ...]:
    """An effect of the library whose displacement is about so large at its largest; the seed moves what has a place or an instant."""
    kind, x, y = LIBRARY[name], 0.6 * peak_px, 0.8 * peak_px
    share, jump = _share(seed), jump_frame(seed)
    built: dict[str, tuple[float | tuple[tuple[float, float], ...], ...]] = {
        "magnification_drift": (peak_px / HALF_WIDTH_PX, 3600.0),
        "raster_rotation_drift": (peak_px / HALF_WIDTH_PX, 3600.0),
        "aspect_drift": (peak_px / HALF_WIDTH_PX, 3600.0),
        "scan_shear_drift": (peak_px / HALF_HEIGHT_PX, 3600.0),
        "distortion_scale_drift": (peak_px, 3600.0),
        "magnification_frame_instability": (peak_px / HALF_WIDTH_PX, seed),
        "refocus_magnification_step": (peak_px / HALF_WIDTH_PX, seed),
        "stage_yaw": (peak_px / HALF_WIDTH_PX, seed),
        "tilt_with_load": (peak_px / TOP_N / (HALF_WIDTH_PX * HALF_HEIGHT_PX) * WORKING_DISTANCE_PX, WORKING_DISTANCE_MM),
        "bending_misalignment": (peak_px / TOP_N / (HALF_WIDTH_PX * HALF_HEIGHT_PX) / PIXEL_MM, 0.33),
        "creep_in_hold": (peak_px / HALF_WIDTH_PX / TOP_N / 3.0, 10.0, 0.33),
        "load_step_transient": (x / STEP_N, y / STEP_N, 60.0),
        "stage_step_transient": (peak_px / 30.0, 60.0),
        "drift_jump": (x, y, 214.7 * jump[0] + 94.7 * jump[1]),
        "jump_within_pair": (x, y, 5 + 2 * int(8 * share)),
        "wrong_row_time": (peak_px / 0.4,),
        "thermal_oscillation": (x, y, 150.0 + 250.0 * share, 6.0 * share),
        "charging_frame_ramp": (x, y, 0.0, 20.0, 1800.0),
        "charging_local_lens": (peak_px, 80.0, 0.0, 900.0, ((250.0 + 500.0 * share, 200.0 + 400.0 * ((7 * share) % 1.0)),)),
    }
    return (kind(*built[name]),)


def _share(seed: int) -> float:
    return (seed * 0.6180339887) % 1.0


def jump_frame(seed: int) -> tuple[int, float]:
    """Frame during which a jump occurs, and the fraction of its scan, in rows that have points."""
    return 3 + int(20 * _share(seed)), 0.2 + 0.5 * _share(seed)


def hidden_values(name: str, effect: Any) -> dict[str, float]:
    """Report of an error-free diagnosis on a hidden effect, by the names that it uses; changes are those of the complete run."""
    reported_text = {one.name: getattr(effect, one.name) for one in fields(effect)}
    if "change" in reported_text and name != "distortion_scale_drift":
        grown = -math.expm1(-END_S / reported_text["time_constant_s"])
        return {"change_rad" if name == "raster_rotation_drift" else "change": reported_text["change"] * grown}
    if name in _REPORTED:
        return {reported: float(reported_text[own]) for reported, own in _REPORTED[name].items()}
    return {}


def hidden_constants(name: str, effect: Any) -> dict[str, float]:
    """The time constants, instants and widths of a hidden effect, by the names that a diagnosis uses."""
    return {constant: float(getattr(effect, constant)) for constant in _CONSTANTS.get(name, ())}


_CONSTANTS = {
    "creep_in_hold": ("onset_s",),
    "load_step_transient": ("time_constant_s",),
    "stage_step_transient": ("time_constant_s",),
    "drift_jump": ("at_s",),
    "charging_frame_ramp": ("charging_s", "dose_s"),
    "charging_local_lens": ("width_px",),
}
_REPORTED = {
    "creep_in_hold": {"strain_per_n": "strain_per_n"},
    "load_step_transient": {"x_px_per_n": "x_px_per_n", "y_px_per_n": "y_px_per_n"},
    "stage_step_transient": {"fraction": "fraction"},
    "drift_jump": {"x_px": "x_px", "y_px": "y_px"},
    "jump_within_pair": {"x_px": "x_px", "y_px": "y_px"},
    "wrong_row_time": {"row_time_error": "row_time_error"},
    "thermal_oscillation": {"period_s": "period_s"},
    "charging_frame_ramp": {"x_px": "x_px", "y_px": "y_px"},
}
