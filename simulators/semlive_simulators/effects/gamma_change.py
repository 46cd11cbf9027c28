"""The operator or the microscope changes brightness or contrast."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Array, Effect, Magnification, PixelVisits, pick_by_magnification


@dataclass(frozen=True, slots=True)
class GammaChange(Effect):
    """I -> 255 a (I / 255)^g + b from an instant on.

    Attributes:
        gain: a.
        gamma: g.
        offset_levels: b.
        at_s: time of the change, seconds since the run began.
    """

    name: ClassVar[str] = "gamma_change"

    gain: float
    gamma: float
    offset_levels: float
    at_s: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> GammaChange:
        """A slightly lower contrast and brightness after ten minutes."""
        return cls(pick_by_magnification(magnification, 1.05, 1.05), 0.9, -8.0, 600.0)

    def grey(self, grey: Array, x_px: Array, y_px: Array, at: PixelVisits) -> Array:
        """Apply the changed response curve."""
        changed = 255.0 * self.gain * (np.maximum(grey, 0.0) / 255.0) ** self.gamma + self.offset_levels
        return np.where(at.time_s >= self.at_s, changed, grey)
