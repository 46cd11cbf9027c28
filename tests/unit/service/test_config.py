"""The configuration file: its content, and what it refuses."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
import yaml

from semlive.data.experiment import Phase
from semlive.errors import BadConfig
from semlive.service.config.configuration import load_config, parse_config


def given(**more: Any) -> dict[str, Any]:
    base: dict[str, Any] = {
        "sem": {"folder": "export", "pixel_size_um": 1.25},
        "load_frame": {"driver": "modbus"},
        "stage": {"driver": "operator"},
        "protocol": {"calibration_shifts_px": [[0, 0], [8, -4]], "translation_shifts_px": [[3, 0]], "loads_n": [100, 500]},
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
    return {**base, **more}


def refusal(message: object) -> str:
    with pytest.raises(BadConfig) as error:
        parse_config(message, "run.yaml")
    return str(error.value)


def test_a_plan_calibrates_then_translates_then_pulls_at_shift_zero() -> None:
    steps = parse_config(given(), "run.yaml").plan().steps
    assert [step.step for step in steps] == [0, 1, 2, 3, 4]
    assert [step.phase for step in steps] == [Phase.CALIBRATION] * 2 + [Phase.TRANSLATION] + [Phase.TENSION] * 2
    assert steps[1].shift_px == (8, -4)
    assert steps[1].shift_um == (10.0, -5.0)
    assert [step.load_n for step in steps] == [None, None, None, 100, 500]
    assert steps[4].shift_um == (0.0, 0.0)


def test_a_configuration_comes_back_from_its_own_dump() -> None:
    config = parse_config(given(dic={"subset_px": 31, "roi_px": [20, 20, 300, 200]}, estimate={"window_points": 7}), "run.yaml")
    assert parse_config(config.model_dump(mode="json"), "log") == config
    assert config.analysis_settings().dic.roi_px == (20, 20, 300, 200)


def test_scan_profiles_reach_the_analysis_and_come_back_from_the_dump() -> None:
    rows = [{"instrument": "JSM", "scan_speed": "9", "dwell_time_s": 1e-6, "row_time_s": 2e-3}]
    sem = {"folder": "export", "pixel_size_um": 1.25, "profile": {"databar_rows": 64}, "scan_profiles": rows}
    config = parse_config(given(sem=sem), "run.yaml")
    scan = config.analysis_settings().scan
    assert scan.databar_rows == 64
    assert [(item.scan_speed, item.row_time_s, item.width_px) for item in scan.speeds] == [("9", 2e-3, None)]
    assert parse_config(config.model_dump(mode="json"), "log") == config
    assert "did you mean row_time_s?" in refusal(given(sem={**sem, "scan_profiles": [{"scan_speed": "9", "row_time": 1.0}]}))
    assert "start_anchor must be start, end or save" in refusal(given(sem={**sem, "profile": {"start_anchor": "middle"}}))


def test_folders_are_relative_to_the_file(tmp_path: Path) -> None:
    path = tmp_path / "run.yaml"
    path.write_text(yaml.safe_dump(given()))
    config = load_config(path)
    assert config.sem.folder == tmp_path / "export"
    assert config.run.folder == tmp_path / "runs"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"semm": {}}, "unknown key semm; did you mean sem?"),
        ({"dic": {"subset": 43}}, "unknown key dic.subset; did you mean subset_px?"),
        ({"dic": {"subset_px": 42}}, "subset_px must be odd"),
        ({"limits": None}, "a load_frame needs a limits section"),
        ({"load_frame": None}, "protocol.loads_n needs a load_frame section"),
        ({"stage": None}, "shifts need a stage section"),
        ({"protocol": {}}, "the run has nothing to do"),
        ({"run": {"name": "../elsewhere"}}, "run.name"),
        ({"sem": {"folder": "x", "pixel_size_um": -1}}, "sem.pixel_size_um"),
        ({"specimen": {"loading_axis": "z"}}, "loading_axis must be x or y"),
    ],
)
def test_what_is_wrong_is_named(change: dict[str, Any], words: str) -> None:
    message = refusal(given(**change))
    assert message.startswith("run.yaml: ")
    assert words in message
    assert "\n" not in message


@pytest.mark.parametrize("device", ["load_frame", "stage"])
def test_a_device_with_a_long_polling_period_is_refused_for_a_run_and_not_in_an_old_log(tmp_path: Path, device: str) -> None:
    slow_polling = given(**{device: {**given()[device], "poll_s": 0.5}})
    path = tmp_path / "run.yaml"
    path.write_text(yaml.safe_dump(slow_polling))
    with pytest.raises(BadConfig, match=rf"{device}\.poll_s: 0\.5 s between readings, which are stale after limits\.stale_after_s, 0\.5 s"):
        load_config(path)
    assert parse_config(slow_polling, "log").plan()


def test_what_is_no_yaml_is_named_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "run.yaml"
    path.write_text("sem:\n  folder: [a\nprotocol: }\n")
    with pytest.raises(BadConfig, match="line 3 is not YAML"):
        load_config(path)
    assert "there are no sections" in refusal("only text")


@pytest.mark.checkout
def test_the_example_is_a_configuration() -> None:
    config = load_config(Path(__file__).parents[3] / "deploy" / "example.yaml")
    assert len(config.plan().steps) == 19
    assert config.plan().hold.hold_s == 30.0


def refused_file(tmp_path: Path, text: str) -> str:
    path = tmp_path / "run.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(BadConfig) as error:
        load_config(path)
    message = str(error.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    return message


def test_the_line_of_what_is_wrong_is_named(tmp_path: Path) -> None:
    text = yaml.safe_dump(given(), sort_keys=False)
    lines = text.splitlines()
    line = next(n for n, row in enumerate(lines, 1) if row.startswith("  force_max_n:"))
    assert f"line {line}: limits.force_max_n: '1000' is text, not a number" in refused_file(tmp_path, text.replace("n: 1000", "n: '1000'"))
    assert f"line {line}: unknown key limits.force_most_n" in refused_file(tmp_path, text.replace("force_max_n", "force_most_n"))
    assert f"line {line}: limits.force_max_n: Input should be a valid number" in refused_file(
        tmp_path, text.replace("n: 1000", "n: [1000]")
    )
    assert f"line {line + 1}: limits.force_max_n: is there already" in refused_file(
        tmp_path, text.replace("force_max_n: 1000", "force_max_n: 1000\n  force_max_n: 40000")
    )
    # What an earlier run's log holds stays readable.
    parse_config({**given(), "protocol": {**given()["protocol"], "hold_s": "30"}}, "log")


@pytest.mark.timeout(20)
def test_only_a_regular_file_is_a_configuration(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo.yaml")
    for path in (tmp_path / "fifo.yaml", Path("/dev/zero"), tmp_path):
        with pytest.raises(BadConfig, match="cannot be read"):
            load_config(path)
