"""The specimen moves towards the lens with the load, by the grips and the contraction of the sheet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from semlive_simulators.effects.interfaces import Array, Effect, Instants, Magnification, isotropic, pick_by_magnification


@dataclass(frozen=True, slots=True)
class OutOfPlaneTranslation(Effect):
    """(u, v) = F lift / WD (x - xc, y - yc).

    Attributes:
        lift_um_per_n: motion towards the lens.
        working_distance_mm: WD.
    """

    name: ClassVar[str] = "out_of_plane_translation"

    lift_um_per_n: float
    working_distance_mm: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> OutOfPlaneTranslation:
        """4.4 um at 2200 N, which is 0.16 px at the edge."""
        return cls(pick_by_magnification(magnification, 0.002, 0.002), 14.1)

    def deflection(self, at: Instants) -> Array:
        """An isotropic change in proportion to the load."""
        load_n = at.motion.load_at(at.time_s)
        return isotropic(load_n * self.lift_um_per_n / (1e3 * self.working_distance_mm))
