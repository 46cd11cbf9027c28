"""Speckle patterns: lithographic gold dots, or a gold film rearranged into islands."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict

from semlive_simulators.kernels.exposure import DOTS, FILM


@dataclass(frozen=True, slots=True)
class Speckle:
    """Lithographic dots on an infinite plane, at most one in each square cell.

    Attributes:
        seed: seed of the pattern.
        pitch_px: edge of a cell; at least radius_px * (1 + radius_spread) + edge_px, so that a dot ends within the adjacent cells.
        radius_px: mean radius of a dot.
        radius_spread: half range of the radius as a fraction of it.
        presence: probability of a dot in a cell.
        edge_px: half width of the soft edge of a dot.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    seed: int
    pitch_px: float
    radius_px: float
    radius_spread: float
    presence: float
    edge_px: float

    def __post_init__(self) -> None:
        extent_px = self.radius_px * (1 + self.radius_spread) + self.edge_px
        if extent_px > self.pitch_px:
            raise ValueError(f"dots reach {extent_px:.2f} px, further than their pitch_px of {self.pitch_px}")

    @property
    def kind(self) -> int:
        """Code of the pattern in the kernels."""
        return DOTS

    @property
    def numbers(self) -> NDArray[np.float64]:
        """(5,) parameters of the kernels: pitch_px, radius_px, radius_spread, presence, edge_px."""
        return np.array([self.pitch_px, self.radius_px, self.radius_spread, self.presence, self.edge_px])

    def with_sharper_edges(self, factor: float) -> Speckle:
        """The dots with edges `factor` times as wide."""
        return Speckle(self.seed, self.pitch_px, self.radius_px, self.radius_spread, self.presence, factor * self.edge_px)


@dataclass(frozen=True, slots=True)
class GoldFilm:
    """A thin gold film rearranged into irregular islands on an infinite plane.

    Attributes:
        seed: seed of the pattern.
        grain_px: correlation length of the film thickness; islands are about as wide, and of any length.
        gold_fraction: fraction of the surface with gold, 0.05 to 0.95.
        softness: half width of the edge of an island, in standard deviations of the thickness.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    seed: int
    grain_px: float = 9.0
    gold_fraction: float = 0.45
    softness: float = 0.6

    def __post_init__(self) -> None:
        if not self.grain_px > 0 or not self.softness > 0:
            raise ValueError(f"grain_px and softness must be above 0, not {self.grain_px} and {self.softness}")
        if not 0.05 <= self.gold_fraction <= 0.95:
            raise ValueError(f"gold_fraction must be 0.05 to 0.95, not {self.gold_fraction}")

    @property
    def kind(self) -> int:
        """Code of the pattern in the kernels."""
        return FILM

    @property
    def level(self) -> float:
        """Smallest thickness that counts as gold, in standard deviations."""
        return NormalDist().inv_cdf(1.0 - self.gold_fraction)

    @property
    def numbers(self) -> NDArray[np.float64]:
        """(5,) parameters of the kernels: grain_px, level, softness, and two that are not used."""
        return np.array([self.grain_px, self.level, self.softness, 0.0, 0.0])

    def with_sharper_edges(self, factor: float) -> GoldFilm:
        """The film with edges `factor` times as wide."""
        return GoldFilm(self.seed, self.grain_px, self.gold_fraction, factor * self.softness)


Pattern: TypeAlias = Speckle | GoldFilm
"""A pattern; its keys in a scenario determine the kind."""
