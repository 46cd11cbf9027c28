"""The end position of the stage depends on the direction of the move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Array, Effect, Instants, Magnification, pick_by_magnification


@dataclass(frozen=True, slots=True)
class StageBacklash(Effect):
    """m = c + b sign(dc) in each axis, dc the last move that was not zero.

    Attributes:
        backlash_um: b, half the total backlash.
    """

    name: ClassVar[str] = "stage_backlash"

    backlash_um: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> StageBacklash:
        """1 um: 0.8 or 40 px."""
        return cls(pick_by_magnification(magnification, 1.0, 1.0))

    def specimen_shift_px(self, at: Instants) -> Array:
        """An offset with the sign of the last motion."""
        sign = np.zeros((at.time_s.size, 2))
        for move in at.motion.history.moves:
            change = np.array(move.change_px)
            sign = np.where((at.time_s >= move.time_s)[:, None] & (change != 0), np.sign(change), sign)
        return sign * self.backlash_um / at.scan.pixel_size_um

    def specimen_gradient(self, at: Instants) -> Array:
        """Zero: the stage does not strain the specimen."""
        return np.zeros((at.time_s.size, 2, 2))
