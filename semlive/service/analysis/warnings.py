"""What the estimate warns of while a run goes on: each thing once, when it first stops being noise."""

from __future__ import annotations

import re
from collections.abc import Sequence

_SIGN = "WARNING: "
_NUMBER = re.compile(r"\d")


def new_warnings(notes: Sequence[str], before: frozenset[str]) -> tuple[tuple[str, ...], frozenset[str]]:
    """Sentences that warn of something for the first time, and everything that was warned of so far.

    Args:
        notes: of the newest estimate; those between two looks at the whole have no warnings.
        before: what was warned of, without its figures.
    """
    said = {_NUMBER.split(one)[0]: one.removeprefix(_SIGN) for one in notes if one.startswith(_SIGN)}
    return tuple(text for kind, text in said.items() if kind not in before), before | frozenset(said)
