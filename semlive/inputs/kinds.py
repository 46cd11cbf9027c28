"""Comparison of checked settings with the given values: text must not have become a number."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping

from pydantic import BaseModel

Place = tuple[str | int, ...]


def changed_kind(given: object, checked: object) -> tuple[Place, str] | None:
    """Return the place of the first value whose kind changed in the check, and a message; None if no kind changed.

    pydantic converts `'30'` and `true` to numbers, and `'no'` and 1 to truth values. Its strict mode also refuses a list for a tuple
    and text for a path, which YAML files cannot avoid; therefore the kinds are compared after the check.

    Args:
        given: value from YAML.
        checked: value from pydantic: models, dataclasses, lists, values.
    """
    return next(_changes(given, checked, ()), None)


def _changes(given: object, checked: object, place: Place) -> Iterator[tuple[Place, str]]:
    if isinstance(given, Mapping):
        for key, value in given.items():
            inner = _inside(checked, key)
            if inner is not None:
                yield from _changes(value, inner, (*place, key))
    elif isinstance(given, list | tuple):
        if isinstance(checked, list | tuple):
            for index, (given_item, checked_item) in enumerate(zip(given, checked, strict=False)):
                yield from _changes(given_item, checked_item, (*place, index))
    elif isinstance(checked, bool):
        if not isinstance(given, bool):
            yield place, f"{_shown(given)} is no truth value; write true or false"
    elif isinstance(checked, int | float) and isinstance(given, str | bool):
        kind = "text" if isinstance(given, str) else "a truth value"
        yield place, f"{_shown(given)} is {kind}, not a number; write a finite number{' without quotes' if isinstance(given, str) else ''}"


def _inside(checked: object, key: object) -> object:
    """Return the value of a key, or None; aliases of fields are not resolved."""
    if isinstance(checked, Mapping):
        return checked.get(key)
    if isinstance(checked, BaseModel) or dataclasses.is_dataclass(checked):
        return getattr(checked, str(key), None)
    return None


def _shown(given: object) -> str:
    return f"'{given}'" if isinstance(given, str) else str(given).lower() if isinstance(given, bool) else str(given)
