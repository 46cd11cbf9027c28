"""What a verdict leads to: an experiment that the daemon's configuration can hold, and a scenario that the simulator can play."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from semlive.data.diagnosis.effects import IdentifiedEffect, ModelEffect, Outcome, ParameterEstimate
from semlive.data.diagnosis.verdict import Diagnosis
from semlive.diagnose.baseline.model_effects import effect_class
from semlive.diagnose.experiments.proposals import ExperimentKind, choose_proposal
from semlive.errors import BadConfig
from semlive.model.effects import EFFECT_CLASSES
from semlive.model.effects.intensity import INTENSITY_EFFECTS
from semlive.model.effects.load_cell import CLOCK, LOADS, OUT_OF_PLANE
from semlive.model.effects.rows import ROW_DICTIONARY
from semlive.model.effects.stage import MOVES, non_map_effect
from semlive.service.config.configuration import parse_config
from semlive.service.diagnosis.model_scenario import SIMULATED_EFFECTS, scenario_yaml
from semlive.service.diagnosis.next_config import at_pixel_size, protocol_for
from semlive_simulators.effects.charging import ChargingLocalLens
from semlive_simulators.effects.interfaces import PixelVisits
from semlive_simulators.scenario import load_scenario
from semlive_simulators.specimen.specimen import at_rest

PROTOCOL = {"calibration_shifts_px": [[0.0, 0.0], [20.0, 0.0]], "loads_n": [100.0, 500.0, 900.0], "hold_s": 30.0}
RUN = {
    "sem": {"folder": "export", "pixel_size_um": 1.25},
    "load_frame": {"driver": "modbus"},
    "stage": {"driver": "operator"},
    "limits": {
        "force_min_n": -10,
        "force_max_n": 1000,
        "extension_min_mm": -1,
        "extension_max_mm": 1,
        "force_rate_max_n_s": 50,
        "force_step_max_n": 500,
        "stage_travel_um": 100,
    },
}
NAMED_BY_VALUE = {"frame_integration", "interlaced_scan"}
PARAMETERS = {
    "change": 1e-4, "change_rad": 1e-4, "sd": 1e-4, "sd_rad": 1e-4, "tilt_over_working_distance_per_n": 1e-10, "curvature_per_n": 1e-10,
    "strain_per_n": 1e-8, "onset_s": 10.0, "x_px_per_n": 1e-3, "y_px_per_n": 1e-3, "time_constant_s": 60.0, "fraction": 0.02,
    "x_px": 0.1, "y_px": 0.1, "at_s": 900.0, "row_time_error": -0.75, "amplitude_px": 0.1, "period_s": 300.0, "charging_s": 20.0,
    "dose_s": 1800.0, "peak_px": 0.1, "width_px": 80.0, "first_frame": 5.0,
    "frequency_hz": 50.0, "amplitude_x_px": 0.02, "amplitude_y_px": 0.01, "sd_x_px": 0.03,
    "backlash_x_px": 0.6, "backlash_y_px": 0.6, "quadratic_x_per_px": 1e-4, "quadratic_y_per_px": 1e-4,
    "zero_n": 20.0, "rate_n_per_s": 0.002, "friction_n": 15.0, "offset_s": 20.0,
    "loss_per_s": 2e-5, "blur_px_per_s": 1e-4, "gain": 1.05, "gamma": 0.9, "offset_levels": -8.0,
    "flash_levels": 25.0, "flash_at_s": 900.0, "flash_s": 0.3,
}  # fmt: skip


def verdict(outcome: Outcome, names: tuple[str, ...] = (), ambiguous: tuple[str, ...] = ()) -> Diagnosis:
    effects = tuple(IdentifiedEffect(name, (), 0.1, 20.0, 0.003, False, ModelEffect(name, (), 0.1)) for name in names)
    return Diagnosis(outcome, effects, ambiguous, None, None, None, (), 0.01)


@pytest.mark.parametrize(
    ("found", "kind"),
    [
        (verdict(Outcome.AMBIGUOUS, ("stage_yaw",), ("stage_yaw", "raster_rotation_drift")), ExperimentKind.STATIONARY_SERIES),
        (verdict(Outcome.IDENTIFIED, ("wrong_row_time",)), ExperimentKind.CHANGED_SCAN_TIMES),
        (
            verdict(Outcome.AMBIGUOUS, ("friction_hysteresis",), ("friction_hysteresis", "refocus_magnification_step")),
            ExperimentKind.UNLOAD,
        ),
        (verdict(Outcome.IDENTIFIED, ("load_cell_drift",)), ExperimentKind.STATIONARY_SERIES),
        (verdict(Outcome.IDENTIFIED, ("out_of_plane_translation",)), ExperimentKind.UNLOAD),
        (verdict(Outcome.IDENTIFIED, ("creep_in_hold",)), ExperimentKind.LONGER_HOLD),
        (verdict(Outcome.IDENTIFIED, ("tilt_with_load",)), ExperimentKind.UNLOAD),
        (verdict(Outcome.IDENTIFIED, ("contamination",)), ExperimentKind.REPEAT),
        (verdict(Outcome.UNKNOWN), ExperimentKind.STATIONARY_SERIES),
    ],
)
def test_each_doubt_has_its_experiment(found: Diagnosis, kind: ExperimentKind) -> None:
    proposal = choose_proposal(found)
    assert proposal is not None
    assert proposal.kind is kind
    assert proposal.description


def test_nothing_is_proposed_where_nothing_is_missing() -> None:
    assert choose_proposal(verdict(Outcome.NONE)) is None


@pytest.mark.parametrize("kind", ExperimentKind)
def test_every_experiment_is_a_protocol_that_the_daemon_takes(kind: ExperimentKind) -> None:
    protocol = protocol_for(PROTOCOL, kind)
    checked = parse_config({**RUN, "protocol": protocol}, "next")
    assert checked.protocol.calibration_shifts_px or checked.protocol.loads_n
    assert protocol_for(PROTOCOL, kind) != PROTOCOL or kind in (
        ExperimentKind.REPEAT,
        ExperimentKind.CHANGED_SCAN_TIMES,
        ExperimentKind.CHANGED_PIXEL_SIZE,
        ExperimentKind.ROTATED_SCAN,
    )


def test_another_magnification_is_in_the_configuration_and_a_model_of_this_one_is_not() -> None:
    given = {"sem": {"pixel_size_um": 1.25, "profile": {"pixel_size_m": 1.25e-6, "databar_rows": 4}}, "model": {"effects": []}, "run": {}}
    changed, pixel_um = at_pixel_size(given)
    assert pixel_um == 0.625
    assert changed == {"sem": {"pixel_size_um": 0.625, "profile": {"pixel_size_m": 6.25e-7, "databar_rows": 4}}, "run": {}}
    assert given["sem"]["pixel_size_um"] == 1.25


def model(path: Path, name: str) -> Path:
    if non_map_effect(name) is None:
        family = effect_class("wrong_row_time" if name in NAMED_BY_VALUE else name).name
        values = {theta.name: PARAMETERS.get(theta.name, 0.5) for theta in effect_class(family).nonlinear_parameters}
    else:
        family, values = name, {"frequency_hz": 50.0}
    effect = {
        "name": name,
        "parameters": {key: {"value": value, "sigma": 0.0, "unit": "1"} for key, value in PARAMETERS.items()},
        "law": {"family": family, "values": values, "size_px": 0.1},
    }
    run = {"end_s": 6300.0, "width_px": 1024, "height_px": 884, "pixel_size_um": 1.25}
    path.write_text(json.dumps({"version": 1, "effects": [effect], "run": run}))
    return path


@pytest.mark.parametrize("name", sorted(SIMULATED_EFFECTS))
def test_a_found_effect_is_played_by_the_simulators_own(name: str, tmp_path: Path) -> None:
    scenario = tmp_path / "found.yaml"
    scenario.write_text(scenario_yaml(model(tmp_path / "model.json", name), "paper_x200"))
    (effect,) = [item for item in load_scenario(str(scenario)).effects.members if item.name == name]
    assert effect.name in yaml.safe_load(scenario.read_text())["effects"]


def test_a_charged_spot_is_played_as_large_as_it_was_at_the_end_of_the_run(tmp_path: Path) -> None:
    scenario = tmp_path / "found.yaml"
    scenario.write_text(scenario_yaml(model(tmp_path / "model.json", "charging_local_lens"), "paper_x200"))
    (effect,) = load_scenario(str(scenario)).effects.members
    assert isinstance(effect, ChargingLocalLens)
    assert effect.peak_px * -math.expm1(-6300.0 / effect.charging_s) == pytest.approx(PARAMETERS["peak_px"])


def test_several_charged_spots_are_one_effect_of_the_simulator(tmp_path: Path) -> None:
    path = model(tmp_path / "model.json", "charging_local_lens")
    content = json.loads(path.read_text())
    second = json.loads(path.read_text())["effects"][0]
    for name, value in (("x_px", 200.0), ("y_px", -100.0), ("width_px", 160.0), ("peak_px", -0.05)):
        second["parameters"][name]["value"] = value
        second["law"]["values"] = {key: second["parameters"][key]["value"] for key in second["law"]["values"]}
    path.write_text(json.dumps({**content, "effects": [*content["effects"], second]}))
    scenario = tmp_path / "found.yaml"
    scenario.write_text(scenario_yaml(path, "paper_x200"))
    (effect,) = load_scenario(str(scenario)).effects.members
    assert isinstance(effect, ChargingLocalLens)
    point = np.array([[700.0]]), np.array([[300.0]])
    visits = PixelVisits(
        *point, np.full((1, 1), 6300.0), 0.0, 0, 0, np.zeros((1, 1), dtype=bool), load_scenario(str(scenario)).scan, at_rest(), point
    )
    expected = 0.0
    for spot in (content["effects"][0], second):
        value = {key: item["value"] for key, item in spot["parameters"].items()} | spot["law"]["values"]
        arm = np.array([700.0 - 511.5 - value["x_px"], 300.0 - 441.5 - value["y_px"]])
        expected += 2.0 * value["peak_px"] * value["width_px"] * arm / (arm @ arm + value["width_px"] ** 2)
    assert np.ravel(effect.material_px(*point, visits)) == pytest.approx(expected)


def test_what_cannot_be_played_is_reported(tmp_path: Path) -> None:
    registered = {item.name for item in (*EFFECT_CLASSES, *ROW_DICTIONARY, *MOVES, *LOADS, CLOCK, OUT_OF_PLANE, *INTENSITY_EFFECTS)}
    assert set(SIMULATED_EFFECTS) - NAMED_BY_VALUE == registered - {"inhomogeneous_strain", "dic_subpixel_bias"}
    with pytest.raises(BadConfig, match="no counterpart"):
        scenario_yaml(model(tmp_path / "model.json", "inhomogeneous_strain"), "paper_x200")


@pytest.mark.parametrize(
    ("value", "sigma", "names"),
    [
        (0.044, 0.004, ()),
        (-0.9375, 0.001, ("frame_integration",)),
        (-0.5, 0.002, ("frame_integration", "interlaced_scan")),
        (-0.75, 0.05, ("frame_integration", "wrong_row_time")),
        (-0.6, 0.02, ()),
    ],
)
def test_a_row_time_that_is_an_integer_fraction_is_integration(value: float, sigma: float, names: tuple[str, ...]) -> None:
    assert effect_class("wrong_row_time").alias_rule([ParameterEstimate("row_time_error", value, sigma, "1")]) == names
