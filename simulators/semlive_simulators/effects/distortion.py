"""Spatial distortion of the raster, equal in all frames (Sutton 2007: a cosine wave plus a quadratic surface).

A second wave, and the settling of the beam at the start of a line and of a frame, give fields like those of an SEM.

Named distortions for scenarios: of the fields in Fig. 11 of the paper, only these values of its text are available: their ranges, and the
strain errors of a translation by 5 px (its Fig. 16, stated for x10,000, "similar results" for x200). A quadratic surface, two oblique waves
and the settling of the beam at the start of lines and frames were fitted to these ten numbers over the field of the paper (150 x 120
points), and agree with them within 1 %:

=========  ===================  ===================  =========================================================
field      x                    y                    strain errors for 5 px in x and y: exx, exy, eyy (1e-4)
=========  ===================  ===================  =========================================================
x200       -0.60 ... 1.00 px    -0.50 ... 2.00 px    -1.5 ... 1.0, -3.3 ... 4.3, -4.0 ... 6.0
x10,000    -0.50 ... 0.50 px    -0.40 ... 2.60 px    the same
=========  ===================  ===================  =========================================================
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


SHAPES: dict[str, Distortion] = {
    "fig11_x200": Distortion(
        x=AxisDistortion(
            constant_px=0.257, xx_px=-0.464, xy_px=-0.364, yy_px=0.03, wave_px=0.542, wave_x=-0.003, wave_y=1.52, wave_phase_rad=0.911,
            ripple_px=0.347, ripple_x=1.284, ripple_y=0.159, ripple_phase_rad=-2.896,
            left_px=0.45, left_reach=0.12, top_px=0.15, top_reach=0.15,
        ),
        y=AxisDistortion(
            constant_px=0.361, xx_px=0.259, xy_px=0.313, yy_px=0.358, wave_px=0.542, wave_x=0.965, wave_y=0.655, wave_phase_rad=-1.679,
            ripple_px=0.512, ripple_x=1.353, ripple_y=1.232, ripple_phase_rad=0.192,
            left_px=-0.3, left_reach=0.12, top_px=0.5, top_reach=0.15,
        ),
    ),
    "fig11_x10000": Distortion(
        x=AxisDistortion(
            constant_px=0.095, xx_px=-0.643, xy_px=-0.3, yy_px=0.174, wave_px=0.194, wave_x=0.489, wave_y=1.404, wave_phase_rad=0.48,
            ripple_px=0.202, ripple_x=1.785, ripple_y=-0.509, ripple_phase_rad=-1.115,
            left_px=0.25, left_reach=0.12, top_px=0.1, top_reach=0.15,
        ),
        y=AxisDistortion(
            constant_px=0.407, xx_px=0.27, xy_px=0.452, yy_px=0.744, wave_px=0.416, wave_x=1.142, wave_y=0.765, wave_phase_rad=-1.176,
            ripple_px=0.576, ripple_x=1.613, ripple_y=1.04, ripple_phase_rad=-0.117,
            left_px=0.5, left_reach=0.12, top_px=0.35, top_reach=0.15,
        ),
    ),
}  # fmt: skip
"""Distortions by name, for ``distortion: fig11_x200`` in a scenario."""


def named(chosen: object) -> object:
    """A distortion by its name; other values are returned unchanged.

    Raises:
        ValueError: if no distortion has the name.
    """
    if not isinstance(chosen, str):
        return chosen
    if chosen not in SHAPES:
        raise ValueError(f"there is no distortion {chosen}; choose {', '.join(SHAPES)}, or give its coefficients")
    return SHAPES[chosen]
