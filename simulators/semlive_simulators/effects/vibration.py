"""Vibration by floor, pumps, chiller or sound: one frequency, with a random phase in each frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Effect, Magnification, PixelVisits, Plane, pick_by_magnification
from semlive_simulators.kernels.pattern import gaussian


@dataclass(frozen=True, slots=True)
class Vibration(Effect):
    """(u, v) = A sin(2 pi (f tau + phase of the frame)), tau the time in the frame, the phase a normally distributed number of turns.

    Attributes:
        amplitude_x_px: A in x.
        amplitude_y_px: A in y.
        frequency_hz: frequency, 0.1 to 200 Hz.
        seed: seed of the phases.
    """

    name: ClassVar[str] = "vibration"

    amplitude_x_px: float
    amplitude_y_px: float
    frequency_hz: float
    seed: int = 1

    @classmethod
    def defaults(cls, magnification: Magnification) -> Vibration:
        """0.01 or 0.3 px at 23.7 Hz."""
        return cls(pick_by_magnification(magnification, 0.01, 0.3), pick_by_magnification(magnification, 0.01, 0.2), 23.7)

    def offset_px(self, at: PixelVisits) -> Plane:
        """Equal waves in both axes."""
        wave = np.sin(2 * np.pi * (self.frequency_hz * at.in_frame_s + gaussian(self.seed, 4, at.frame)))
        return self.amplitude_x_px * wave, self.amplitude_y_px * wave
