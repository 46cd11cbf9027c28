"""Standard uncertainty of one virtual strain gauge from DIC noise with overlapping subsets."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from semlive.data.grid import Grid
from semlive.data.settings import StrainSettings
from semlive.data.strain import Displacement, StrainField, Tensor2
from semlive.mechanics.strain_gauge_fits import whole_window

Field = NDArray[np.float64]


def overlap_correlation(count: int, grid: Grid) -> Field:
    """(count, count) correlation of the noise of POI in a row, from the overlap of their subsets."""
    lag_px = grid.step_px * np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    return np.clip(1.0 - lag_px / max(grid.subset_px, 1), 0.0, None)


def gauge_sigma(displacement: Displacement, field: StrainField, settings: StrainSettings, systematic: Tensor2) -> Tensor2 | None:
    """Standard uncertainty of the strain of one complete gauge; a gauge cut by the edge or a mask has a larger one.

    The local fit is linear. Its weights and the noise correlation from subset overlap give the random part exactly. The part of the
    correction is taken as that of the mean strain; its variation over the field (3e-5) is negligible relative to 6e-4 for 9 x 9 points 5 px
    apart.

    Args:
        displacement: displacement with the standard uncertainty of every POI.
        field: strain field of the displacement; gives the window.
        settings: settings of the strain fit.
        systematic: standard uncertainty added by the correction.

    Returns:
        The standard uncertainty; None after a Butterworth filter, which has no window, or without valid points.
    """
    if settings.butterworth_points is not None or not field.valid.any():
        return None
    by_x, by_y = _gain(displacement.grid.step_px, displacement.grid.subset_px, field.window_points, settings.order, settings.weights)
    inside = displacement.valid
    u2, v2 = (float(np.mean(component[inside] ** 2)) for component in (displacement.sigma_u_px, displacement.sigma_v_px))
    random = (by_x * u2, by_y * v2, 0.25 * (by_y * u2 + by_x * v2))
    added = (systematic.exx, systematic.eyy, systematic.exy)
    return Tensor2(*(float(np.sqrt(value + more**2)) for value, more in zip(random, added, strict=True)))


@lru_cache(maxsize=32)
def _gain(step_px: int, subset_px: int, window_points: int, order: int, weights: str) -> tuple[float, float]:
    """Variance of a slope along x and along y of a complete window, for noise of unit variance."""
    settings = StrainSettings(order=order, weights="gaussian" if weights == "gaussian" else "uniform")
    shared = overlap_correlation(window_points, Grid(0, 0, step_px, window_points, window_points, subset_px))
    by_x, by_y = (float(np.sum((shared @ slope @ shared) * slope)) / step_px**2 for slope in whole_window(window_points, settings))
    return by_x, by_y


def expected_sigma(grid: Grid, window_points: int, sigma_px: tuple[float, float], settings: StrainSettings) -> Tensor2:
    """Expected standard uncertainty of the strain of one complete gauge from DIC noise alone.

    Args:
        grid: grid of the POI.
        window_points: edge of the gauge in POI, odd.
        sigma_px: standard uncertainty of u and of v at a POI, px.
        settings: settings of the strain fit.
    """
    by_x, by_y = _gain(grid.step_px, grid.subset_px, window_points, settings.order, settings.weights)
    u2, v2 = (value**2 for value in sigma_px)
    return Tensor2(*(float(np.sqrt(value)) for value in (by_x * u2, by_y * v2, 0.25 * (by_y * u2 + by_x * v2))))


def expected_mean_sigma(grid: Grid, sigma_px: tuple[float, float]) -> Tensor2:
    """Expected standard uncertainty of the mean strain over the grid from DIC noise alone; formula as in `summary`."""
    x, y = grid.mesh()
    overlap = max(grid.subset_px, grid.step_px) / grid.step_px
    spread_x, spread_y = (float(np.sqrt(np.sum((value - value.mean()) ** 2))) for value in (x, y))
    u, v = (value * overlap for value in sigma_px)
    shear = 0.5 * float(np.hypot(u / max(spread_y, 1.0), v / max(spread_x, 1.0)))
    return Tensor2(u / max(spread_x, 1.0), v / max(spread_y, 1.0), shear)
