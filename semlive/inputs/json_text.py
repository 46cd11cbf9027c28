"""JSON of limited depth: the parser of the standard library is recursive, and so is most of what walks through its result."""

from __future__ import annotations

import json
import re
from typing import Any

MOST_NESTED = 100
"""Lists and objects within each other that are still read; nothing that semlive writes has more than 12."""

# A string is one token, as brackets in it do not count.
_TOKEN = re.compile(rb'"[^"\\]*(?:\\.[^"\\]*)*"|[\[{\]}]', re.DOTALL)


def parse_json(data: bytes | str) -> Any:
    """What a JSON text holds.

    Raises:
        ValueError: it is no JSON, holds NaN or an infinity, or is nested more than `MOST_NESTED` deep.
    """
    require_shallow(data.encode() if isinstance(data, str) else data)
    return json.loads(data, parse_constant=_not_finite)


def require_shallow(data: bytes) -> None:
    """Refuse a JSON text that is nested too deeply, before it is parsed.

    Raises:
        ValueError: it is nested more than `MOST_NESTED` deep.
    """
    if data.count(b"[") + data.count(b"{") <= MOST_NESTED:
        return
    depth = 0
    for match in _TOKEN.finditer(data):
        token = data[match.start()]
        if token in b"[{":
            depth += 1
            if depth > MOST_NESTED:
                raise ValueError(f"JSON nested more than {MOST_NESTED} deep")
        elif token in b"]}":
            depth -= 1


def _not_finite(word: str) -> float:
    raise ValueError(f"{word} is not a finite number")
