"""Apparent strain caused by distortion when an uncorrected image is translated (Sutton 2007, Fig. 16)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from semlive.data.drift import DistortionField
from semlive.data.grid import Grid
from semlive.data.strain import Displacement, StrainField
from semlive.mechanics.strain import strain


def false_strain(distortion: DistortionField, shift_px: tuple[float, float], window_points: int) -> StrainField:
    """Strain measured without correction after a translation of the specimen.

    A point at X has the apparent displacement ``shift + E(X + shift) - E(X)``; the second part is not uniform. Points that move outside the
    calibrated grid are invalid.

    Args:
        distortion: distortion on the grid.
        shift_px: translation (x, y), px.
        window_points: edge of the virtual strain gauge, in POI.

    Raises:
        IllPosed: the window does not fit the grid.
    """
    grid = distortion.grid
    x, y = grid.x_px + shift_px[0], grid.y_px + shift_px[1]
    inside = _within(y, grid.y_px)[:, None] & _within(x, grid.x_px)[None, :]
    valid = inside & distortion.valid
    after = [RectBivariateSpline(grid.y_px, grid.x_px, component)(y, x) for component in (distortion.ex_px, distortion.ey_px)]
    u, v = np.where(valid, after[0] - distortion.ex_px, 0.0), np.where(valid, after[1] - distortion.ey_px, 0.0)
    return strain(Displacement(0, grid, u, v, distortion.sigma_px, distortion.sigma_px, valid), window_points)


def typical_distortion(grid: Grid, width_px: int, height_px: int) -> DistortionField:
    """Distortion similar to those measured at x200: 0.7 px from end to end along x and 1.9 px along y (Sutton 2007, part II).

    It replaces the distortion of a microscope until that is known. With its amplitudes a translation of 5 px causes the apparent strain
    of Fig. 16 of the paper.

    Args:
        grid: grid of the samples.
        width_px: frame width, px.
        height_px: frame height, px.
    """
    x, y = grid.mesh()
    a, b = 2.0 * x / width_px - 1.0, 2.0 * y / height_px - 1.0
    ex = 0.4 * a * b + 0.17 * np.cos(2.0 * np.pi * a) + 0.3 * b**2
    ey = 0.6 * b**2 + 0.6 * a * b + 0.42 * np.cos(2.0 * np.pi * b) + 0.4 * np.cos(3.0 * np.pi * a)
    fields = []
    for component in (ex, ey, np.zeros(grid.shape)):
        component.setflags(write=False)
        fields.append(component)
    everywhere = np.ones(grid.shape, dtype=np.bool_)
    everywhere.setflags(write=False)
    return DistortionField(grid, fields[0], fields[1], fields[2], everywhere)


def _within(position: NDArray[np.float64], grid_axis: NDArray[np.float64]) -> NDArray[np.bool_]:
    return (position >= grid_axis[0]) & (position <= grid_axis[-1])
