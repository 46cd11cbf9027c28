"""Numbers, dates and lists in the text of reports."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, datetime

from semlive.data.scan import Provenance, Sourced
from semlive.data.strain import MeasuredValue

NOT_RECORDED = "not recorded"
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_SOURCES = {
    Provenance.FILE: "image file",
    Provenance.DERIVED: "derived from the image file",
    Provenance.CONFIG: "configuration",
    Provenance.ASSUMED: "assumed",
    Provenance.UNKNOWN: NOT_RECORDED,
}


def with_sigma(value: float, sigma: float, unit: str = "") -> str:
    """A value with its standard uncertainty of two significant digits: ``71.19 ± 0.26 GPa`` or ``(1.20 ± 0.40) · 10⁻⁶ 1/s``."""
    space = f" {unit}" if unit else ""
    if not (sigma > 0 and math.isfinite(sigma)):
        return f"{value:.4g}{space} (uncertainty {NOT_RECORDED})"
    exponent = math.floor(math.log10(max(abs(value), sigma)))
    if not -4 < exponent < 6:
        scale = 10.0**-exponent
        return f"({with_sigma(scale * value, scale * sigma)}) · 10{str(exponent).translate(_SUPERSCRIPT)}{space}"
    digits = max(0, 1 - math.floor(math.log10(sigma)))
    if round(sigma, digits) >= 10.0 ** (2 - digits):  # 0.0996 has two digits as 0.10
        digits -= 1
    return f"{value:.{max(digits, 0)}f} ± {sigma:.{max(digits, 0)}f}{space}"


def measured(quantity: MeasuredValue, unit: str = "") -> str:
    """A measured value with its standard uncertainty."""
    return with_sigma(quantity.value, quantity.sigma, unit)


def fixed(value: float, digits: int) -> str:
    """A number with fixed decimals, zero without sign."""
    return f"{round(value, digits) + 0.0:.{digits}f}"


def source(value: Sourced[object] | None) -> str:
    """Origin of a value."""
    return NOT_RECORDED if value is None else _SOURCES[value.source]


def utc_date(time_ns: int) -> str:
    """``26 November 2026`` in UTC, independent of the language of the computer."""
    months = ["January", "February", "March", "April", "May", "June", "July", "August", "September", "October", "November", "December"]
    day = datetime.fromtimestamp(time_ns // 1_000_000_000, UTC)
    return f"{day.day} {months[day.month - 1]} {day.year}"


def utc_time(time_ns: int) -> str:
    """``10:15`` in UTC."""
    return f"{datetime.fromtimestamp(time_ns // 1_000_000_000, UTC):%H:%M}"


def counted(number: int, noun: str) -> str:
    """A number with its noun, ``1 pair`` or ``2 pairs``."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def joined(words: Sequence[str]) -> str:
    """``a``, ``a and b`` or ``a, b and c``."""
    return " and ".join(part for part in (", ".join(words[:-1]), *words[-1:]) if part)


def seconds(time_s: float) -> str:
    """A time in the unit in which it has few digits."""
    for factor, unit in ((1e6, "µs"), (1e3, "ms")):
        if time_s * factor < 1000:
            return f"{time_s * factor:.4g} {unit}"
    return f"{time_s:.4g} s"
