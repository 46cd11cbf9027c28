"""Implausible values: plan and doctor ask for confirmation, and run refuses them until the file confirms them."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.testing import CliRunner

from semlive.cli.app import app
from semlive.errors import BadConfig
from semlive.service.config.checks import CONFIRMABLE
from semlive.service.config.configuration import load_config, parse_config
from semlive.service.config.plausibility import questions, refuse_unusual
from semlive.service.config.template import LAB_PRESETS
from semlive_simulators.scenario import load_scenario, names

ROOT = Path(__file__).parents[3]
GIVEN: dict[str, Any] = {
    "sem": {"folder": "export", "pixel_size_um": 1.25, "profile": {"dwell_time_s": 1e-4, "row_time_s": 0.1071}},
    "load_frame": {"driver": "modbus", "settings": {"approach": {"stiffness_n_mm": 20000, "speed_max_mm_s": 0.05}}},
    "stage": {"driver": "operator"},
    "specimen": {"area_mm2": 6.0},
    "protocol": {"calibration_shifts_px": [[0, 0], [8, -4]], "loads_n": [100, 300], "ramp_rate_n_s": 30, "load_tolerance_n": 3},
    "limits": {
        "force_min_n": -50,
        "force_max_n": 400,
        "extension_min_mm": -1,
        "extension_max_mm": 1,
        "force_rate_max_n_s": 5000,
        "force_step_max_n": 500,
        "stage_travel_um": 100,
    },
}


def changed(section: str, **values: object) -> dict[str, Any]:
    return {**GIVEN, section: {**GIVEN[section], **values}}


def stiffness(value: float) -> dict[str, Any]:
    return changed("load_frame", settings={"approach": {"stiffness_n_mm": value, "speed_max_mm_s": 0.05}})


CASES = [
    (changed("specimen", area_mm2=6e-6), "specimen.area_mm2", "is unusual; is it in another unit?"),
    (changed("specimen", area_mm2=0.06), "specimen.area_mm2", "300 N on 0.06 mm^2 are 5e+03 MPa, more than the strength of any metal"),
    (changed("specimen", area_mm2=6e6), "specimen.area_mm2", "is unusual"),
    (changed("specimen", yield_strength_mpa=45), "specimen.yield_strength_mpa", "are 50 MPa, above the yield strength of 45 MPa"),
    (changed("sem", pixel_size_um=1250), "sem.pixel_size_um", "pixels of 1250 um"),
    (changed("sem", pixel_size_um=1.25e-6), "sem.pixel_size_um", "is it in nm or m?"),
    (changed("sem", profile={"pixel_size_m": 1.25e-9}), "sem.pixel_size_um", "one of them has another unit"),
    (changed("sem", profile={"dwell_time_s": 3.2}), "sem.profile", "dwell_time_s of 3.2 s"),
    (changed("sem", scan_profiles=[{"scan_speed": "9", "row_time_s": 107.1}]), "sem.scan_profiles", "row_time_s of 107.1 s"),
    (changed("protocol", ramp_rate_n_s=3000), "protocol.ramp_rate_n_s", "less than 4 readings"),
    (changed("protocol", ramp_rate_n_s=1e-3, motion_timeout_s=1e6), "protocol.ramp_rate_n_s", "takes 55.6 h"),
    (stiffness(20), "load_frame.approach.stiffness_n_mm", "300 N need 15 mm, beyond limits.extension_max_mm"),
    (stiffness(2e7), "load_frame.approach.stiffness_n_mm", "is it in N/m?"),
    (changed("limits", extension_max_mm=1000), "limits.extension_max_mm", "is it in um?"),
    (changed("limits", extension_min_mm=-1e-5, extension_max_mm=1e-5), "limits.extension_max_mm", "is it in m?"),
    (changed("limits", force_max_n=40000), "limits.force_max_n", "40000 N is 133 times the largest load of the plan, 300 N"),
    (changed("limits", force_min_n=-40000), "limits.force_min_n", "-40000 N is 133 times"),
]


@pytest.mark.parametrize(("given", "key", "words"), CASES)
def test_an_implausible_value_is_refused_until_it_is_confirmed(given: dict[str, Any], key: str, words: str) -> None:
    found = {item.key: item for item in questions(parse_config(given, "run.yaml"))}
    assert words in found[key].what
    with pytest.raises(BadConfig, match=r"run\.yaml: .*correct it, or confirm it by confirmed_unusual: \["):
        refuse_unusual(parse_config(given, "run.yaml"), "run.yaml")
    confirmed = parse_config({**given, "confirmed_unusual": list(found)}, "run.yaml")
    assert all(item.confirmed for item in questions(confirmed))
    refuse_unusual(confirmed, "run.yaml")


def test_every_confirmable_key_is_questioned() -> None:
    requests = {item.key for given, _, _ in CASES for item in questions(parse_config(given, "run.yaml"))}
    assert requests | {"limits.extension_min_mm"} == set(CONFIRMABLE)


def test_usual_values_are_not_questioned() -> None:
    assert questions(parse_config(GIVEN, "run.yaml")) == ()
    small = {**changed("protocol", loads_n=[20]), "specimen": {"area_mm2": 0.01}}
    assert questions(parse_config(small, "run.yaml")) == ()


@pytest.mark.checkout
def test_the_examples_and_scenarios_are_usual(tmp_path: Path) -> None:
    paths = [ROOT / "deploy" / "example.yaml", *(ROOT / "deploy" / "examples").glob("*.yaml")]
    assert len(paths) == 1 + len(LAB_PRESETS)
    for path in paths:
        assert questions(load_config(path)) == ()
    for name in names():
        experiment = load_scenario(name).experiment
        given = {**experiment, "sem": {"folder": "x", **experiment["sem"]}, "stage": {"driver": "null"}, "load_frame": {"driver": "null"}}
        assert questions(parse_config(given, name)) == ()


def test_a_confirmation_of_nothing_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.yaml"
    path.write_text(yaml.safe_dump({**GIVEN, "confirmed_unusual": ["specimen.area"]}), encoding="utf-8")
    with pytest.raises(
        BadConfig, match=r"confirmed_unusual\.0: specimen\.area is not a key that can be confirmed; did you mean specimen\.area_mm2\?"
    ):
        load_config(path)


def test_plan_and_doctor_ask_and_run_refuses(tmp_path: Path) -> None:
    (tmp_path / "export").mkdir()
    path = tmp_path / "run.yaml"
    path.write_text(yaml.safe_dump(changed("limits", force_max_n=40000)), encoding="utf-8")
    reported = json.loads(CliRunner().invoke(app, ["plan", str(path), "--json"]).stdout)
    assert [(item["key"], item["confirmed"]) for item in reported["unusual"]] == [("limits.force_max_n", False)]
    page = CliRunner().invoke(app, ["plan", str(path)]).stdout
    assert "? limits.force_max_n: 40000 N is 133 times" in page.replace("\n", " ")
    assert "-50 to 40000 N" in page
    findings = json.loads(CliRunner().invoke(app, ["doctor", str(path), "--json"]).stdout)["findings"]
    assert [item["verdict"] for item in findings if item["what"] == "limits.force_max_n"] == ["bad"]
    done = subprocess.run([sys.executable, "-m", "semlive", "run", str(path)], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "limits.force_max_n: 40000 N is 133 times the largest load of the plan" in done.stderr
    assert not (tmp_path / "runs").exists()
