"""The configuration of a scenario's run: the keys that `semlive init` writes, with short times."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import cast

import yaml

from .scenario import FORCE_MAX_N, TOLERANCE_N, Scenario

MAPS = Path(__file__).with_name("maps")
_APPROACH = {"stiffness_n_mm": 20000, "speed_max_mm_s": 0.05}


def map_path(scenario: Scenario, peers: Path) -> Path:
    """The description of the device: one of this package, or one of the independent frame's folder."""
    own = MAPS / scenario.map
    return own if own.is_file() else peers / scenario.map


def _filled(value: object, port: int, folder: Path) -> object:
    """A setting with its places filled in."""
    if isinstance(value, Mapping):
        return {key: _filled(inner, port, folder) for key, inner in cast(Mapping[str, object], value).items()}
    if value == "{port}":
        return port
    return value.replace("{folder}", str(folder)) if isinstance(value, str) else value


def _modbus(scenario: Scenario, peers: Path, port: int) -> dict[str, object]:
    """Settings of a frame behind Modbus TCP."""
    settings: dict[str, object] = {"map": str(map_path(scenario, peers)), "host": "127.0.0.1", "port": port, "confirmed": True}
    if scenario.map.startswith("map_disp"):
        settings["approach"] = dict(_APPROACH)
    return settings | dict(scenario.settings)


def configuration(scenario: Scenario, peers: Path, port: int, folder: Path, name: str = "run", loads_n: list[float] | None = None) -> str:
    """The text of a configuration file.

    Args:
        scenario: whose settings it has.
        peers: folder of the independent frame's maps.
        port: of the device.
        folder: of the trial, where serial lines and a load file of the device are.
        name: of the run.
        loads_n: in place of the scenario's loads, N.
    """
    settings = _filled(scenario.frame, port, folder) if scenario.frame else _modbus(scenario, peers, port)
    config: dict[str, object] = {
        "run": {"name": name, "folder": "log"},
        "sem": {
            "folder": "export",
            "vendor": "fei",
            "pixel_size_um": 1.0,
            "poll_s": 0.05,
            "stable_for_s": 0.15,
            "profile": {"start_anchor": "end", "start_sigma_s": 0.01, "clock_offset_s": 0},
        },
        "load_frame": {"driver": scenario.driver, "poll_s": 0.05, "settings": settings},
        "specimen": {"name": "sheet", "area_mm2": 10, "loading_axis": "y"},
        "protocol": {
            "calibration_shifts_px": [[0, 0]] * scenario.unloaded,
            "loads_n": [300],
            "ramp_rate_n_s": 30,
            "load_tolerance_n": TOLERANCE_N,
            "hold_s": 1.0,
            "settle_s": 0.5,
            "frame_timeout_s": 60,
            **scenario.protocol,
        },
        "limits": {
            "force_min_n": -50,
            "force_max_n": FORCE_MAX_N,
            "extension_min_mm": -0.5,
            "extension_max_mm": 2.0,
            "force_rate_max_n_s": 200,
            "force_step_max_n": 400,
            "stage_travel_um": 200,
            **scenario.limits,
        },
        "dic": {"subset_px": 31, "step_px": 8, "roi_px": None},
        "estimate": {"window_points": 9, "accept_poor_calibration": True},
    }
    if loads_n is not None:
        config["protocol"] = {**_section(config, "protocol"), "loads_n": loads_n, "calibration_shifts_px": []}
    text = yaml.safe_dump(config, sort_keys=False)
    for old, new in scenario.text:
        if old not in text:
            raise ValueError(f"{scenario.name}: the configuration holds no {old!r}; correct the scenario's replacement")
        text = text.replace(old, new, 1)
    return text


def _section(config: dict[str, object], name: str) -> dict[str, object]:
    section = config[name]
    assert isinstance(section, dict)
    return section
