"""A permanent jump within a frame, as by a slipping grip, an electrical breakdown or thermal stress."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from semlive_simulators.effects.interfaces import Effect, Magnification, PixelVisits, Plane, pick_by_magnification, step_function


@dataclass(frozen=True, slots=True)
class DriftJump(Effect):
    """(u, v) = J H(T - T_s).

    Attributes:
        x_px: J in x.
        y_px: J in y.
        at_s: T_s, seconds since the run began.
    """

    name: ClassVar[str] = "drift_jump"

    x_px: float
    y_px: float
    at_s: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> DriftJump:
        """0.5 or 5 px after ten minutes."""
        return cls(pick_by_magnification(magnification, 0.3, 3.0), pick_by_magnification(magnification, 0.5, 5.0), 600.0)

    def offset_px(self, at: PixelVisits) -> Plane:
        """A jump between two pixels."""
        step = step_function(at.time_s, self.at_s)
        return self.x_px * step, self.y_px * step
