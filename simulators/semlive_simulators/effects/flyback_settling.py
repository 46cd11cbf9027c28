"""The beam settles at the start of each row: inductance of the coils, slew rate of the amplifier, eddy currents."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Effect, Magnification, PixelVisits, Plane, pick_by_magnification


@dataclass(frozen=True, slots=True)
class FlybackSettling(Effect):
    """u = A exp(-x t_D / tau).

    Attributes:
        amplitude_px: A.
        settling_s: tau.
    """

    name: ClassVar[str] = "flyback_settling"

    amplitude_px: float
    settling_s: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> FlybackSettling:
        """0.5 px over 5 columns of 100 us, or 3 px over 40 columns of 5 us."""
        return cls(pick_by_magnification(magnification, 0.5, 3.0), pick_by_magnification(magnification, 5e-4, 2e-4))

    def offset_px(self, at: PixelVisits) -> Plane:
        """An exponential decay from the left edge."""
        return self.amplitude_px * np.exp(-at.x_px * at.scan.dwell_time_s / self.settling_s), np.zeros((1, 1))
