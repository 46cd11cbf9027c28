"""Lines of ``key=value`` and ``$KEY value``, as several vendors write them into their images or into sidecars."""

from __future__ import annotations

import codecs
import re
from collections.abc import Collection, Mapping

MAX_TEXT_BYTES = 2**20
_GEOMETRY = re.compile(r"tiltcorr|dyn(amic)?(focus|wd)|interlac|(reduced|scan)(area|raster)|zoom|driftcorr|line(integ|aver|acc|scan)")


def decode_text(raw: bytes) -> str:
    """Decode a text file of a Windows program: UTF-16 or UTF-8 with or without byte order mark, else the western code page."""
    raw = raw[:MAX_TEXT_BYTES]
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return raw.decode("utf-16", errors="replace")
    if raw.startswith(codecs.BOM_UTF8):
        return raw.decode("utf-8-sig", errors="replace")
    if raw[1:2] == b"\0":
        return raw.decode("utf-16-le", errors="replace")
    if raw[:1] == b"\0":
        return raw.decode("utf-16-be", errors="replace")
    try:
        return raw.decode("utf-8")  # bytes above 127 of a code page are hardly ever valid UTF-8
    except UnicodeDecodeError:
        return raw.decode("cp1252", errors="replace")


def parse_equals_lines(text: str) -> dict[str, str]:
    """Return values by key of ``key=value`` lines; the first of equal keys is used, sections are ignored."""
    return _values(text, "=")


def parse_dollar_lines(text: str) -> dict[str, str]:
    """Return values by key of ``$KEY value`` lines; the first of equal keys is used."""
    return {key: value for key, value in _values(text, " ").items() if key.startswith("$")}


def further_geometry(values: Mapping[str, str], others: Collection[str] = ()) -> tuple[str, ...]:
    """Return keys with their values that are about the geometry of the scan by their names, except those that are read elsewhere.

    No public file of the vendor contains them, so their values are compared as they are.
    """
    names = {key: re.sub(r"[^a-z]", "", key.lower()) for key in values if key not in others and values[key]}
    return tuple(f"{key} {values[key]}" for key, name in names.items() if _GEOMETRY.search(name))


def _values(text: str, mark: str) -> dict[str, str]:
    values: dict[str, str] = {}
    for line in text[:MAX_TEXT_BYTES].splitlines():
        key, separator, value = line.strip(" \t\0\ufeff").partition(mark)
        if separator and 0 < len(key) <= 60:
            values.setdefault(key.strip(), value.strip(" \t\0")[:400])
    return values
