"""Spatial distortion: the raster is bent, the same in every frame (Sutton 2007: a cosine wave plus a quadratic surface)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import ConfigDict


@dataclass(frozen=True, slots=True)
class AxisDistortion:
    """One component over X, Y, which run from -1 to 1 across the frame.

    Attributes:
        constant_px: everywhere.
        xx_px: coefficient of X squared.
        xy_px: coefficient of X Y.
        yy_px: coefficient of Y squared.
        wave_px: amplitude of the wave.
        wave_x: its periods across the frame's width.
        wave_y: its periods across the frame's height.
        wave_phase_rad: its phase in the centre.
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

    def at(self, X: NDArray[np.float64], Y: NDArray[np.float64]) -> NDArray[np.float64]:
        """This component in px at frame coordinates X, Y in -1 ... 1."""
        wave = np.cos(np.pi * (self.wave_x * X + self.wave_y * Y) + self.wave_phase_rad)
        return self.constant_px + self.xx_px * X * X + self.xy_px * X * Y + self.yy_px * Y * Y + self.wave_px * wave


@dataclass(frozen=True, slots=True)
class Distortion:
    """E(R): scan address minus where the beam ought to be, at scan address R."""

    __pydantic_config__ = ConfigDict(extra="forbid")

    x: AxisDistortion
    y: AxisDistortion

    def at(self, x_px: ArrayLike, y_px: ArrayLike, width_px: int, height_px: int) -> NDArray[np.float64]:
        """E in px, (..., 2) for scan addresses (...)."""
        X = np.asarray(x_px, dtype=np.float64) / (0.5 * (width_px - 1)) - 1.0
        Y = np.asarray(y_px, dtype=np.float64) / (0.5 * (height_px - 1)) - 1.0
        return np.stack([self.x.at(X, Y), self.y.at(X, Y)], axis=-1)
