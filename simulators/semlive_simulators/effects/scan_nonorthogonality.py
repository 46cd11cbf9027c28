"""Columns are not perpendicular to rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Array, Effect, Instants, Magnification, pick_by_magnification


@dataclass(frozen=True, slots=True)
class ScanNonorthogonality(Effect):
    """u = skew (y - yc).

    Attributes:
        skew_rad: 90 degrees minus the angle between the axes.
    """

    name: ClassVar[str] = "scan_nonorthogonality"

    skew_rad: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> ScanNonorthogonality:
        """0.01 rad, which is 4.4 px at the edge."""
        return cls(pick_by_magnification(magnification, 0.01, 0.01))

    def deflection(self, at: Instants) -> Array:
        """Constant in time."""
        return np.broadcast_to(np.array([[0.0, self.skew_rad], [0.0, 0.0]]), (at.time_s.size, 2, 2))
