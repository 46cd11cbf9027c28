"""The position error of the stage grows with the square of its position."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Array, Effect, Instants, Magnification, pick_by_magnification


@dataclass(frozen=True, slots=True)
class StageQuadratic(Effect):
    """m = c + q c^2 in each axis, c the commanded position.

    Attributes:
        quadratic_per_um: q.
    """

    name: ClassVar[str] = "stage_quadratic"

    quadratic_per_um: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> StageQuadratic:
        """0.5 px at 40 um, or 12 px at 1 um."""
        return cls(pick_by_magnification(magnification, 4e-4, 0.3))

    def specimen_shift_px(self, at: Instants) -> Array:
        """The error at the end of the last move."""
        position_px = np.zeros((at.time_s.size, 2))
        for move in at.motion.history.moves:
            position_px = np.where((at.time_s >= move.time_s)[:, None], np.array(move.to_px), position_px)
        return self.quadratic_per_um * at.scan.pixel_size_um * position_px**2

    def specimen_gradient(self, at: Instants) -> Array:
        """Zero: the stage does not strain the specimen."""
        return np.zeros((at.time_s.size, 2, 2))
