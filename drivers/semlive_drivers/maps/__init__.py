"""Descriptions of devices as data: those that come with semlive, and those of a laboratory, by path."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from semlive.errors import BadConfig
from semlive.inputs.files import read_regular
from semlive.inputs.kinds import changed_kind
from semlive.inputs.yaml_text import MOST_BYTES, YamlText, read_yaml

UNCONFIRMED_NOTE = "from public documents, confirm before motion"
"""What a description says of itself that nobody has held beside the machine."""

M = TypeVar("M", bound=BaseModel)


def known_maps() -> tuple[str, ...]:
    """Names of the descriptions that come with semlive."""
    return tuple(sorted(item.name.removesuffix(".yaml") for item in files(__name__).iterdir() if item.name.endswith(".yaml")))


def map_text(name: str) -> str:
    """The text of a description, by name or by path (anything that ends in .yaml or .yml, or holds a slash).

    Raises:
        BadConfig: if there is none.
    """
    if name.endswith((".yaml", ".yml")) or "/" in name or "\\" in name:
        try:
            return read_regular(Path(name), MOST_BYTES).decode("utf-8-sig")
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or type(error).__name__
            raise BadConfig(f"{name}: cannot be read ({reason}); give the path of a device description") from error
    if name not in known_maps():
        raise BadConfig(f"no device description is called {name!r}; there are {', '.join(known_maps())}, or give the path of a .yaml file")
    return files(__name__).joinpath(f"{name}.yaml").read_text(encoding="utf-8")


def map_content(name: str) -> dict[str, Any]:
    """A description as YAML gives it.

    Raises:
        BadConfig: if there is none, it is no YAML, or it has a key twice or a value that can be misread.
    """
    return _description(name)[0]


def _description(name: str) -> tuple[dict[str, Any], YamlText]:
    text = read_yaml(map_text(name), name)
    content = text.value
    if not isinstance(content, dict) or content.get("protocol") not in ("modbus", "ascii"):
        raise BadConfig(f"{name}: does not say what it is; a device description begins with protocol: modbus, or protocol: ascii")
    return content, text


def validate_map(model: type[M], name: str) -> M:
    """A description, checked.

    Raises:
        BadConfig: naming the first thing that is wrong in it.
    """
    content, text = _description(name)
    try:
        found = model.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise BadConfig(f"{name}: {_at(text, first['loc'])}{key}: {first['msg']}; correct the description") from None
    changed = changed_kind(content, found)
    if changed is not None:
        raise BadConfig(f"{name}: {_at(text, changed[0])}{'.'.join(map(str, changed[0]))}: {changed[1]}")
    return found


def _at(text: YamlText, place: tuple[str | int, ...]) -> str:
    line = text.line(place)
    return "" if line is None else f"line {line}: "
