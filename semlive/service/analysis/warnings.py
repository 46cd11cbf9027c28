"""Warnings of the estimate during a run: each warning once, when it first becomes significant."""

from __future__ import annotations

import re
from collections.abc import Sequence

_SIGN = "WARNING: "
_NUMBER = re.compile(r"\d")


def new_warnings(notes: Sequence[str], before: frozenset[str]) -> tuple[tuple[str, ...], frozenset[str]]:
    """Return the new warnings, and all warnings so far.

    Args:
        notes: notes of the newest estimate; estimates between two reviews have no warnings.
        before: earlier warnings, without their figures.
    """
    warnings = {_NUMBER.split(note)[0]: note.removeprefix(_SIGN) for note in notes if note.startswith(_SIGN)}
    return tuple(text for kind, text in warnings.items() if kind not in before), before | frozenset(warnings)
