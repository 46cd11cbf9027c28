"""Compliance of the fixtures, which the extension includes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from semlive_simulators.effects.interfaces import Effect, Magnification, pick_by_magnification


@dataclass(frozen=True, slots=True)
class LoadFrameCompliance(Effect):
    """d = F / k_s + F / k_f.

    Attributes:
        fixture_stiffness_n_mm: k_f.
    """

    name: ClassVar[str] = "load_frame_compliance"

    fixture_stiffness_n_mm: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> LoadFrameCompliance:
        """5000 N/mm, a third of that of the specimen."""
        return cls(pick_by_magnification(magnification, 5000.0, 5000.0))

    def extension_reading_mm(self, reading_mm: float, load_n: float) -> float:
        """Add the elongation of the fixtures."""
        return reading_mm + load_n / self.fixture_stiffness_n_mm
