"""Cross-talk between the scan amplifiers drifts with temperature."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Array, Effect, Instants, Magnification, exponential_approach, pick_by_magnification


@dataclass(frozen=True, slots=True)
class ScanShearDrift(Effect):
    """u = gamma(T) (y - yc), gamma = change (1 - exp(-T / tau)).

    Attributes:
        change: total shear.
        time_constant_s: tau.
    """

    name: ClassVar[str] = "scan_shear_drift"

    change: float
    time_constant_s: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> ScanShearDrift:
        """5e-5, which is 0.022 px at the edge."""
        return cls(pick_by_magnification(magnification, 5e-5, 5e-5), 3600.0)

    def deflection(self, at: Instants) -> Array:
        """A shear of the rows."""
        return exponential_approach(at.time_s, self.change, self.time_constant_s)[:, None, None] * np.array([[0.0, 1.0], [0.0, 0.0]])
