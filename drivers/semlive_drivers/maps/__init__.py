"""Device descriptions: those that come with semlive, and others by path."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from semlive.errors import BadConfig, LinkError
from semlive.inputs.files import read_regular
from semlive.inputs.kinds import changed_kind
from semlive.inputs.yaml_text import MOST_BYTES, YamlText, read_yaml

PATTERNS = ("generic",)
"""Descriptions to copy, which are of no machine."""
UNCONFIRMED_NOTE = "from public documents, confirm before motion"
"""Status of a description that was not compared with the machine."""


class Described(BaseModel):
    """A section of a device description."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class DeviceDescription(Described):
    """Keys that device descriptions of all protocols share."""

    name: str
    source: str
    """Documents from which the description was written, and whether it was compared with the machine."""
    confirmed: bool = False
    """True only if the device moved as described in a test; otherwise a motion requires `confirmed: true` in the configuration."""
    notes: str = ""
    plausible: dict[str, tuple[float, float]] = Field(default_factory=dict)
    """Range of a value at rest by point or group, for `semlive frame check`."""


M = TypeVar("M", bound=BaseModel)


def bundled_maps() -> tuple[str, ...]:
    """Names of the descriptions that come with semlive."""
    return tuple(sorted(item.name.removesuffix(".yaml") for item in files(__name__).iterdir() if item.name.endswith(".yaml")))


def map_text(name: str) -> str:
    """The text of a description.

    Args:
        name: name of a description, or a path: it ends in .yaml or .yml, or contains a slash.

    Raises:
        BadConfig: if it does not exist.
    """
    if name.endswith((".yaml", ".yml")) or "/" in name or "\\" in name:
        try:
            return read_regular(Path(name), MOST_BYTES).decode("utf-8-sig")
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or type(error).__name__
            raise BadConfig(f"{name}: cannot be read ({reason}); give the path of a device description") from error
    if name not in bundled_maps():
        raise BadConfig(
            f"no device description is called {name!r}; there are {', '.join(bundled_maps())}, or give the path of a .yaml file"
        )
    return files(__name__).joinpath(f"{name}.yaml").read_text(encoding="utf-8")


def map_content(name: str) -> dict[str, Any]:
    """A description as parsed from YAML, before validation.

    Raises:
        BadConfig: if it does not exist, is no YAML, or has a key twice or an ambiguous value.
    """
    return _description(name)[0]


def _description(name: str) -> tuple[dict[str, Any], YamlText]:
    text = read_yaml(map_text(name), name)
    content = text.value
    if not isinstance(content, dict) or content.get("protocol") not in ("modbus", "ascii"):
        raise BadConfig(f"{name}: the protocol is missing; a device description begins with protocol: modbus, or protocol: ascii")
    return content, text


def is_of_a_machine(name: str) -> bool:
    """Whether a description comes with semlive and describes a make; the others are of a user, or are a pattern to copy."""
    return name in bundled_maps() and name not in PATTERNS


def validate_map(model: type[M], name: str, changed_content: dict[str, Any] | None = None) -> M:
    """A validated description.

    Args:
        model: form of the description.
        name: name of the description, or a path.
        changed_content: content to validate in place of that of the file; None takes the file.

    Raises:
        BadConfig: for the first key or value that is wrong.
    """
    content, text = _description(name)
    if changed_content is not None:
        content = changed_content
    try:
        description = model.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise BadConfig(f"{name}: {_at(text, first['loc'])}{key}: {first['msg']}; correct the description") from None
    changed = changed_kind(content, description)
    if changed is not None:
        raise BadConfig(f"{name}: {_at(text, changed[0])}{'.'.join(map(str, changed[0]))}: {changed[1]}")
    return description


def require_confirmed(where: str, name: str, *, confirmed: bool) -> None:
    """Refuse a motion of a device whose description was not compared with the machine.

    Args:
        where: name of the device.
        name: name of the description.
        confirmed: as the description or the configuration states.

    Raises:
        LinkError: if it is not confirmed.
    """
    if not confirmed:
        raise LinkError(
            f"{where}: the description of {name} is {UNCONFIRMED_NOTE}; "
            "check it with `semlive frame check`, move the machine by its own panel and watch the values, then set confirmed: true"
        )


def _at(text: YamlText, key: tuple[str | int, ...]) -> str:
    line = text.line(key)
    return "" if line is None else f"line {line}: "
