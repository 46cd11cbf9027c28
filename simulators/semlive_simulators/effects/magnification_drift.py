"""High voltage (dM/M = dV/2V), lens current or working distance drift (dM/M = dz/WD: 1 um is 7e-5)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from semlive_simulators.effects.interfaces import (
    Array,
    Effect,
    Instants,
    Magnification,
    exponential_approach,
    isotropic,
    pick_by_magnification,
)


@dataclass(frozen=True, slots=True)
class MagnificationDrift(Effect):
    """(u, v) = s(T) (x - xc, y - yc), s = change (1 - exp(-T / tau)).

    Attributes:
        change: total relative change.
        time_constant_s: tau.
    """

    name: ClassVar[str] = "magnification_drift"

    change: float
    time_constant_s: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> MagnificationDrift:
        """3e-4, which is 0.15 px at the edge."""
        return cls(pick_by_magnification(magnification, 3e-4, 3e-4), 3600.0)

    def deflection(self, at: Instants) -> Array:
        """An isotropic change."""
        return isotropic(exponential_approach(at.time_s, self.change, self.time_constant_s))
