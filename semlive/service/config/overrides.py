"""Settings changed by name, as in ``--set dic.subset=31``."""

from __future__ import annotations

import dataclasses
import difflib
import typing
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from semlive.data.settings import AnalysisSettings
from semlive.errors import BadConfig
from semlive.inputs.kinds import changed_kind
from semlive.inputs.mask_file import mask_text
from semlive.inputs.yaml_text import read_yaml
from semlive.service.config.mask import read_mask_file

_UNITS = ("_px", "_points", "_s", "_m", "_mm2")
_OF_IMAGES = ("dic.", "scan.")
_MODEL = "model"  # `--model` replaces it completely
_MASK = "dic.mask"


@dataclass(frozen=True, slots=True)
class SettingOverride:
    """One setting and its new value.

    Attributes:
        key: full name, as in ``dic.subset_px``.
        value: value of the right type.
    """

    key: str
    value: Any

    @property
    def of_images(self) -> bool:
        """Whether a setting affects only decoding and correlation of images."""
        return self.key.startswith(_OF_IMAGES)


def parse_changes(texts: Iterable[str]) -> tuple[SettingOverride, ...]:
    """Convert texts ``key=value`` into changes; the unit of a key may be left out (``dic.subset`` is ``dic.subset_px``).

    Raises:
        BadConfig: a key is unknown (the message suggests the most similar one) or a value has the wrong type.
    """
    types = _keys(AnalysisSettings)
    return tuple(_change(text, types) for text in texts)


def apply_overrides(settings: AnalysisSettings, changes: Iterable[SettingOverride]) -> AnalysisSettings:
    """Return the settings with the changes applied.

    Raises:
        BadConfig: a value is out of its range.
    """
    for change in changes:
        try:
            settings = _replaced(settings, change.key.split("."), change.value)
        except ValueError as error:
            raise BadConfig(f"--set {change.key}={_shown(change.value)}: {error}; correct it.") from error
    return settings


def as_keys(settings: AnalysisSettings) -> dict[str, Any]:
    """Return the value of every setting by its full name, as in ``dic.subset_px``; of a mask size, excluded part and checksum."""
    model = ", ".join(effect.name for effect in settings.model.effects)
    values = {key: _value(settings, key.split(".")) for key in _keys(AnalysisSettings)} | ({_MODEL: model} if model else {})
    return values if values[_MASK] is None else {**values, _MASK: mask_text(values[_MASK])}


def _value(settings: Any, path: list[str]) -> Any:
    for name in path:
        settings = getattr(settings, name)
    return settings


def _keys(cls: type, prefix: str = "") -> dict[str, Any]:
    """Return the full name and the type of every setting."""
    types: dict[str, Any] = {}
    hints = typing.get_type_hints(cls)
    for field in dataclasses.fields(cls):
        if prefix + field.name == _MODEL:
            continue
        kind = hints[field.name]
        if dataclasses.is_dataclass(kind):
            types |= _keys(typing.cast(type, kind), f"{prefix}{field.name}.")
        else:
            types[prefix + field.name] = kind
    return types


def _change(argument: str, types: Mapping[str, Any]) -> SettingOverride:
    key, equals, text = argument.partition("=")
    key = key.strip()
    if not equals:
        raise BadConfig(f"--set {argument}: has no value; write key=value as in --set dic.subset=31.")
    full_name = next((name for name in (key, *(key + unit for unit in _UNITS)) if name in types), None)
    if full_name is None:
        close = difflib.get_close_matches(key, types, n=1, cutoff=0.4)
        hint = f"did you mean {close[0]}?" if close else f"known keys are {', '.join(types)}"
        raise BadConfig(f"--set {argument}: unknown key {key}; {hint}")
    # On a command line a list is written without spaces.
    items = text.strip().removeprefix("[").removesuffix("]")
    try:
        given = read_yaml(f"[{', '.join(items.split(','))}]" if "," in text else text, "").value
    except BadConfig:
        raise BadConfig(f"--set {argument}: {text!r} is no value; write a number, a name or a list a,b,c.") from None
    try:
        value = TypeAdapter(types[full_name]).validate_python(given)
        changed = changed_kind(given, value)
        if changed is not None:
            raise BadConfig(f"--set {argument}: {changed[1]}.")
        return SettingOverride(full_name, read_mask_file(Path(value)) if full_name == _MASK and value is not None else value)
    except ValidationError as error:
        raise BadConfig(f"--set {argument}: {error.errors()[0]['msg'].lower()}; correct the value of {full_name}.") from None


def _replaced(settings: Any, path: list[str], value: Any) -> Any:
    head, *rest = path
    return dataclasses.replace(settings, **{head: _replaced(getattr(settings, head), rest, value) if rest else value})


def _shown(value: Any) -> str:
    return ",".join(map(str, value)) if isinstance(value, tuple) else str(value)
