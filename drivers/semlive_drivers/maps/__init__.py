"""Descriptions of devices as data: those that come with semlive, and those of a laboratory, by path."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from semlive.errors import BadConfig

UNCONFIRMED = "from public documents, confirm before motion"
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
            return Path(name).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or type(error).__name__
            raise BadConfig(f"{name}: cannot be read ({reason}); give the path of a device description") from error
    if name not in known_maps():
        raise BadConfig(f"no device description is called {name!r}; there are {', '.join(known_maps())}, or give the path of a .yaml file")
    return files(__name__).joinpath(f"{name}.yaml").read_text(encoding="utf-8")


def map_content(name: str) -> dict[str, Any]:
    """A description as YAML gives it.

    Raises:
        BadConfig: if there is none, or it is no YAML.
    """
    try:
        content = yaml.safe_load(map_text(name))
    except yaml.YAMLError as error:
        line = getattr(getattr(error, "problem_mark", None), "line", 0) + 1
        raise BadConfig(f"{name}: line {line} is not YAML; check its indentation and colons") from error
    if not isinstance(content, dict) or content.get("protocol") not in ("modbus", "ascii"):
        raise BadConfig(f"{name}: does not say what it is; a device description begins with protocol: modbus, or protocol: ascii")
    return content


def checked_map(model: type[M], name: str) -> M:
    """A description, checked.

    Raises:
        BadConfig: naming the first thing that is wrong in it.
    """
    content = map_content(name)
    try:
        return model.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise BadConfig(f"{name}: {key}: {first['msg']}; correct the description") from None
