"""Mains hum with rows triggered by the mains: equal in every row, a static pattern of columns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Effect, Magnification, PixelVisits, Plane, pick_by_magnification


@dataclass(frozen=True, slots=True)
class LineSyncHum(Effect):
    """u = A sin(2 pi f x t_D).

    Attributes:
        amplitude_px: A.
        frequency_hz: frequency of the mains.
    """

    name: ClassVar[str] = "line_sync_hum"

    amplitude_px: float
    frequency_hz: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> LineSyncHum:
        """0.02 or 0.5 px at 50 Hz."""
        return cls(pick_by_magnification(magnification, 0.02, 0.5), 50.0)

    def offset_px(self, at: PixelVisits) -> Plane:
        """A wave along x."""
        wave = np.sin(2 * np.pi * self.frequency_hz * at.x_px * at.scan.dwell_time_s)
        return self.amplitude_px * wave, np.zeros((1, 1))
