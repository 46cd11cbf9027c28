"""The microscope's clock differs from the load frame's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from semlive_simulators.effects.interfaces import Effect, Magnification, pick_by_magnification


@dataclass(frozen=True, slots=True)
class TimestampOffset(Effect):
    """The files say T + dt.

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
        """Later by the offset."""
        return true_s + self.offset_s
