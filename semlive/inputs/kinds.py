"""Whether checked settings still have the kinds of values that were given: text must not have become a number."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping

from pydantic import BaseModel

Place = tuple[str | int, ...]


def changed_kind(given: object, checked: object) -> tuple[Place, str] | None:
    """The first value whose kind changed when it was checked, and what is wrong with it; None if there is none.

    pydantic makes a number of `'30'` and of `true`, and a truth value of `'no'` and of 1. Its strict mode refuses a list for a tuple
    and text for a path as well, which no YAML file can avoid; so the kinds are compared afterwards.

    Args:
        given: as YAML gave it.
        checked: what pydantic made of it: models, dataclasses, lists, values.
    """
    return next(_changes(given, checked, ()), None)


def _changes(given: object, checked: object, place: Place) -> Iterator[tuple[Place, str]]:
    if isinstance(given, Mapping):
        for key, value in given.items():
            found = _inside(checked, key)
            if found is not None:
                yield from _changes(value, found, (*place, key))
    elif isinstance(given, list | tuple):
        if isinstance(checked, list | tuple):
            for index, (one, other) in enumerate(zip(given, checked, strict=False)):
                yield from _changes(one, other, (*place, index))
    elif isinstance(checked, bool):
        if not isinstance(given, bool):
            yield place, f"{_shown(given)} is no truth value; write true or false"
    elif isinstance(checked, int | float) and isinstance(given, str | bool):
        kind = "text" if isinstance(given, str) else "a truth value"
        yield place, f"{_shown(given)} is {kind}, not a number; write a finite number{' without quotes' if isinstance(given, str) else ''}"


def _inside(checked: object, key: object) -> object:
    """What stands behind a key, or None; an alias of a field is not followed."""
    if isinstance(checked, Mapping):
        return checked.get(key)
    if isinstance(checked, BaseModel) or dataclasses.is_dataclass(checked):
        return getattr(checked, str(key), None)
    return None


def _shown(given: object) -> str:
    return f"'{given}'" if isinstance(given, str) else str(given).lower() if isinstance(given, bool) else str(given)
