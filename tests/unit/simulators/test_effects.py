"""The library of effects: names, defaults, scenarios, and the readings of the instruments."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from semlive_simulators.effects.composition import EffectSet
from semlive_simulators.effects.library import LIBRARY, as_mapping, build_effects
from semlive_simulators.microscope.render import render_frame
from semlive_simulators.scenario import BadScenario, load_scenario

from .calm_scenario import calm, peak_px

NAMES = [
    "row_jitter",
    "mains_hum",
    "line_sync_hum",
    "vibration",
    "flyback_settling",
    "row_start_settling_in_position",
    "frame_start_settling",
    "frame_start_settling_in_position",
    "scan_nonlinearity",
    "bidirectional_scan",
    "interlaced_scan",
    "irregular_rows",
    "frame_integration",
    "wrong_row_time",
    "wrong_dwell",
    "timestamp_offset",
    "magnification_drift",
    "magnification_frame_instability",
    "refocus_magnification_step",
    "raster_rotation_drift",
    "scan_shear_drift",
    "aspect_drift",
    "distortion_scale_drift",
    "anisotropic_pixel",
    "scan_nonorthogonality",
    "out_of_plane_translation",
    "tilt_with_load",
    "creep_in_hold",
    "load_step_transient",
    "stage_step_transient",
    "stage_backlash",
    "stage_quadratic",
    "stage_yaw",
    "drift_jump",
    "jump_within_pair",
    "bending_misalignment",
    "inplane_misalignment",
    "inhomogeneous_strain",
    "load_cell_zero",
    "load_cell_gain",
    "load_cell_drift",
    "load_frame_compliance",
    "friction_hysteresis",
    "warmup_transient",
    "thermal_oscillation",
    "random_walk_drift",
    "baseline_drift_underresolved",
    "baseline_distortion_underresolved",
    "charging_frame_ramp",
    "charging_local_lens",
    "charging_jump",
    "contamination",
    "defocus",
    "gamma_change",
    "poisson_noise",
    "dic_subpixel_bias",
    "dic_shape_mismatch",
]
PEAKS_PX: dict[str, tuple[tuple[float, float], tuple[float, float]]] = {
    "row_jitter": ((0.03, 0.25), (0.15, 2.5)),  # 3 to 5 standard deviations of 0.01-0.05 and 0.05-0.5
    "mains_hum": ((0.001, 0.03), (0.05, 2.0)),
    "line_sync_hum": ((0.001, 0.03), (0.05, 2.0)),
    "vibration": ((0.005, 0.02), (0.04, 1.0)),
    "flyback_settling": ((0.05, 2.0), (0.5, 10.0)),
    "row_start_settling_in_position": ((0.05, 2.0), (0.5, 10.0)),
    "frame_start_settling": ((0.05, 1.0), (0.1, 5.0)),
    "frame_start_settling_in_position": ((0.05, 1.0), (0.1, 5.0)),
    "scan_nonlinearity": ((0.5, 2.0), (0.5, 3.0)),
    "bidirectional_scan": ((0.1, 5.0), (0.1, 5.0)),
    "magnification_drift": ((0.003, 0.4), (0.003, 0.4)),
    "magnification_frame_instability": ((0.003, 0.1), (0.003, 0.1)),
    "refocus_magnification_step": ((0.05, 1.0), (0.05, 1.0)),
    "raster_rotation_drift": ((0.005, 0.05), (0.005, 0.05)),
    "scan_shear_drift": ((0.003, 0.05), (0.003, 0.05)),
    "aspect_drift": ((0.003, 0.05), (0.003, 0.05)),
    "anisotropic_pixel": ((2.0, 10.0), (2.0, 10.0)),
    "scan_nonorthogonality": ((2.0, 10.0), (2.0, 10.0)),
    "out_of_plane_translation": ((0.02, 0.4), (0.02, 0.4)),
    "tilt_with_load": ((0.01, 0.2), (1e-5, 0.004)),
    "creep_in_hold": ((0.04, 0.4), (0.04, 0.4)),
    "load_step_transient": ((0.1, 8.0), (4.0, 400.0)),
    "stage_step_transient": ((0.05, 1.0), (1.0, 20.0)),
    "stage_backlash": ((0.1, 4.0), (4.0, 200.0)),
    "stage_quadratic": ((0.1, 4.0), (4.0, 200.0)),
    "stage_yaw": ((0.02, 0.5), (0.02, 0.5)),
    "drift_jump": ((0.05, 5.0), (0.5, 100.0)),
    "jump_within_pair": ((0.05, 5.0), (0.5, 100.0)),
    "bending_misalignment": ((0.005, 0.07), (1e-7, 0.005)),  # 0.05 at the edge is 0.07 in the corner
    "inplane_misalignment": ((0.05, 1.0), (0.05, 1.0)),
    "inhomogeneous_strain": ((0.05, 1.0), (0.05, 1.0)),
    "warmup_transient": ((0.1, 5.0), (1.0, 100.0)),
    "thermal_oscillation": ((0.02, 0.5), (0.5, 20.0)),
    "random_walk_drift": ((0.1, 5.0), (3.0, 100.0)),
    "baseline_drift_underresolved": ((0.05, 1.0), (1.0, 10.0)),
    "baseline_distortion_underresolved": ((0.02, 0.1), (0.02, 0.1)),
    "charging_frame_ramp": ((0.05, 5.0), (0.05, 5.0)),
    "charging_local_lens": ((0.1, 10.0), (0.1, 10.0)),
    "charging_jump": ((0.5, 50.0), (0.5, 50.0)),
    "defocus": ((0.01, 0.3), (0.01, 0.3)),
    "dic_shape_mismatch": ((0.05, 1.0), (0.05, 1.0)),
}
"""Largest displacement in the frame at x200 and at x10000 that the literature and experience give."""


def test_names_are_those_of_reports_and_of_their_classes() -> None:
    assert len(NAMES) == 57
    assert set(LIBRARY) == set(NAMES)
    for name, kind in LIBRARY.items():
        assert kind.__name__ == name.title().replace("_", "")


@pytest.mark.parametrize("magnification", ["x200", "x10000"])
@pytest.mark.parametrize("name", NAMES)
def test_there_are_defaults_and_they_survive_yaml(name: str, magnification: str) -> None:
    effects = build_effects({name: magnification})
    (effect,) = effects.members
    assert type(effect).defaults(magnification) == effect  # type: ignore[arg-type]
    assert build_effects(json.loads(json.dumps(as_mapping(effects)))) == effects
    parameters = type(effect).__dataclass_params__  # type: ignore[attr-defined]
    assert parameters.frozen
    assert hasattr(type(effect), "__slots__")
    with pytest.raises(ValueError, match="x200 or x10000"):
        type(effect).defaults("x500")  # type: ignore[arg-type]


@pytest.mark.parametrize("magnification", ["x200", "x10000"])
@pytest.mark.parametrize("name", PEAKS_PX)
def test_defaults_are_as_large_as_in_practice(name: str, magnification: str) -> None:
    low, high = PEAKS_PX[name][magnification == "x10000"]
    assert low <= peak_px(calm(magnification, {name: magnification})) <= high


def test_nothing_is_on_by_default() -> None:
    paper = load_scenario("paper_x200")
    assert paper.effects == EffectSet()
    small = dataclasses.replace(paper, scan=dataclasses.replace(paper.scan, width_px=64, height_px=48))
    assert np.array_equal(render_frame(small, 9.0), render_frame(dataclasses.replace(small, effects=build_effects({})), 9.0))
    nought = {"mains_hum": {"amplitude_x_px": 0, "amplitude_y_px": 0, "frequency_hz": 50, "phase_rad": 0}}
    silent = render_frame(dataclasses.replace(small, effects=build_effects(nought)), 9.0)
    assert np.abs(silent.astype(int) - render_frame(small, 9.0)).max() <= 1  # another order of sums


def scenario_file(folder: Path, text: str) -> str:
    path = folder / "mine.yaml"
    path.write_text("extends: paper_x200\n" + text)
    return str(path)


def test_a_scenario_switches_effects_on(tmp_path: Path) -> None:
    text = """
effects:
  mains_hum: x10000
  frame_integration: {scans: 4}
  magnification_drift: {defaults: x200, change: 7.0e-4}
  drift_jump:
"""
    effects = load_scenario(scenario_file(tmp_path, text)).effects
    assert as_mapping(effects) == {
        "mains_hum": {"amplitude_x_px": 0.5, "amplitude_y_px": 0.25, "frequency_hz": 50.0, "phase_rad": 0.4, "harmonics": []},
        "frame_integration": {"scans": 4},
        "magnification_drift": {"change": 7e-4, "time_constant_s": 3600.0},
    }


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("effects: {gremlins: {}}", "unknown effect gremlins; the known ones are row_jitter, .*magnification_drift"),
        ("effects: {row_jitter: {defaults: x200, sd: 1}}", "row_jitter.sd: Unexpected"),
        ("effects: {row_jitter: {sd_px: much}}", "row_jitter.sd_px: Input should be a valid number"),
        ("effects: {row_jitter: {}}", "row_jitter.sd_px: "),
        ("effects: {row_jitter: x300}", "x200 or x10000, not x300"),
        ("effects: {row_jitter: 3}", "row_jitter: parameters must be a mapping"),
        ("effects: [row_jitter]", "must be a mapping"),
        ("effects: {frame_integration: {scans: 0}}", "at least 1"),
    ],
)
def test_a_wrong_effect_is_refused_with_one_error_line(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(BadScenario, match=says) as caught:
        load_scenario(scenario_file(tmp_path, text + "\n"))
    assert "\n" not in str(caught.value)
