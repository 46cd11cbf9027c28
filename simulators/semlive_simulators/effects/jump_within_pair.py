"""A jump between two frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Effect, Magnification, PixelVisits, Plane, pick_by_magnification


@dataclass(frozen=True, slots=True)
class JumpWithinPair(Effect):
    """(u, v) = J in a frame and all later ones.

    Attributes:
        x_px: J in x.
        y_px: J in y.
        first_frame: number of the first frame after the jump.
    """

    name: ClassVar[str] = "jump_within_pair"

    x_px: float
    y_px: float
    first_frame: int

    @classmethod
    def defaults(cls, magnification: Magnification) -> JumpWithinPair:
        """0.5 or 5 px before the sixth frame."""
        return cls(pick_by_magnification(magnification, 0.3, 3.0), pick_by_magnification(magnification, 0.5, 5.0), 5)

    def offset_px(self, at: PixelVisits) -> Plane:
        """Equal at all pixels."""
        jumped = np.full((1, 1), 1.0 if at.frame >= self.first_frame else 0.0)
        return self.x_px * jumped, self.y_px * jumped
