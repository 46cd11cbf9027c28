"""Numbers that programs write in the place of a lost value: ``-9999``, ``999.999``, ``-32768``."""

from __future__ import annotations

MIN_SENTINEL = 99.0
_NINES = {(10**digits - 1) / 10**decimals: digits for digits in range(2, 7) for decimals in range(4)}
_LIMITS_OF_INTEGERS = (32767.0, 32768.0, 65535.0)
USUAL = (*sorted(value for value in _NINES if value >= MIN_SENTINEL), *_LIMITS_OF_INTEGERS)
"""Absolute values; 99 and more with nines only, and the ends of 16-bit integers."""
_LIMITS_OF_LONG_INTEGERS = (2147483647.0, 2147483648.0, 4294967295.0)
SINGLE_PRECISION = 1e-7
_MIN_DIGITS, _MIN_WHOLE = 6, 9999.0
"""A load may stay at 999.9 N or 999.99 N for some seconds with a coarse display; it does not at six nines."""


def is_no_reading(value: float) -> bool:
    """Whether a single number of an instrument marks a lost reading.

    It is one of nines only, -999 or less, 9999 or more, or with six nines, or the end of 16-bit or 32-bit integers.
    """
    size = abs(value)
    limits = (*_LIMITS_OF_INTEGERS, *_LIMITS_OF_LONG_INTEGERS)
    nines = next((number for number in _NINES if number >= MIN_SENTINEL and abs(size - number) <= SINGLE_PRECISION * number), 0.0)
    if nines:
        return nines >= _MIN_WHOLE or _NINES[nines] >= _MIN_DIGITS or value <= -10 * MIN_SENTINEL
    return any(abs(size - limit) <= 0.0 for limit in limits)
