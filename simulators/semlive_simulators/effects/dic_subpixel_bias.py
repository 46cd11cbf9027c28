"""Dots or islands with edges sharper than a pixel: interpolation has a periodic error over the fraction of a pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from semlive_simulators.effects.interfaces import Effect, Magnification, pick_by_magnification
from semlive_simulators.microscope.patterns import Pattern


@dataclass(frozen=True, slots=True)
class DicSubpixelBias(Effect):
    """The half width of the edges is multiplied by a factor. Nothing moves: any displacement in the result is a bias of correlation.

    Attributes:
        edge_factor: the factor, at most 1.
    """

    name: ClassVar[str] = "dic_subpixel_bias"

    edge_factor: float

    def __post_init__(self) -> None:
        if not 0 < self.edge_factor <= 1:
            raise ValueError(f"edge_factor must be above 0 and at most 1, not {self.edge_factor}")

    @classmethod
    def defaults(cls, magnification: Magnification) -> DicSubpixelBias:
        """A sixth of the width: edges of less than a pixel."""
        return cls(pick_by_magnification(magnification, 0.16, 0.16))

    def changed(self, speckle: Pattern) -> Pattern:
        """The pattern with sharper edges."""
        return speckle.with_sharper_edges(self.edge_factor)
