"""Friction of guides: the load cell measures more than the load of the specimen during loading, and less during unloading."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from semlive_simulators.effects.interfaces import Effect, Magnification, pick_by_magnification
from semlive_simulators.specimen.specimen import Motion


@dataclass(frozen=True, slots=True)
class FrictionHysteresis(Effect):
    """F_m = F + f sign(dF), dF the last load step.

    Attributes:
        friction_n: f.
    """

    name: ClassVar[str] = "friction_hysteresis"

    friction_n: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> FrictionHysteresis:
        """15 N."""
        return cls(pick_by_magnification(magnification, 15.0, 15.0))

    def load_reading_n(self, reading_n: float, time_s: float, motion: Motion) -> float:
        """Add friction in the direction of the last load step."""
        changes_n = [step.change_n for step in motion.history.load_steps if step.time_s <= time_s and step.change_n != 0]
        return reading_n + (math.copysign(self.friction_n, changes_n[-1]) if changes_n else 0.0)
