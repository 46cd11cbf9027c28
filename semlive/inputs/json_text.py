"""JSON of limited depth, because the parser of the standard library and most functions on its results are recursive."""

from __future__ import annotations

import json
import re
from typing import Any

MOST_NESTED = 100
"""Largest depth of nested lists and objects; files of semlive have at most 12."""

# A string is one token, because brackets in it are text.
_TOKEN = re.compile(rb'"[^"\\]*(?:\\.[^"\\]*)*"|[\[{\]}]', re.DOTALL)


def parse_json(data: bytes | str) -> Any:
    """Parse a JSON text.

    Raises:
        ValueError: the text is not JSON, contains NaN or an infinity, or is nested more than `MOST_NESTED` deep.
    """
    require_shallow(data.encode() if isinstance(data, str) else data)
    return json.loads(data, parse_constant=_not_finite)


def require_shallow(data: bytes) -> None:
    """Refuse a JSON text that is nested too deeply, before it is parsed.

    Raises:
        ValueError: the text is nested more than `MOST_NESTED` deep.
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


def _not_finite(constant: str) -> float:
    raise ValueError(f"{constant} is not a finite number")
