"""The grips are not aligned: the load also shears and rotates the specimen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Array, Effect, Instants, Magnification, pick_by_magnification


@dataclass(frozen=True, slots=True)
class InplaneMisalignment(Effect):
    """u = (s - r) F (y - yc), v = (s + r) F (x - xc).

    Attributes:
        shear_per_n: s, tensor shear strain.
        rotation_rad_per_n: r.
    """

    name: ClassVar[str] = "inplane_misalignment"

    shear_per_n: float
    rotation_rad_per_n: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> InplaneMisalignment:
        """A shear of 1e-4 and a rotation of 2e-4 at 2200 N."""
        return cls(pick_by_magnification(magnification, 5e-8, 5e-8), pick_by_magnification(magnification, 1e-7, 1e-7))

    def specimen_shift_px(self, at: Instants) -> Array:
        """Zero: the centre does not move."""
        return np.zeros((at.time_s.size, 2))

    def specimen_gradient(self, at: Instants) -> Array:
        """Shear and rotation in proportion to the load."""
        load_n = at.motion.load_at(at.time_s)[:, None, None]
        shear, rotation = self.shear_per_n, self.rotation_rad_per_n
        return load_n * np.array([[0.0, shear - rotation], [shear + rotation, 0.0]])
