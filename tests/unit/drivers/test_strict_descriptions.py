"""Device descriptions and scenarios are read as strictly as the configuration."""

from __future__ import annotations

from pathlib import Path

import pytest

from semlive.errors import BadConfig
from semlive.service.config.overrides import parse_changes
from semlive_drivers.maps import map_content, map_text
from semlive_drivers.modbus.settings import PartSettings
from semlive_drivers.operator.stage import open_stage
from semlive_drivers.settings import checked
from semlive_simulators.scenario import BadScenario, load_scenario


def test_a_register_map_with_a_key_twice_or_a_doubtful_number_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "own.yaml"
    text = map_text("generic")
    path.write_text(text + "protocol: ascii\n", encoding="utf-8")
    with pytest.raises(BadConfig, match=r"line \d+: protocol: is there already, in line \d+"):
        map_content(str(path))
    path.write_text(text + "extra: 010\n", encoding="utf-8")
    with pytest.raises(BadConfig, match="010 begins with a zero"):
        map_content(str(path))


def test_a_quoted_number_or_truth_value_in_driver_settings_is_refused() -> None:
    assert checked(PartSettings, {"confirmed": True}, "modbus").confirmed
    with pytest.raises(BadConfig, match="modbus: confirmed: 'yes' is no truth value"):
        checked(PartSettings, {"confirmed": "yes"}, "modbus")
    with pytest.raises(BadConfig, match="modbus: watchdog_s: '2' is text, not a number"):
        checked(PartSettings, {"watchdog_s": "2"}, "modbus")


def test_a_scenario_with_a_key_twice_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "own.yaml"
    path.write_text("extends: short\nseed: 1\nseed: 2\n", encoding="utf-8")
    with pytest.raises(BadScenario, match="line 3: seed: is there already, in line 2"):
        load_scenario(str(path))
    with pytest.raises(BadScenario, match="does not exist"):
        load_scenario(str(tmp_path / "none.yaml"))
    folder = tmp_path / "folder.yaml"
    folder.mkdir()
    with pytest.raises(BadScenario, match="it is a folder"):
        load_scenario(str(folder))


def test_changed_settings_are_read_by_the_same_rules() -> None:
    assert parse_changes(["dic.roi_px=20,20,300,200"])[0].value == (20, 20, 300, 200)
    assert parse_changes(["dic.roi_px=[20,20,300,200]"])[0].value == (20, 20, 300, 200)
    assert parse_changes(["dic.tolerance_px=1e-4"])[0].value == 1e-4
    for word in ("dic.subset_px=031", "dic.subset_px='31'", "dic.subset_px=true", "dic.tolerance_px=.inf"):
        with pytest.raises(BadConfig, match="--set dic"):
            parse_changes([word])


def test_a_hand_moved_stage_reads_its_settings_as_strictly() -> None:
    with pytest.raises(BadConfig, match="operator stage: um_per_px: '1' is text, not a number"):
        open_stage({"um_per_px": "1"}, lambda: None)
