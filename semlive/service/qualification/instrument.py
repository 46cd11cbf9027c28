"""Sections of the configuration of an instrument that a run without load takes over."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import yaml

from semlive.inputs.files import read_regular
from semlive.inputs.yaml_text import MOST_BYTES, read_yaml
from semlive.service.config.configuration import Config, load_config, parse_config
from semlive.service.log.opened_log import OpenedLog
from semlive.service.qualification.log_pairs import is_log

Sections = dict[str, dict[str, object]]

MAX_RUNS = 1000
"""Runs of one name and purpose in a folder; a further one is refused by the run, because its log exists."""
_LOADED = ("load_frame", "model")
"""Sections that a run without load omits. The limits remain: they bound the travel of the stage and the age of its readings."""
_UNCHANGED = ("hold_s", "settle_s", "stage_tolerance_um", "motion_timeout_s", "frame_timeout_s", "recentre_beyond_px")


@dataclass(frozen=True, slots=True, eq=False)
class Instrument:
    """An instrument.

    Attributes:
        config: its configuration.
        sections: the sections of the configuration for a run without load; ``protocol`` has no shifts. Paths are absolute.
        confirmed: keys whose implausible values are intended.
    """

    config: Config
    sections: Sections
    confirmed: tuple[str, ...]


def instrument_of(path: Path, purpose: str) -> Instrument:
    """Read the configuration of an instrument.

    Args:
        path: the configuration, or the log of a run of the instrument.
        purpose: suffix of the name of the run.

    Raises:
        BadInput: the configuration is invalid, or the log cannot be read.
    """
    config, given = _logged(path) if is_log(path) else _written(path)
    sections: Sections = {key: dict(value) for key, value in given.items() if key not in _LOADED and isinstance(value, dict)}
    sections["sem"]["folder"] = str(config.sem.folder)
    name = _unused(config.run.folder, f"{config.run.name}-{purpose}")
    sections["run"] = {**sections.get("run", {}), "name": name, "folder": str(config.run.folder)}
    if config.run.clock_file is not None:
        sections["run"]["clock_file"] = str(config.run.clock_file)
    if config.alerts is not None:
        sections["alerts"]["file"] = str(config.alerts.file)
    sections["protocol"] = {key: value for key, value in sections["protocol"].items() if key in _UNCHANGED}
    return Instrument(config, sections, tuple(config.confirmed_unusual))


def _unused(folder: Path, name: str) -> str:
    """A name of a run without a log in the folder: an instrument is qualified again and again, and a step may be repeated."""
    names = (name, *(f"{name}-{number}" for number in range(2, MAX_RUNS)))
    return next((one for one in names if not (folder / one).exists()), name)


def operator_stage(um_per_px: float) -> dict[str, object]:
    """Section of a stage that an operator moves, or of shifts of the beam that an operator sets."""
    return {"driver": "operator", "settings": {"um_per_px": um_per_px}}


def run_text(head: str, sections: Sections, confirmed: tuple[str, ...], where: str) -> str:
    """Configuration of a run as YAML, after a comment.

    Args:
        head: lines of the comment.
        sections: of the configuration.
        confirmed: keys whose implausible values are intended.
        where: what the configuration is made from, for messages.

    Raises:
        BadConfig: the sections contradict each other.
    """
    content = {**sections, **({"confirmed_unusual": list(confirmed)} if confirmed else {})}
    parse_config(content, where)
    return head + yaml.safe_dump(content, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)


def _written(path: Path) -> tuple[Config, Mapping[str, object]]:
    """Configuration of a file, and its content with the absolute path of the mask."""
    config = load_config(path)
    given = read_yaml(read_regular(path, MOST_BYTES), str(path)).value
    assert isinstance(given, dict)  # a valid configuration
    dic = given.get("dic")
    if isinstance(dic, dict) and dic.get("mask"):
        dic["mask"] = str((path.parent / str(dic["mask"])).resolve())
    return config, given


def _logged(path: Path) -> tuple[Config, Mapping[str, object]]:
    """Configuration of a run by its log, which contains the mask itself, and its values other than defaults."""
    config = parse_config(OpenedLog(path).run.config, f"{path}: the run's configuration")
    return config, config.model_dump(mode="json", exclude_defaults=True)
