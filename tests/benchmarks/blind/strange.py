"""What is in nobody's dictionary."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Effect, PixelVisits, Plane


@dataclass(frozen=True, slots=True)
class Stranger(Effect):
    """Something without a name.

    Attributes:
        size_px: of it at its largest.
        seed: of place and phase.
    """

    name: ClassVar[str] = "stranger"

    size_px: float
    seed: int

    def drawn(self) -> np.random.Generator:
        """For place and phase."""
        return np.random.default_rng((self.seed, 91))


class MovingWave(Stranger):
    """A wave that runs over the columns: over rows it would be an oscillation in time."""

    name: ClassVar[str] = "moving_wave"

    def offset_px(self, at: PixelVisits) -> Plane:
        """Along x."""
        wave = self.size_px * np.sin(2.0 * np.pi * (at.x_px / 400.0 - at.time_s / 700.0) + self.drawn().uniform(0.0, 6.0))
        return wave, np.zeros_like(wave)


class CrossTalk(Stranger):
    """Columns are displaced in every other frame."""

    name: ClassVar[str] = "column_cross_talk"

    def offset_px(self, at: PixelVisits) -> Plane:
        """Along both axes."""
        size = self.size_px * (at.frame % 2)
        wave = size * np.sin(2.0 * np.pi * at.x_px / 300.0 + self.drawn().uniform(0.0, 6.0)) + 0.0 * at.y_px
        return wave, 0.5 * wave


class FieldOfEachPair(Stranger):
    """A smooth field of its own in every pair."""

    name: ClassVar[str] = "field_of_each_pair"

    def offset_px(self, at: PixelVisits) -> Plane:
        """A cubic in x and y."""
        rng = np.random.default_rng((self.seed, 92, at.frame // 2))
        x, y = at.from_centre_px
        x, y = x / 512.0, y / 442.0
        a, b = rng.uniform(-1.0, 1.0, (2, 3)) * self.size_px
        return a[0] * x * y + a[1] * (x * x - y * y) + a[2] * x * x * y, b[0] * x * y + b[1] * (x * x - y * y) + b[2] * x * y * y


class SlipBand(Stranger):
    """Half of the field slides over the other half, more with every frame, while nothing is loaded."""

    name: ClassVar[str] = "slip_band"

    def offset_px(self, at: PixelVisits) -> Plane:
        """Along a line through the field."""
        angle = self.drawn().uniform(0.3, 1.2)
        x, y = at.from_centre_px
        slid = 0.5 * self.size_px * np.tanh((x * np.cos(angle) + y * np.sin(angle)) / 60.0) * at.start_s / 6000.0
        return -np.sin(angle) * slid, np.cos(angle) * slid


class Spiral(Stranger):
    """A spiral distortion of third order that grows."""

    name: ClassVar[str] = "spiral_drift"

    def offset_px(self, at: PixelVisits) -> Plane:
        """Turned more outside than inside, without its rotation."""
        x, y = at.from_centre_px
        x, y = x / 512.0, y / 512.0
        turn = self.size_px * (x * x + y * y - 0.6) * at.start_s / 6000.0
        return -turn * y, turn * x


class QuadraticBump(Stranger):
    """A bump on the raster that grows with the square of time."""

    name: ClassVar[str] = "quadratic_bump"

    def offset_px(self, at: PixelVisits) -> Plane:
        """Along y alone."""
        rng = self.drawn()
        x, y = at.from_centre_px
        far = ((x - rng.uniform(-200.0, 200.0)) ** 2 + (y - rng.uniform(-150.0, 150.0)) ** 2) / 150.0**2
        bump = self.size_px * np.exp(-0.5 * far) * (at.start_s / 6000.0) ** 2
        return np.zeros_like(bump), bump


STRANGE: dict[str, type[Stranger]] = {one.name: one for one in (MovingWave, CrossTalk, FieldOfEachPair, SlipBand, Spiral, QuadraticBump)}
