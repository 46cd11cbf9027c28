"""Readings that the operator takes from the device's own panel, with the tolerance that their digits state. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation

from semlive.errors import BadConfig

OPTIONS = {"force_reads": "--force-reads", "extension_reads": "--extension-reads"}
"""Options of `semlive frame check`, by their key in the settings."""
_MIN_COUNTS = 20
"""A reading of fewer units of its last digit shows neither scale nor number format."""

_ROUNDED = 0.5000001
"""Units of the last digit by which rounding makes a reading larger than its value at most, with the error of binary numbers."""


@dataclass(frozen=True, slots=True)
class PanelReading:
    """A reading of the device's panel.

    Attributes:
        value: in N or mm.
        tolerance: one unit of the last digit, in N or mm.
    """

    value: float
    tolerance: float

    @property
    def proves(self) -> bool:
        """Whether it is large enough to prove scale and number format."""
        return abs(self.value) >= _MIN_COUNTS * self.tolerance

    def agrees(self, value: float, spread: float) -> bool:
        """Whether the panel may show this reading at a value: it rounds to the nearest digit, or cuts off the digits beyond.

        Args:
            value: of the device, in the unit of the reading.
            spread: how far the value may be from that at the time of the reading, in the same unit.
        """
        smaller = self.value and abs(value) < abs(self.value)
        return abs(value - self.value) <= self.tolerance * (_ROUNDED if smaller else 1.0) + spread

    def in_unit(self, factor: float) -> PanelReading:
        """The reading in another unit.

        Args:
            factor: N or mm of one unit.
        """
        return PanelReading(self.value / factor, self.tolerance / factor)


def parse_reading(text: str, option: str) -> PanelReading:
    """A reading from its digits: ``123.456`` has a tolerance of 0.001, ``120`` one of 1.

    Raises:
        BadConfig: if the text is no finite decimal number.
    """
    try:
        number = Decimal(text.strip())
    except InvalidOperation:
        number = Decimal("nan")
    if not number.is_finite():
        raise BadConfig(f"{option} is {text!r}; give the digits of the device's panel with a decimal point, for example 123.456")
    exponent = number.as_tuple().exponent
    return PanelReading(float(number), 10.0 ** min(0, int(exponent)))


def panel_readings(settings: Mapping[str, object]) -> tuple[dict[str, PanelReading], dict[str, object]]:
    """Readings of the panel in settings, by their key in `OPTIONS`, and the other settings.

    Raises:
        BadConfig: for a reading that is no number.
    """
    panel = {key: parse_reading(str(settings[key]), option) for key, option in OPTIONS.items() if settings.get(key) is not None}
    return panel, {key: value for key, value in settings.items() if key not in OPTIONS}
