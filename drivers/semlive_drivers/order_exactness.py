"""How far a value that a device takes may differ from the value that was meant: one rule for registers and for text."""

from __future__ import annotations

import math

from semlive.errors import LinkError

USUAL = 0.01
"""Largest relative difference of a force target, a rate or a fixed number: 1 %."""
TOLERANCES = {"speed": 0.1, "watchdog": 0.1}
"""The same for values that need less: a speed in displacement control follows from a stiffness that is known no better."""
ROUNDED_DOWN = ("speed", "travel")
"""Values that are rounded towards zero, never up: a motion is then slower or shorter than ordered, never faster or longer."""
_HINTS = {
    "speed": "; give approach: speed_min_mm_s",
    "travel": "; raise approach: arrived_n or ahead_s",
    "rate": "; order a higher rate, or correct the scale",
}


def quantity_of(name: str) -> str:
    """Kind of a value by its name in an order: ``-speed_mm_s`` is a ``speed``; a number is ``constant``."""
    word = name.removeprefix("-").partition("_")[0]
    return word if word in ("force", "rate", "travel", "speed", "watchdog", "to", "nonce", "station") else "constant"


def is_rounded_down(name: str) -> bool:
    """Whether a value of this name is rounded towards zero."""
    return quantity_of(name) in ROUNDED_DOWN


def towards_zero(counts: float) -> int:
    """Whole counts of a value, towards zero; a value that is a whole number but for rounding errors stays that number."""
    nearest = round(counts)
    return nearest if math.isclose(counts, nearest, rel_tol=1e-6) else math.trunc(counts)


def require_exact(name: str, meant: float, taken: float, place: str, unit: str = "") -> None:
    """Refuse a value that the device would not take as it was meant.

    A nonzero value must not become 0. Force targets, rates and fixed numbers must be met within 1 %; a watchdog time within 10 %. A
    travel, and a speed of a motion under way, may come out smaller: they are rounded towards zero.

    Args:
        name: of the value in the order.
        meant: the value in the order's unit.
        taken: the value that the number format leaves, in the same unit.
        place: where it is written, for the error.
        unit: for the error.

    Raises:
        LinkError: if it is refused.
    """
    quantity = quantity_of(name)
    if quantity in ("nonce", "to", "station") or meant == taken:
        return
    said = f"{meant:g}{unit and ' '}{unit}"
    if taken == 0:
        raise LinkError(f"{said} is less than one count of {place}{_HINTS.get(quantity, '; correct the value or the scale')}")
    if quantity not in ROUNDED_DOWN and abs(taken - meant) > TOLERANCES.get(quantity, USUAL) * abs(meant):
        raise LinkError(f"{said} would be sent to {place} as {taken:g}; order a value that the device can hold, or correct the scale")


UNITS = {"force": "N", "rate": "N/s", "travel": "mm", "speed": "mm/s", "watchdog": "s", "to": "mm"}
"""Units of quantities in orders."""


def unit_of(name: str) -> str:
    """Unit of a value by its name; nothing for bare numbers."""
    if name.endswith("_min"):
        return {"rate": "N/min", "speed": "mm/min"}.get(quantity_of(name), "")
    return UNITS.get(quantity_of(name), "")
