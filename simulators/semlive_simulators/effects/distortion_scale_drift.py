"""Working distance or high voltage drift, and the distortion changes in proportion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from semlive_simulators.effects.interfaces import Effect, Magnification, PixelVisits, Plane, exponential_approach, pick_by_magnification


@dataclass(frozen=True, slots=True)
class DistortionScaleDrift(Effect):
    """(u, v) = eta(T) E(R), eta = change (1 - exp(-T / tau)).

    Attributes:
        change: total relative change of the distortion.
        time_constant_s: tau.
    """

    name: ClassVar[str] = "distortion_scale_drift"

    change: float
    time_constant_s: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> DistortionScaleDrift:
        """A tenth of the distortion."""
        return cls(pick_by_magnification(magnification, 0.1, 0.1), 3600.0)

    def offset_px(self, at: PixelVisits) -> Plane:
        """A fraction of the distortion."""
        eta = exponential_approach(at.time_s, self.change, self.time_constant_s)
        return eta * at.distortion_px[0], eta * at.distortion_px[1]
