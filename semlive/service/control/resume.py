"""Resuming an interrupted run: its state is read from its log segments, and its configuration must be the same.

The log is the only source: pairs, readings and exports up to its truncation.
"""

from __future__ import annotations

from pathlib import Path

from semlive.errors import BadConfig, BadLog
from semlive.formats.log.messages import (
    RunMessage,
)
from semlive.inputs.mask_file import mask_text
from semlive.service.config.configuration import Config, parse_config
from semlive.service.control.previous_segments import PreviousSegments
from semlive.service.control.segment_reader import SegmentReader
from semlive.service.log.files import PARTIAL_SUFFIX, SUFFIX, messages, segments

# Configuration keys that may change, because they affect no measurement; all others must be equal.
_CHANGEABLE_KEYS = frozenset({"run.folder", "run.segment_gb", "specimen.yield_strength_mpa", "confirmed_unusual"})


def read_previous_segments(folder: Path, config: Config) -> PreviousSegments:
    """Read the log of an interrupted run.

    Args:
        folder: run folder.
        config: configuration of the resumed run.

    Raises:
        BadConfig: there is no such run, it is complete, or its configuration differs.
        BadLog: the log cannot be read, or lacks data of its pairs.
    """
    if not folder.is_dir() or not any(path.name.removesuffix(PARTIAL_SUFFIX).endswith(SUFFIX) for path in folder.iterdir()):
        raise BadConfig(f"{folder}: there is no such run to resume; leave --resume out to begin it")
    reader, damage = SegmentReader(), list[str]()
    for message in messages(folder, damage.append):
        reader.add(message)
    if reader.run is None:
        raise BadLog(f"{folder}: the log does not hold the configuration of its run; begin a run of another name")
    _require_same_configuration(folder, reader.run, config)
    return reader.result(folder, _next_segment(folder), tuple(damage))


def _next_segment(folder: Path) -> int:
    names = (path.name.removesuffix(PARTIAL_SUFFIX).removesuffix(SUFFIX).rpartition(".")[2] for path in segments(folder))
    return 1 + max(int(name) if name.isdecimal() else 0 for name in names)


def _require_same_configuration(folder: Path, run: RunMessage, config: Config) -> None:
    # Validated again, so that a key of a later version has its default in both configurations.
    logged = _flat(parse_config(run.config, f"{folder}: the log's configuration").model_dump(mode="json"))
    configured = _flat(config.model_dump(mode="json"))
    for key in sorted(logged.keys() | configured.keys()):
        if key not in _CHANGEABLE_KEYS and logged.get(key) != configured.get(key):
            raise BadConfig(
                f"{folder}: {key} is {_format_value(configured, key)} in the configuration and {_format_value(logged, key)} in the log; "
                "a run continues with the configuration that it began with, so correct it, or begin a run of another name"
            )


def _flat(section: object, place: str = "") -> dict[str, object]:
    if not isinstance(section, dict) or not section:
        return {place: section}
    return {key: value for name, part in section.items() for key, value in _flat(part, f"{place}.{name}" if place else str(name)).items()}


def _format_value(flat: dict[str, object], key: str) -> str:
    value = str(flat.get(key))
    return "absent" if key not in flat else "empty" if flat[key] is None else mask_text(value) if key == "dic.mask" else value
