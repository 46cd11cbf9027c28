"""What strain a distortion feigns when an uncorrected image is merely translated (Sutton 2007, Fig. 16)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from semlive.data.displacement import Displacement
from semlive.data.drift import DistortionField
from semlive.data.strain import StrainField
from semlive.mechanics.strain import strain


def false_strain(distortion: DistortionField, shift_px: tuple[float, float], window_points: int) -> StrainField:
    """Strain that would be measured without correction after a translation of the specimen.

    A point at X is seen displaced by ``shift + E(X + shift) - E(X)``; the second part is not uniform. Points that come to lie
    beyond the calibrated grid are not valid.

    Args:
        distortion: on the grid.
        shift_px: translation (x, y).
        window_points: edge of the virtual strain gauge in POI.

    Raises:
        IllPosed: the window does not fit the grid.
    """
    grid = distortion.grid
    x, y = grid.x_px + shift_px[0], grid.y_px + shift_px[1]
    inside = _within(y, grid.y_px)[:, None] & _within(x, grid.x_px)[None, :]
    valid = inside & distortion.valid
    after = [RectBivariateSpline(grid.y_px, grid.x_px, one)(y, x) for one in (distortion.ex_px, distortion.ey_px)]
    u, v = np.where(valid, after[0] - distortion.ex_px, 0.0), np.where(valid, after[1] - distortion.ey_px, 0.0)
    return strain(Displacement(0, grid, u, v, distortion.sigma_px, distortion.sigma_px, valid), window_points)


def _within(position: NDArray[np.float64], known: NDArray[np.float64]) -> NDArray[np.bool_]:
    return (position >= known[0]) & (position <= known[-1])
