"""The specimen charges during each frame, more with the total scan time; the image becomes brighter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Array, Effect, Magnification, PixelVisits, Plane, pick_by_magnification


@dataclass(frozen=True, slots=True)
class ChargingFrameRamp(Effect):
    """(u, v) = A_f (1 - exp(-tau / tau_c)), A_f = A (1 - exp(-T_f / T_d)), tau time in the frame, T_f its start; grey likewise.

    Attributes:
        x_px: A in x.
        y_px: A in y.
        brightness_levels: A of the grey level.
        charging_s: tau_c.
        dose_s: T_d.
    """

    name: ClassVar[str] = "charging_frame_ramp"

    x_px: float
    y_px: float
    brightness_levels: float
    charging_s: float
    dose_s: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> ChargingFrameRamp:
        """0.3 or 2 px, 5 grey levels."""
        return cls(pick_by_magnification(magnification, 0.15, 1.0), pick_by_magnification(magnification, 0.3, 2.0), 5.0, 20.0, 1800.0)

    def _charge(self, at: PixelVisits) -> Array:
        return np.expm1(-at.in_frame_s / self.charging_s) * np.expm1(-at.start_s / self.dose_s)

    def offset_px(self, at: PixelVisits) -> Plane:
        """The electric field deflects the beam."""
        charge = self._charge(at)
        return self.x_px * charge, self.y_px * charge

    def grey(self, grey: Array, x_px: Array, y_px: Array, at: PixelVisits) -> Array:
        """The electric field directs electrons to the detector."""
        return grey + self.brightness_levels * self._charge(at)
