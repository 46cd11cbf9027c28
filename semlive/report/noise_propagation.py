"""Propagation of the correlation noise to displacement and strain; the only input is the standard deviation of the noise.

The noise of one POI is a weighted sum of the grey level noise in its subset; the weights are the intensity gradients. Two POI share the
pixels of overlapping subsets, so for a uniform speckle their noise correlates by the overlap, ``(1 - |dx| / subset) (1 - |dy| / subset)``.
For a coarse speckle the correlation is smaller, because a few steep edges dominate. A plane fit over a window is linear, and over a
rectangle it separates into columns and rows, like the covariance. All results are exact for the given correlation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.data.grid import Grid
from semlive.mechanics.gauge_noise import overlap_correlation

Field = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class NoiseScatter:
    """Standard deviation over one field by correlation noise alone, mean of the field removed.

    Attributes:
        u: standard deviation of displacement along x, averaged over the gauge, px.
        v: standard deviation of displacement along y, px.
        exx: standard deviation of strain exx.
        eyy: standard deviation of strain eyy.
        exy: standard deviation of strain exy.
    """

    u: float
    v: float
    exx: float
    eyy: float
    exy: float


@dataclass(frozen=True, slots=True, eq=False)
class NoiseCorrelation:
    """Correlation of the noise of two POI over their distance: the product of one factor along x and one along y.

    Attributes:
        u_x: (lags,) correlation of u over the lag along x in POI; zero beyond.
        u_y: correlation of u along y.
        v_x: correlation of v along x.
        v_y: correlation of v along y.
    """

    u_x: Field
    u_y: Field
    v_x: Field
    v_y: Field

    @classmethod
    def from_subset_overlap(cls, grid: Grid) -> NoiseCorrelation:
        """Correlation for subsets with uniform gradients."""
        lags = -(-grid.subset_px // grid.step_px)
        shared = overlap_correlation(lags, grid)[0]
        return cls(shared, shared, shared, shared)


def _correlation_matrix(count: int, by_lag: Field) -> Field:
    """(count, count) correlation of the noise of POI in a row."""
    lag = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    return np.where(lag < len(by_lag), by_lag[np.minimum(lag, len(by_lag) - 1)], 0.0)


def gauge_rows(count: int, window_points: int, *, full: bool) -> tuple[Field, Field]:
    """Mean and slope (per POI) of a line fitted over windows of POI in a row.

    Args:
        count: number of POI in the row.
        window_points: number of POI in a window, odd.
        full: leave out windows that extend beyond the edges.

    Returns:
        (n, count) weights of the mean, (n, count) weights of the slope, n windows.
    """
    half = window_points // 2
    centres = np.arange(half, count - half) if full else np.arange(count)
    lag = np.arange(count) - centres[:, None]
    inside = (np.abs(lag) <= half).astype(np.float64)
    size = inside.sum(axis=1, keepdims=True)
    mean = inside / size
    from_mean = (lag - (mean * lag).sum(axis=1, keepdims=True)) * inside
    return mean, from_mean / np.maximum((from_mean**2).sum(axis=1, keepdims=True), 0.5)


def noise_scatter(
    grid: Grid, window_points: int, sigma_u_px: float, sigma_v_px: float, *, full: bool, correlation: NoiseCorrelation | None = None
) -> NoiseScatter:
    """Expected scatter of a field of displacement or strain from noise of the DIC.

    Args:
        grid: the POI.
        window_points: edge of the virtual strain gauge in POI, odd.
        sigma_u_px: standard deviation of the noise of u.
        sigma_v_px: of v.
        full: over complete gauges only; otherwise also over gauges that extend beyond the grid.
        correlation: correlation of the noise of neighbouring POI; None: by the overlap of their subsets.
    """
    noise = correlation or NoiseCorrelation.from_subset_overlap(grid)
    (mean_x, slope_x), (mean_y, slope_y) = (gauge_rows(count, window_points, full=full) for count in (grid.nx, grid.ny))
    flat, by_x, by_y = [], [], []
    for along_x, along_y in ((noise.u_x, noise.u_y), (noise.v_x, noise.v_y)):
        x, y = _correlation_matrix(grid.nx, along_x), _correlation_matrix(grid.ny, along_y)
        flat.append(_variance(mean_x, x, mean_y, y))
        by_x.append(_variance(slope_x, x, mean_y, y) / grid.step_px**2)
        by_y.append(_variance(mean_x, x, slope_y, y) / grid.step_px**2)
    u2, v2 = sigma_u_px**2, sigma_v_px**2
    variances = (flat[0] * u2, flat[1] * v2, by_x[0] * u2, by_y[1] * v2, 0.25 * (by_y[0] * u2 + by_x[1] * v2))
    return NoiseScatter(*(float(np.sqrt(variance)) for variance in variances))


def effective_sample_size(grid: Grid, window_points: int = 1) -> float:
    """Effective number of independent values of the noise of a map, for a mean of squares: ``n^2 / sum of squared correlations``.

    For single POI it is 558 of the 18,000 POI in Sutton et al. (272 for a plain mean), for strain over 9 x 9 POI it is 289.

    Args:
        grid: the POI.
        window_points: edge of the strain gauge, including gauges that extend beyond the grid; 1 is displacement.
    """
    (mean_x, slope_x), (mean_y, _) = (gauge_rows(count, window_points, full=False) for count in (grid.nx, grid.ny))
    rows_x = mean_x if window_points == 1 else slope_x
    shared = NoiseCorrelation.from_subset_overlap(grid).u_x
    x, y = rows_x @ _correlation_matrix(grid.nx, shared) @ rows_x.T, mean_y @ _correlation_matrix(grid.ny, shared) @ mean_y.T
    return float((np.trace(x) * np.trace(y)) ** 2 / ((x**2).sum() * (y**2).sum()))


def _variance(rows_x: Field, along_x: Field, rows_y: Field, along_y: Field) -> float:
    """Expected variance over the field about its own mean, of a separable filter on noise of unit variance."""
    x, y = rows_x @ along_x @ rows_x.T, rows_y @ along_y @ rows_y.T
    return float(np.diag(x).mean() * np.diag(y).mean() - x.mean() * y.mean())
