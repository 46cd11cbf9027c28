"""Settings changed by name, as in ``--set dic.subset=31``."""

from __future__ import annotations

import dataclasses
import difflib
import typing
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import TypeAdapter, ValidationError

from semlive.data.settings import AnalysisSettings
from semlive.errors import BadConfig
from semlive.inputs.kinds import changed_kind
from semlive.inputs.yaml_text import read_yaml

_UNITS = ("_px", "_points", "_s", "_m", "_mm2")
_OF_IMAGES = ("dic.", "scan.")
_MODEL = "model"  # `--model` changes it, whole


@dataclass(frozen=True, slots=True)
class SettingOverride:
    """One setting and its new value.

    Attributes:
        key: its whole name, as in ``dic.subset_px``.
        value: checked for its type.
    """

    key: str
    value: Any

    @property
    def of_images(self) -> bool:
        """Whether a setting affects only decoding and correlation of images."""
        return self.key.startswith(_OF_IMAGES)


def parse_changes(words: Iterable[str]) -> tuple[SettingOverride, ...]:
    """``key=value`` words as changes; a key's unit may be left out (``dic.subset`` is ``dic.subset_px``).

    Raises:
        BadConfig: a key is unknown (the nearest is named) or a value is not of its type.
    """
    known = _keys(AnalysisSettings)
    return tuple(_change(word, known) for word in words)


def apply_overrides(settings: AnalysisSettings, changes: Iterable[SettingOverride]) -> AnalysisSettings:
    """The settings with changes made.

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
    """Return the value of every setting by its full name, as in ``dic.subset_px``."""
    model = ", ".join(one.name for one in settings.model.effects)
    return {key: _value(settings, key.split(".")) for key in _keys(AnalysisSettings)} | ({_MODEL: model} if model else {})


def _value(settings: Any, path: list[str]) -> Any:
    for name in path:
        settings = getattr(settings, name)
    return settings


def _keys(cls: type, before: str = "") -> dict[str, Any]:
    """Return the full name and the type of every setting."""
    found: dict[str, Any] = {}
    hints = typing.get_type_hints(cls)
    for one in dataclasses.fields(cls):
        if before + one.name == _MODEL:
            continue
        kind = hints[one.name]
        if dataclasses.is_dataclass(kind):
            found |= _keys(typing.cast(type, kind), f"{before}{one.name}.")
        else:
            found[before + one.name] = kind
    return found


def _change(word: str, known: Mapping[str, Any]) -> SettingOverride:
    key, equals, text = word.partition("=")
    key = key.strip()
    if not equals:
        raise BadConfig(f"--set {word}: has no value; write key=value as in --set dic.subset=31.")
    whole = next((name for name in (key, *(key + unit for unit in _UNITS)) if name in known), None)
    if whole is None:
        close = difflib.get_close_matches(key, known, n=1, cutoff=0.4)
        hint = f"did you mean {close[0]}?" if close else f"known keys are {', '.join(known)}"
        raise BadConfig(f"--set {word}: unknown key {key}; {hint}")
    # On a command line a list is written without spaces.
    items = text.strip().removeprefix("[").removesuffix("]")
    try:
        given = read_yaml(f"[{', '.join(items.split(','))}]" if "," in text else text, "").value
    except BadConfig:
        raise BadConfig(f"--set {word}: {text!r} is no value; write a number, a word or a list a,b,c.") from None
    try:
        value = TypeAdapter(known[whole]).validate_python(given)
        changed = changed_kind(given, value)
        if changed is not None:
            raise BadConfig(f"--set {word}: {changed[1]}.")
        return SettingOverride(whole, value)
    except ValidationError as error:
        raise BadConfig(f"--set {word}: {error.errors()[0]['msg'].lower()}; correct the value of {whole}.") from None


def _replaced(settings: Any, path: list[str], value: Any) -> Any:
    head, *rest = path
    return dataclasses.replace(settings, **{head: _replaced(getattr(settings, head), rest, value) if rest else value})


def _shown(value: Any) -> str:
    return ",".join(map(str, value)) if isinstance(value, tuple) else str(value)
