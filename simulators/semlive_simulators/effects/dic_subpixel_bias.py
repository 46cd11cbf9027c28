"""Dots with edges too sharp for the pixels: interpolating between them is wrong by a wave over the fraction of a pixel."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from semlive_simulators.effects.protocol import Effect, Magnification, by
from semlive_simulators.specimen import Speckle


@dataclass(frozen=True, slots=True)
class DicSubpixelBias(Effect):
    """The half width of the dots' edges is multiplied. Nothing moves: whatever correlation sees of it is its own bias.

    Attributes:
        edge_factor: at most 1.
    """

    name: ClassVar[str] = "dic_subpixel_bias"

    edge_factor: float

    def __post_init__(self) -> None:
        if not 0 < self.edge_factor <= 1:
            raise ValueError(f"edge_factor must be above 0 and at most 1, not {self.edge_factor}")

    @classmethod
    def defaults(cls, magnification: Magnification) -> DicSubpixelBias:
        """A sixth of the width: edges of less than a pixel."""
        return cls(by(magnification, 0.16, 0.16))

    def changed(self, speckle: Speckle) -> Speckle:
        """Sharper."""
        return replace(speckle, edge_px=self.edge_factor * speckle.edge_px)
