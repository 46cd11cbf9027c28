"""The run that qualifies a microscope: pairs in place while it warms up, then a cross of shifts, without a load frame."""

from __future__ import annotations

from pathlib import Path

import yaml

from semlive.inputs.files import read_regular
from semlive.inputs.yaml_text import MOST_BYTES, read_yaml
from semlive.qualify.drift import MIN_PAIRS_DECAY
from semlive.qualify.protocol import STEPS
from semlive.service.config.configuration import Config, load_config, parse_config

USUAL_SHIFT_PX = 24.0
"""Largest shift without calibration shifts in the configuration: 3 % of a frame of 884 rows, rounded to the cross of the paper."""
_LOADED = ("load_frame", "limits", "model", "confirmed_unusual")
_UNCHANGED = ("hold_s", "settle_s", "stage_tolerance_um", "motion_timeout_s", "frame_timeout_s", "recentre_beyond_px")


def plan_text(path: Path) -> str:
    """Configuration of the qualifying run for an instrument, as YAML.

    Devices, export folder and correlation are those of the instrument's configuration. The steps are pairs in place, which show the
    decay of the drift, and a cross of shifts as large as the configuration's own calibration.

    Args:
        path: configuration of the instrument.

    Raises:
        BadConfig: the configuration is invalid, or has no stage.
    """
    config = load_config(path)
    given = read_yaml(read_regular(path, MOST_BYTES), str(path)).value
    assert isinstance(given, dict)  # a valid configuration
    protocol = given.get("protocol")
    unchanged = {key: value for key, value in protocol.items() if key in _UNCHANGED} if isinstance(protocol, dict) else {}
    shifts = [[0.0, 0.0]] * MIN_PAIRS_DECAY + [[0.5 * _largest_px(config) * x, 0.5 * _largest_px(config) * y] for x, y in STEPS]
    planned = {key: value for key, value in given.items() if key not in _LOADED}
    sem = dict(planned["sem"])
    sem["folder"] = str(config.sem.folder)
    planned["sem"] = sem
    clock = {} if config.run.clock_file is None else {"clock_file": str(config.run.clock_file)}
    planned["run"] = {"name": f"{config.run.name}-qualify", "folder": str(config.run.folder), **clock}
    planned["protocol"] = {**unchanged, "calibration_shifts_px": shifts}
    parse_config(planned, str(path))
    head = "# Run that qualifies the microscope; evaluate it with `semlive qualify --from LOG`.\n"
    return head + yaml.safe_dump(planned, sort_keys=False, allow_unicode=True)


def _largest_px(config: Config) -> float:
    """Largest calibration shift of a configuration along one axis, px."""
    return max((abs(value) for shift in config.protocol.calibration_shifts_px for value in shift), default=0.0) or USUAL_SHIFT_PX
