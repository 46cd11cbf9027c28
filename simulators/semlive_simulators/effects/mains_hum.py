"""Stray magnetic field of the mains, about 17 nm for 0.1 uT at 30 kV and 14 mm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Effect, Magnification, PixelVisits, Plane, pick_by_magnification


@dataclass(frozen=True, slots=True)
class MainsHum(Effect):
    """(u, v) = A sum_n a_n sin(n (2 pi f T + phase)), T the time since the run began: its phase at a frame start is practically random.

    Attributes:
        amplitude_x_px: A in x.
        amplitude_y_px: A in y.
        frequency_hz: frequency of the mains.
        phase_rad: phase at the start of the run.
        harmonics: (n, a_n) of each overtone, a_n as a fraction of A; a_1 is 1.
    """

    name: ClassVar[str] = "mains_hum"

    amplitude_x_px: float
    amplitude_y_px: float
    frequency_hz: float
    phase_rad: float
    harmonics: tuple[tuple[int, float], ...] = ()

    @classmethod
    def defaults(cls, magnification: Magnification) -> MainsHum:
        """0.02 or 0.5 px at 50 Hz."""
        return cls(pick_by_magnification(magnification, 0.02, 0.5), pick_by_magnification(magnification, 0.01, 0.25), 50.0, 0.4)

    def offset_px(self, at: PixelVisits) -> Plane:
        """Equal waves in both axes."""
        angle = 2 * np.pi * self.frequency_hz * at.time_s + self.phase_rad
        wave = np.sin(angle)
        for order, fraction in self.harmonics:
            wave = wave + fraction * np.sin(order * angle)
        return self.amplitude_x_px * wave, self.amplitude_y_px * wave
