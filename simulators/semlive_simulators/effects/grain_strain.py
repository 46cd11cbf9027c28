"""Grains yield differently: strain varies from grain to grain about its mean. This is a quantity to measure, not an error."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from semlive_simulators.effects.interfaces import Array, Effect, Magnification, PixelVisits, Plane, pick_by_magnification
from semlive_simulators.kernels.grains import smooth_field


@dataclass(frozen=True, slots=True)
class GrainStrain(Effect):
    """A smooth random displacement (v, -v' / 2) F s L / k; its strain along y has the standard deviation s F.

    v and v' are sums of bumps (1 - r^2 / L^2)^4 of random position and sign, standard deviation 1; their slopes have the standard
    deviation k / L, k = sqrt(36 / 7).

    Attributes:
        seed: seed of the grains.
        grain_px: L, approximately the size of a grain.
        strain_sd_per_n: s.
    """

    name: ClassVar[str] = "grain_strain"

    seed: int
    grain_px: float
    strain_sd_per_n: float

    def __post_init__(self) -> None:
        if not self.grain_px > 0:
            raise ValueError(f"grain_px must be above 0, not {self.grain_px}")

    @classmethod
    def defaults(cls, magnification: Magnification) -> GrainStrain:
        """A seventh of the mean elastic strain, 4.4e-4 at 2200 N."""
        return cls(2, pick_by_magnification(magnification, 160.0, 250.0), 2e-7)

    def material_px(self, x_px: Array, y_px: Array, at: PixelVisits) -> Plane:
        """Independent fields along and across the load."""
        size_px = self.strain_sd_per_n * at.load_n * self.grain_px / math.sqrt(36.0 / 7.0)
        return (
            -0.5 * size_px * smooth_field(x_px, y_px, 2 * self.seed, self.grain_px),
            size_px * smooth_field(x_px, y_px, 2 * self.seed + 1, self.grain_px),
        )
