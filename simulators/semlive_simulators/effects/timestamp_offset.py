"""The clock of the microscope differs from that of the load frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from semlive_simulators.effects.interfaces import Effect, Magnification, pick_by_magnification


@dataclass(frozen=True, slots=True)
class TimestampOffset(Effect):
    """The time in the files is T + dt.

    Attributes:
        offset_s: dt.
    """

    name: ClassVar[str] = "timestamp_offset"

    offset_s: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> TimestampOffset:
        """5 s."""
        return cls(pick_by_magnification(magnification, 5.0, 5.0))

    def stamp_s(self, true_s: float) -> float:
        """Add the offset."""
        return true_s + self.offset_s
