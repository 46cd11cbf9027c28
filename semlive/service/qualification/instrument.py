"""Sections of the configuration of an instrument that a run without load takes over."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from semlive.inputs.files import read_regular
from semlive.inputs.yaml_text import MOST_BYTES, read_yaml
from semlive.service.config.configuration import Config, load_config

_LOADED = ("load_frame", "limits", "model", "confirmed_unusual")
_UNCHANGED = ("hold_s", "settle_s", "stage_tolerance_um", "motion_timeout_s", "frame_timeout_s", "recentre_beyond_px")


@dataclass(frozen=True, slots=True, eq=False)
class Instrument:
    """An instrument.

    Attributes:
        config: its configuration.
        sections: the sections of the configuration for a run without load; ``protocol`` has no shifts. Folders are absolute.
    """

    config: Config
    sections: dict[str, dict[str, object]]


def instrument_of(path: Path, purpose: str) -> Instrument:
    """Read the configuration of an instrument.

    Args:
        path: the configuration.
        purpose: suffix of the name of the run.

    Raises:
        BadConfig: the configuration is invalid.
    """
    config = load_config(path)
    given = read_yaml(read_regular(path, MOST_BYTES), str(path)).value
    assert isinstance(given, dict)  # a valid configuration
    sections = {key: value for key, value in given.items() if key not in _LOADED and isinstance(value, dict)}
    sections["sem"] = {**sections["sem"], "folder": str(config.sem.folder)}
    clock = {} if config.run.clock_file is None else {"clock_file": str(config.run.clock_file)}
    sections["run"] = {"name": f"{config.run.name}-{purpose}", "folder": str(config.run.folder), **clock}
    sections["protocol"] = {key: value for key, value in given["protocol"].items() if key in _UNCHANGED}
    return Instrument(config, sections)
