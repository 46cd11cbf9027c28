"""The beam settles at the start of a scan: frame fly-back, relaxation of coils and lens."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Effect, Magnification, PixelVisits, Plane, pick_by_magnification


@dataclass(frozen=True, slots=True)
class FrameStartSettling(Effect):
    """(u, v) = A exp(-y t_R / tau).

    Attributes:
        amplitude_x_px: A in x.
        amplitude_y_px: A in y.
        settling_s: tau.
    """

    name: ClassVar[str] = "frame_start_settling"

    amplitude_x_px: float
    amplitude_y_px: float
    settling_s: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> FrameStartSettling:
        """0.3 or 2 px for 5 or 0.5 s."""
        return cls(
            pick_by_magnification(magnification, 0.15, 1.0),
            pick_by_magnification(magnification, 0.3, 2.0),
            pick_by_magnification(magnification, 5.0, 0.5),
        )

    def offset_px(self, at: PixelVisits) -> Plane:
        """An exponential decay from the upper edge."""
        decay = np.exp(-at.y_px * at.scan.row_time_s / self.settling_s)
        return self.amplitude_x_px * decay, self.amplitude_y_px * decay
