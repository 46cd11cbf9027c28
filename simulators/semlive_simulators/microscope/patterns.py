"""What the specimen is covered with: gold dots by lithography, or a gold film that has gathered into islands."""

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
    """Lithographic dots on an infinite plane, one at most in each square cell.

    Attributes:
        seed: which pattern.
        pitch_px: edge of a cell; at least radius_px * (1 + radius_spread) + edge_px, so that no dot reaches beyond its neighbours.
        radius_px: mean radius of a dot.
        radius_spread: half range of the radius as a fraction of it.
        presence: probability that a cell holds a dot.
        edge_px: half width of a dot's soft edge.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    seed: int
    pitch_px: float
    radius_px: float
    radius_spread: float
    presence: float
    edge_px: float

    def __post_init__(self) -> None:
        reach = self.radius_px * (1 + self.radius_spread) + self.edge_px
        if reach > self.pitch_px:
            raise ValueError(f"dots reach {reach:.2f} px, further than their pitch_px of {self.pitch_px}")

    @property
    def kind(self) -> int:
        """Which branch of the kernels draws it."""
        return DOTS

    @property
    def numbers(self) -> NDArray[np.float64]:
        """(5,) what the kernels need to know: pitch_px, radius_px, radius_spread, presence, edge_px."""
        return np.array([self.pitch_px, self.radius_px, self.radius_spread, self.presence, self.edge_px])

    def with_sharper_edges(self, factor: float) -> Speckle:
        """The same dots with edges `factor` times as wide."""
        return Speckle(self.seed, self.pitch_px, self.radius_px, self.radius_spread, self.presence, factor * self.edge_px)


@dataclass(frozen=True, slots=True)
class GoldFilm:
    """A thin gold film rearranged into irregular islands on an infinite plane.

    Attributes:
        seed: which pattern.
        grain_px: distance over which the film's thickness changes; islands are about as wide, and of all lengths.
        gold_fraction: part of the surface on which the film is thick enough to be bright, 0.05 to 0.95.
        softness: half width of an island's edge, in standard deviations of the thickness.
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
        """Which branch of the kernels draws it."""
        return FILM

    @property
    def level(self) -> float:
        """Thickness at which it begins to be gold, in standard deviations."""
        return NormalDist().inv_cdf(1.0 - self.gold_fraction)

    @property
    def numbers(self) -> NDArray[np.float64]:
        """(5,) what the kernels need to know: grain_px, level, softness, and two that are not used."""
        return np.array([self.grain_px, self.level, self.softness, 0.0, 0.0])

    def with_sharper_edges(self, factor: float) -> GoldFilm:
        """The same film with edges `factor` times as wide."""
        return GoldFilm(self.seed, self.grain_px, self.gold_fraction, factor * self.softness)


Pattern: TypeAlias = Speckle | GoldFilm
"""Either; in a scenario the keys tell which."""
