"""Largest difference between an ordered value and the value that the number format of a device holds, for registers and for text."""

from __future__ import annotations

import math

from semlive.errors import LinkError

DEFAULT_TOLERANCE = 0.01
"""Largest relative difference of a force target, a rate or a fixed number: 1 %."""
TOLERANCES = {"speed": 0.1, "watchdog": 0.1}
"""Larger tolerances: a speed in displacement control follows from a stiffness that is not known more accurately."""
ROUNDED_DOWN = ("speed", "travel")
"""Values that are rounded towards zero: a motion is then slower or shorter than ordered, never faster or longer."""
_HINTS = {
    "speed": "; give approach: speed_min_mm_s",
    "travel": "; raise approach: arrived_n or ahead_s",
    "rate": "; order a higher rate, or correct the scale",
}


def quantity_of(name: str) -> str:
    """Kind of a value by its name in an order: ``-speed_mm_s`` is a ``speed``; a number is ``constant``."""
    quantity = name.removeprefix("-").partition("_")[0]
    return quantity if quantity in ("force", "rate", "travel", "speed", "watchdog", "to", "nonce", "station") else "constant"


def is_rounded_down(name: str) -> bool:
    """Whether a value of this name is rounded towards zero."""
    return quantity_of(name) in ROUNDED_DOWN


def towards_zero(counts: float) -> int:
    """Integer counts of a value, rounded towards zero; a value within rounding errors of an integer becomes that integer."""
    nearest = round(counts)
    return nearest if math.isclose(counts, nearest, rel_tol=1e-6) else math.trunc(counts)


def require_exact(name: str, ordered: float, stored: float, place: str, unit: str = "") -> None:
    """Refuse a value that the number format of the device changes too much.

    A nonzero value must not become 0. Force targets, rates and fixed numbers must agree within 1 %, a watchdog time within 10 %. A travel
    and a speed may become smaller: they are rounded towards zero.

    Args:
        name: name of the value in the order.
        ordered: the value in the unit of the order.
        stored: the value in the number format of the device, in the same unit.
        place: register or request in the error.
        unit: unit in the error.

    Raises:
        LinkError: if the value is refused.
    """
    quantity = quantity_of(name)
    if quantity in ("nonce", "to", "station") or ordered == stored:
        return
    value = f"{ordered:g}{unit and ' '}{unit}"
    if stored == 0:
        raise LinkError(f"{value} is less than one count of {place}{_HINTS.get(quantity, '; correct the value or the scale')}")
    if quantity not in ROUNDED_DOWN and abs(stored - ordered) > TOLERANCES.get(quantity, DEFAULT_TOLERANCE) * abs(ordered):
        raise LinkError(f"{value} would be sent to {place} as {stored:g}; order a value that the device can hold, or correct the scale")


UNITS = {"force": "N", "rate": "N/s", "travel": "mm", "speed": "mm/s", "watchdog": "s", "to": "mm"}
"""Units of quantities in orders."""


def unit_of(name: str) -> str:
    """Unit of a value by its name; empty for plain numbers."""
    if name.endswith("_min"):
        return {"rate": "N/min", "speed": "mm/min"}.get(quantity_of(name), "")
    return UNITS.get(quantity_of(name), "")
