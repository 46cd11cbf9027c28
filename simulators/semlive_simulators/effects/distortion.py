"""Spatial distortion of the raster, equal in all frames (Sutton 2007: a cosine wave plus a quadratic surface).

A second wave, and the settling of the beam at the start of a line and of a frame, give fields like those of an SEM.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import ConfigDict


@dataclass(frozen=True, slots=True)
class AxisDistortion:
    """One component over X, Y, which run from -1 to 1 across the frame.

    Attributes:
        constant_px: constant offset.
        xx_px: coefficient of X squared.
        xy_px: coefficient of X Y.
        yy_px: coefficient of Y squared.
        wave_px: amplitude of the wave.
        wave_x: periods of the wave across the width of the frame.
        wave_y: periods of the wave across the height of the frame.
        wave_phase_rad: phase of the wave in the centre.
        ripple_px: amplitude of a second wave.
        ripple_x: periods of the second wave across the width of the frame.
        ripple_y: periods of the second wave across the height of the frame.
        ripple_phase_rad: phase of the second wave in the centre.
        left_px: offset at the left edge, the start of lines, which decays exponentially to the right.
        left_reach: decay length by a factor e, as a fraction of the width of the frame.
        top_px: offset at the top edge, the start of the frame, which decays exponentially downwards.
        top_reach: decay length by a factor e, as a fraction of the height of the frame.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    constant_px: float
    xx_px: float
    xy_px: float
    yy_px: float
    wave_px: float
    wave_x: float
    wave_y: float
    wave_phase_rad: float
    ripple_px: float = 0.0
    ripple_x: float = 0.0
    ripple_y: float = 0.0
    ripple_phase_rad: float = 0.0
    left_px: float = 0.0
    left_reach: float = 0.1
    top_px: float = 0.0
    top_reach: float = 0.1

    def __post_init__(self) -> None:
        if not (self.left_reach > 0 and self.top_reach > 0):
            raise ValueError(f"left_reach and top_reach must be above 0, not {self.left_reach} and {self.top_reach}")

    def at(self, X: NDArray[np.float64], Y: NDArray[np.float64]) -> NDArray[np.float64]:
        """This component in px at frame coordinates X, Y in -1 ... 1."""
        total = self.constant_px + self.xx_px * X * X + self.xy_px * X * Y + self.yy_px * Y * Y
        if self.wave_px:
            total = total + self.wave_px * np.cos(np.pi * (self.wave_x * X + self.wave_y * Y) + self.wave_phase_rad)
        if self.ripple_px:
            total = total + self.ripple_px * np.cos(np.pi * (self.ripple_x * X + self.ripple_y * Y) + self.ripple_phase_rad)
        if self.left_px:
            total = total + self.left_px * np.exp(-(X + 1.0) / (2.0 * self.left_reach))
        if self.top_px:
            total = total + self.top_px * np.exp(-(Y + 1.0) / (2.0 * self.top_reach))
        return total


@dataclass(frozen=True, slots=True)
class Distortion:
    """E(R): scan address minus nominal beam position, at scan address R."""

    __pydantic_config__ = ConfigDict(extra="forbid")

    x: AxisDistortion
    y: AxisDistortion

    def at(self, x_px: ArrayLike, y_px: ArrayLike, width_px: int, height_px: int) -> NDArray[np.float64]:
        """E in px, (..., 2) for scan addresses (...)."""
        X = np.asarray(x_px, dtype=np.float64) / (0.5 * (width_px - 1)) - 1.0
        Y = np.asarray(y_px, dtype=np.float64) / (0.5 * (height_px - 1)) - 1.0
        return np.stack([self.x.at(X, Y), self.y.at(X, Y)], axis=-1)
