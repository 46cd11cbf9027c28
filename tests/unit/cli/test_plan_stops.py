"""`semlive plan` and `semlive doctor` show how far the load can go before each stop, and warn where that is beyond the limit."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.testing import CliRunner

from semlive.cli.app import app
from semlive.data.faults import FaultCode
from semlive.service.config.configuration import parse_config
from semlive.service.config.template import LAB_PRESETS, configuration_text
from semlive.service.planning.stop_distances import StopPlan, stop_advice, stop_plan

MODBUS, SERIAL, OPERATOR = (
    yaml.safe_load(configuration_text(LAB_PRESETS[name])) for name in ("modbus-fei", "serial-zeiss", "operator-deben")
)


def given(base: dict[str, Any] = MODBUS, **sections: dict[str, Any]) -> dict[str, Any]:
    whole = {**base, "sem": {"folder": "export", "pixel_size_um": 1.25, "profile": {"frame_time_s": 94.67}}}
    return whole | {name: {**whole[name], **changes} for name, changes in sections.items()}


def stops_of(base: dict[str, Any] = MODBUS, **sections: dict[str, Any]) -> StopPlan:
    found = stop_plan(parse_config(given(base, **sections), "here"))
    assert found is not None
    return found


def run(command: str, folder: Path, what: dict[str, Any], *arguments: str) -> str:
    path = folder / "run.yaml"
    path.write_text(yaml.safe_dump(what), encoding="utf-8")
    return CliRunner().invoke(app, [command, str(path), *arguments], env={"COLUMNS": "220"}).stdout


HASTY = {"protocol": {"ramp_rate_n_s": 400.0}, "limits": {"force_rate_max_n_s": 400.0}, "load_frame": {"poll_s": 0.4}}


def test_the_table_shows_every_fault_and_the_json_reports_the_same(tmp_path: Path) -> None:
    reported = json.loads(run("plan", tmp_path, given(), "--json"))["stop_distances"]
    assert (reported["start_n"], reported["target_n"], reported["ramp_rate_n_s"], reported["force_limit_n"]) == (1640, 2000, 20, 2200)
    assert not any(row["exceeds_limit"] for row in reported["rows"])
    page = " ".join(run("plan", tmp_path, given()).split())
    for row in reported["rows"]:
        assert row["code"] in page
        assert row["worst_n"] is None or f"{row['worst_n']:.0f} N" in page
    assert "not bounded" in page
    assert "press the emergency stop" in page


def test_noise_of_the_cell_lets_the_load_go_farther(tmp_path: Path) -> None:
    silent, noisy = (
        json.loads(run("plan", tmp_path, given(), "--json", *more))["stop_distances"] for more in ((), ("--force-noise-n", "5"))
    )
    assert noisy["noticeable_n"] == pytest.approx(50.0)
    first = {row["code"]: row["worst_n"] for row in silent["rows"]}
    assert all(row["worst_n"] is None or row["worst_n"] >= first[row["code"]] - 1e-9 for row in noisy["rows"])
    assert max(row["worst_n"] or 0 for row in noisy["rows"]) > max(row["worst_n"] or 0 for row in silent["rows"])


def test_a_load_far_beyond_its_limit_is_warned_of(tmp_path: Path) -> None:
    reported = json.loads(run("plan", tmp_path, given(**HASTY), "--json"))
    far = [row for row in reported["stop_distances"]["rows"] if row["exceeds_limit"]]
    assert far
    (warning,) = [item for item in reported["advice"] if "beyond the force limit" in item]
    assert f"{max(row['worst_n'] for row in far):.0f} N" in warning
    for key in ("protocol.ramp_rate_n_s", "load_frame.poll_s", "limits.force_max_n", "--force-resolution-n"):
        assert key in warning
    findings = json.loads(run("doctor", tmp_path, given(**HASTY), "--json"))["findings"]
    (stops,) = [item for item in findings if item["what"] == "stops"]
    assert stops["verdict"] == "open"
    assert stops["advice"] == warning


def test_doctor_names_the_worst_case(tmp_path: Path) -> None:
    stated = given(limits={"stiffness_min_n_mm": 5000.0})
    (stops,) = [item for item in json.loads(run("doctor", tmp_path, stated, "--json"))["findings"] if item["what"] == "stops"]
    assert stops["verdict"] == "good"
    worst = stops_of(limits={"stiffness_min_n_mm": 5000.0}).worst
    assert worst is not None
    assert f"{worst.worst_n:.0f} N" in stops["said"]
    assert "2200 N" in stops["said"]


def test_plan_and_doctor_show_that_a_cell_that_reads_too_little_is_not_bounded_and_what_to_state(tmp_path: Path) -> None:
    (advice,) = json.loads(run("plan", tmp_path, given(), "--json"))["advice"][:1]
    (stops,) = [item for item in json.loads(run("doctor", tmp_path, given(), "--json"))["findings"] if item["what"] == "stops"]
    assert (stops["verdict"], stops["advice"]) == ("open", advice)
    for words in ("reads only a part of the load", "does not bound", "limits.stiffness_min_n_mm", "extension_max_mm"):
        assert words in advice
    stated = json.loads(run("plan", tmp_path, given(limits={"stiffness_min_n_mm": 5000.0}), "--json"))
    assert not any("limits.stiffness_min_n_mm" in item for item in stated["advice"])


def test_nothing_is_shown_where_semlive_moves_nothing(tmp_path: Path) -> None:
    for what in (given(OPERATOR), given(protocol={"loads_n": []})):
        assert stop_plan(parse_config(what, "here")) is None
        assert json.loads(run("plan", tmp_path, what, "--json"))["stop_distances"] is None
    assert list(stop_advice(None)) == []


def test_what_the_configuration_reports_of_device_and_link_is_used() -> None:
    modbus, serial = stops_of().case, stops_of(SERIAL).case
    assert (modbus.control.value, modbus.answer_s, modbus.watchdog_s, modbus.stiffness_n_mm) == ("load", 0.3, 2.0, None)
    assert (serial.control.value, serial.answer_s, serial.watchdog_s, serial.stiffness_n_mm) == ("displacement", 0.6, None, 150.0)
    parts = {"cell": {"host": "a", "timeout_s": 0.7}, "drive": {"host": "b", "watchdog_s": 3.0}, "approach": {"ahead_s": 1.5}}
    whole = stops_of(load_frame={"driver": "assembled", "settings": parts})
    assert (whole.case.answer_s, whole.case.watchdog_s, whole.case.ahead_s) == (0.7, 3.0, 1.5)
    assert [row.code for row in whole.open] == [FaultCode.LIMIT, FaultCode.TRAVEL_WITHOUT_LOAD]
    assert "state the stiffness" in "\n".join(stop_advice(whole))


def test_the_ramp_is_the_one_to_the_largest_load() -> None:
    down = stops_of(protocol={"loads_n": [-20, -40, -40]}, limits={"force_min_n": -50}).case
    assert (down.start_n, down.target_n, down.limit_n) == (-20, -40, -50)
    up_and_down = stops_of(protocol={"loads_n": [300, 600, 100]}).case
    assert (up_and_down.start_n, up_and_down.target_n) == (300, 600)
