"""Numbers with units in the formats of microscopes."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

_NUMBER = r"\s*([+-]?(?:\d{1,20}\.?\d{0,20}|\.\d{1,20})(?:[eE][+-]?\d{1,4})?)"
_QUANTITY = re.compile(_NUMBER + r"\s*(\D{0,12}?)\s*")
# A micro sign that went through the wrong code page: cp1252 read as UTF-8, UTF-8 read as cp1252, Greek mu, or a bare question mark.
_MICRO = ("\u00b5", "\u03bc", "\u00c2\u00b5", "\u00ce\u00bc", "?", "\ufffd", "u")
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
    scale = _SCALES.get(match[2].lower())
    value = number(match[1])
    if scale is None or value is None:
        return None
    mantissa, _, exponent = match[1].lower().partition("e")
    digits = len(mantissa.partition(".")[2])
    power = min(max(int(exponent or 0) - digits, -300), 300)
    return Quantity(value * scale, 0.5 * scale * 10.0**power)


def number(text: str | None) -> float | None:
    """Parse a finite number without unit; None for other texts."""
    if text is None or len(text) > 60:
        return None
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def positive(text: str | None) -> float | None:
    """Parse a finite number above zero; None for other texts."""
    value = number(text)
    return value if value is not None and value > 0 else None
