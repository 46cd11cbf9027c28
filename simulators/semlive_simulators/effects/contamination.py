"""Carbon is deposited by the beam: less brightness and contrast inside the scanned box."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Array, Effect, Magnification, PixelVisits, pick_by_magnification


@dataclass(frozen=True, slots=True)
class Contamination(Effect):
    """I *= 1 - c T inside the box around the centre of the field, never below a fifth.

    Attributes:
        loss_per_s: c.
        box_width_px: width of the box on the specimen.
        box_height_px: height of the box.
    """

    name: ClassVar[str] = "contamination"

    loss_per_s: float
    box_width_px: float
    box_height_px: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> Contamination:
        """14 or 36 % in two hours, in a box a little smaller than the frame."""
        return cls(pick_by_magnification(magnification, 2e-5, 5e-5), 1000.0, 860.0)

    def grey(self, grey: Array, x_px: Array, y_px: Array, at: PixelVisits) -> Array:
        """Reduce the grey levels inside the box."""
        centre = at.scan.centre_px
        inside = (np.abs(x_px - centre[0]) <= 0.5 * self.box_width_px) & (np.abs(y_px - centre[1]) <= 0.5 * self.box_height_px)
        return grey * np.where(inside, np.maximum(0.2, 1 - self.loss_per_s * at.time_s), 1.0)
