"""Grains of the metal have different grey levels by electron channelling."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from semlive_simulators.effects.interfaces import Array, Effect, Magnification, PixelVisits, pick_by_magnification
from semlive_simulators.kernels.grains import grain_grey


@dataclass(frozen=True, slots=True)
class GrainContrast(Effect):
    """Voronoi grains, stretched along y (the rolling direction), each with its own grey offset.

    Attributes:
        seed: seed of the grains.
        width_px: mean width of a grain.
        length_px: mean length along y.
        levels: largest offset, grey levels of 8 bit; offsets are uniform between plus and minus that.
        edge_px: half width of a grain boundary.
    """

    name: ClassVar[str] = "grain_contrast"

    seed: int
    width_px: float
    length_px: float
    levels: float
    edge_px: float = 1.0

    def __post_init__(self) -> None:
        if not (self.width_px > 0 and self.length_px > 0 and self.edge_px > 0):
            raise ValueError("width_px, length_px and edge_px must be above 0")

    @classmethod
    def defaults(cls, magnification: Magnification) -> GrainContrast:
        """Pancake grains of 0.15 x 0.6 mm; at x10,000 subgrains of 5 x 10 um."""
        return cls(1, pick_by_magnification(magnification, 120.0, 200.0), pick_by_magnification(magnification, 480.0, 400.0), 12.0)

    def grey(self, grey: Array, x_px: Array, y_px: Array, at: PixelVisits) -> Array:
        """Add the offset of each grain."""
        return grey + self.levels * grain_grey(x_px, y_px, self.seed, self.width_px, self.length_px, self.edge_px)
