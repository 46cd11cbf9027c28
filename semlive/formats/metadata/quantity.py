"""Numbers with units in the formats of microscopes."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass

from semlive.inputs.text_number import Sign, sign_of

_NUMBER = r"\s*([+-]?(?:\d{1,20}[.,]?\d{0,20}|[.,]\d{1,20})(?:[eE][+-]?\d{1,4})?)"
_QUANTITY = re.compile(_NUMBER + r"\s*(\D{0,12}?)\s*")
_MICRO = ("?", "u")
_FOREIGN_MICRO = re.compile(r"[^\x00-\x7f°]{1,3}([ms])")
"""A micro sign of any code page: no other prefix of a unit is outside ASCII."""
_SCALES = {
    **dict.fromkeys(("secs", "sec", "s"), 1.0),
    **dict.fromkeys(("mins", "min"), 60.0),
    **dict.fromkeys(("hours", "hrs", "hour", "h"), 3600.0),
    "ms": 1e-3,
    "ns": 1e-9,
    "m": 1.0,
    "mm": 1e-3,
    "cm": 1e-2,
    "nm": 1e-9,
    "pm": 1e-12,
    "fm": 1e-15,
    **dict.fromkeys(("v", "volt", "volts"), 1.0),
    "kv": 1e3,
    **dict.fromkeys(("", "x", "°", "deg"), 1.0),
    **dict.fromkeys(("k x", "kx", "k"), 1e3),
    **{f"{micro.lower()}{unit}": 1e-6 for micro in _MICRO for unit in ("m", "s")},
}


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number in base units (s, m, V, degrees, or none).

    Attributes:
        value: the number.
        half_digit: half a unit of its last printed digit.
    """

    value: float
    half_digit: float


def quantity(text: str) -> Quantity | None:
    """Parse a number with a unit, for example ``949  µs`` as 9.49e-4; None if it is not a finite number with a known unit."""
    match = _QUANTITY.fullmatch(text[:60])
    if match is None:
        return None
    unit = match[2].lower()
    scale = 1e-6 if _FOREIGN_MICRO.fullmatch(unit) else _SCALES.get(unit)
    value = number(match[1])
    if scale is None or value is None:
        return None
    mantissa, _, exponent = match[1].lower().partition("e")
    digits = len(mantissa.replace(",", ".").partition(".")[2])
    power = min(max(int(exponent or 0) - digits, -300), 300)
    return Quantity(value * scale, 0.5 * scale * 10.0**power)


def number(text: str | None) -> float | None:
    """Parse a finite number without unit, with a decimal point or comma; None for other texts, also for ``1,024``, which may be 1024."""
    if text is None or len(text) > 60 or "_" in text:
        return None
    text = text.strip()
    if sign_of(text) is Sign.COMMA or text.startswith("0,"):
        text = text.replace(",", ".")
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def decimal_sign_of(texts: Iterable[str]) -> str:
    """Return the decimal sign of the numbers, with or without units, among some texts; empty if none shows it or they differ."""
    signs = {sign_of(_mantissa(text)) for text in texts}
    shown = [sign for sign, kind in ((".", Sign.POINT), (",", Sign.COMMA)) if kind in signs]
    return shown[0] if len(shown) == 1 else ""


def may_be_thousands(text: str) -> bool:
    """Whether a number with or without a unit may be small or a thousand times larger: ``1,984 nm``."""
    return sign_of(_mantissa(text)) in (Sign.POINT_OR_THOUSANDS, Sign.COMMA_OR_THOUSANDS)


def with_decimal_point(text: str, decimal: str) -> str:
    """Return a number that may have thousands, with or without a unit, in the way of a table with this decimal sign."""
    return text.replace(decimal, ".", 1) if decimal in _mantissa(text) else re.sub("[.,]", "", text, count=1)


def _mantissa(text: str) -> str:
    match = _QUANTITY.fullmatch(text[:60])
    return "" if match is None else match[1]


def positive(text: str | None) -> float | None:
    """Parse a finite number above zero; None for other texts."""
    value = number(text)
    return value if value is not None and value > 0 else None


def unread_notes(values: Iterable[tuple[str, str]]) -> tuple[str, ...]:
    """Return a note for each text by its key that is neither empty nor a number with an optional unit, so it counts as missing."""
    return tuple(f"its {key} {text[:40]!r} was not understood." for key, text in values if text.strip() and quantity(text) is None)
