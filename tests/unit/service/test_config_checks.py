"""Numbers of a configuration that cannot belong together are refused with line and key, in files only."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from semlive.errors import BadConfig
from semlive.service.config.configuration import load_config, parse_config

GIVEN: dict[str, Any] = {
    "sem": {"folder": "export", "pixel_size_um": 1.25},
    "load_frame": {"driver": "modbus"},
    "stage": {"driver": "operator"},
    "protocol": {"calibration_shifts_px": [[0, 0], [8, -4]], "loads_n": [100, 300], "ramp_rate_n_s": 20, "load_tolerance_n": 3},
    "limits": {
        "force_min_n": -50,
        "force_max_n": 400,
        "extension_min_mm": -1,
        "extension_max_mm": 1,
        "force_rate_max_n_s": 50,
        "force_step_max_n": 500,
        "stage_travel_um": 100,
    },
}


def changed(section: str, **values: object) -> dict[str, Any]:
    return {**GIVEN, section: {**GIVEN[section], **values}}


def load(tmp_path: Path, given: dict[str, Any]) -> None:
    path = tmp_path / "run.yaml"
    path.write_text(yaml.safe_dump(given, sort_keys=False), encoding="utf-8")
    load_config(path)


def test_a_sensible_configuration_is_taken(tmp_path: Path) -> None:
    load(tmp_path, GIVEN)
    load(tmp_path, changed("limits", force_drop_max_n=50, force_slope_max_n_s=100, slack_max_mm=0.01))
    load(tmp_path, changed("limits", force_drop_max_n=None))
    load(tmp_path, changed("protocol", loads_n=[]))
    load(tmp_path, changed("limits", unloaded_max_n=0))


def test_limits_without_a_load_frame_are_those_of_the_stage(tmp_path: Path) -> None:
    unloaded = {**changed("protocol", loads_n=[]), "load_frame": None, "limits": {"stage_travel_um": 50, "stale_after_s": 1}}
    load(tmp_path, unloaded)
    plan = load_config(tmp_path / "run.yaml").plan()
    assert (plan.limits.force_max_n, plan.limits.stage_travel_um, plan.limits.stale_after_s) == (0.0, 50, 1)
    load(tmp_path, {**unloaded, "limits": {"stale_after_s": 1}})
    with pytest.raises(BadConfig, match=r"limits\.force_min_n is missing"):
        load(tmp_path, {**GIVEN, "limits": {"stage_travel_um": 50}})
    with pytest.raises(BadConfig, match=r"400 N is not below force_max_n, 300 N"):
        load(tmp_path, {**unloaded, "limits": {"force_min_n": 400, "force_max_n": 300}})


@pytest.mark.parametrize(
    ("section", "values", "words"),
    [
        ("limits", {"extension_min_mm": 1, "extension_max_mm": -1}, "limits.extension_min_mm: 1 mm is not below extension_max_mm, -1 mm"),
        ("limits", {"force_min_n": 400}, "limits.force_min_n: 400 N is not below force_max_n, 400 N"),
        ("limits", {"force_drop_max_n": 0}, "limits.force_drop_max_n: 0 is not more than 0"),
        ("limits", {"force_drop_max_n": -20}, "limits.force_drop_max_n: -20 is not more than 0"),
        ("limits", {"force_slope_max_n_s": 0}, "limits.force_slope_max_n_s: 0 is not more than 0"),
        ("limits", {"slack_max_mm": -0.1}, "limits.slack_max_mm: -0.1 is not more than 0"),
        ("limits", {"slack_force_n": 0}, "limits.slack_force_n: 0 is not more than 0"),
        ("limits", {"stiffness_min_n_mm": 0}, "limits.stiffness_min_n_mm: 0 is not more than 0"),
        ("limits", {"unloaded_max_n": -1}, "limits.unloaded_max_n: -1 is not more than 0"),
        ("limits", {"stop_timeout_s": 0}, "limits.stop_timeout_s: 0 is not more than 0"),
        ("limits", {"stop_timeout_s": 1e9}, "limits.stop_timeout_s: 1e+09 s is more than 3600 s"),
        ("limits", {"stale_after_s": 3}, "limits.lost_after_s: 2 s is less than stale_after_s, 3 s"),
        ("limits", {"force_rate_max_n_s": -1}, "limits.force_rate_max_n_s: -1 is not more than 0"),
        ("limits", {"force_rate_max_n_s": 10}, "protocol.ramp_rate_n_s: 20 N/s is more than limits.force_rate_max_n_s, 10 N/s"),
        ("limits", {"force_step_max_n": 150}, "protocol.loads_n.1: a change of load from 100 to 300 N"),
        ("protocol", {"loads_n": [100, 450]}, "protocol.loads_n.1: a load of 450 N is outside"),
        ("protocol", {"load_tolerance_n": 1e6}, "protocol.load_tolerance_n: 1e+06 N is as large as the largest step"),
        ("protocol", {"load_tolerance_n": 200}, "protocol.load_tolerance_n: 200 N is as large as the largest step of load, 200 N"),
        ("protocol", {"load_tolerance_fraction": 0.9}, "protocol.load_tolerance_fraction: 0.9 of 300 N"),
        ("protocol", {"ramp_rate_n_s": 1e-12}, "protocol.ramp_rate_n_s: at 1e-12 N/s the step of 200 N takes 2e+14 s"),
        ("protocol", {"motion_timeout_s": 1e300}, "protocol.motion_timeout_s: 1e+300 s is more than 1e+07 s"),
        ("protocol", {"warm_up": {"max_rate_px_s": 1, "max_wait_s": 1e9}}, "protocol.warm_up.max_wait_s: 1e+09 s is more than"),
        ("sem", {"poll_s": 1e12}, "sem.poll_s: 1e+12 s is more than"),
        ("sem", {"profile": {"dwell_time_s": -1e-6}}, "sem.profile.dwell_time_s: -1e-06 is not more than 0"),
        ("sem", {"scan_profiles": [{"scan_speed": "9", "row_time_s": 0}]}, "sem.scan_profiles.0.row_time_s: 0 is not more than 0"),
    ],
)
def test_a_contradiction_is_refused_with_its_key_and_line(tmp_path: Path, section: str, values: dict[str, Any], words: str) -> None:
    given = changed(section, **values)
    with pytest.raises(BadConfig) as error:
        load(tmp_path, given)
    printed = str(error.value)
    assert words in printed
    assert "run.yaml: line " in printed
    assert "\n" not in printed
    # An earlier run's log with these values stays readable.
    assert parse_config(given, "log").plan()


def test_the_contradiction_of_a_default_names_the_section(tmp_path: Path) -> None:
    with pytest.raises(BadConfig, match=r"line \d+: protocol\.load_tolerance_n: 10 N is as large as the largest step of load, 4 N"):
        load(tmp_path, {**GIVEN, "protocol": {"loads_n": [4, 8]}})
