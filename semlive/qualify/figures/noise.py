"""Noise of displacement against the subset, and noise of strain against the gauge length, from the maps within pairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from semlive import mechanics
from semlive.data.disparity import DisparityMap
from semlive.data.grid import Grid
from semlive.data.strain import Displacement
from semlive.qualify.figures.intervals import chi_square_quantile, scatter_interval

Array = NDArray[np.float64]
SUBSETS_PX = (21, 31, 43, 61, 87)
WINDOWS = (5, 9, 15, 23, 35)
MIN_INDEPENDENT = 24.0
"""Fewer subsets side by side in a map do not determine a scatter beyond the six terms of the trend."""
CLIP = 5.0
TREND = ((0, 0), (1, 0), (0, 1), (0, 2), (0, 3), (1, 1))
"""Powers of x and y of the trend of a map within a pair: the drift varies with the row, and little else."""
ROW_ORDERS, OTHER_TERMS = 4, 2
"""Polynomials of the row alone in the trend, and its other terms."""
LAST_ORDER, MIN_RESPONSE = 16, 0.1
"""End of the cosines of the row, in half cycles per map, that show what the trend followed; those with a smaller response than a tenth of
the first are left out.
"""
OVERLAP_GAIN = 2.25
"""Independent values of a variance per gauge: the squared triangular correlation of overlapping gauges has the area 4/9 gauge^2."""


@dataclass(frozen=True, slots=True, eq=False)
class Scatter:
    """Variances of one quantity in the pairs.

    Attributes:
        size_px: edge of the subset or of the gauge.
        observed: (k, c) variance of each pair and component about the trend.
        followed: (k, c) variance that the trend followed.
        independent: number of independent values of a variance in each pair.
    """

    size_px: int
    observed: Array
    followed: Array
    independent: float

    def worst(self) -> tuple[float, float, float]:
        """Standard deviation of the component with the largest scatter, and its 95 % interval."""
        variance = self.observed + self.followed
        worst = int(np.argmax(variance.mean(axis=0)))
        return scatter_interval(variance[:, worst], self.independent)


@dataclass(frozen=True, slots=True, eq=False)
class RowOrders:
    """Polynomials of the row on a grid, of the orders in the trend, and cosines about the trend.

    Row jitter moves all points of a row, so that a trend of four orders follows a third of its variance in ten subsets side by side: the
    noise of subsets of 61 px was 21 % too small. The median power of the next cosines shows how much. A wave of a few cycles per map has
    its power in two or three of them: their mean made the noise 20 % too large.

    Attributes:
        unit: (n, k) polynomials, then cosines, at the n rows of the grid, root mean square 1.
        response: (k,) power of each in white noise of the rows that is averaged over a subset.
    """

    unit: Array
    response: Array

    @classmethod
    def of(cls, grid: Grid) -> RowOrders | None:
        """Polynomials of the rows of a grid; None for too few rows."""
        if grid.ny < 2 * ROW_ORDERS:
            return None
        place = (np.arange(grid.ny) + 0.5) / grid.ny
        trend = np.linalg.qr(legendre.legvander(place, ROW_ORDERS - 1))[0]
        cosines = np.cos(np.pi * np.arange(ROW_ORDERS, min(LAST_ORDER, grid.ny)) * place[:, None])
        unit = np.column_stack((trend, cosines - trend @ (trend.T @ cosines)))
        unit *= np.sqrt(grid.ny) / np.linalg.norm(unit, axis=0)
        distance_px = np.abs(grid.y_px[:, None] - grid.y_px)
        shared = np.maximum(1.0 - distance_px / grid.subset_px, 0.0)
        return cls(unit, np.einsum("nk,nm,mk->k", unit, shared, unit))

    def followed(self, rows: Array) -> Array:
        """(k, 2, ROW_ORDERS) variance that each order of the trends of k maps followed, from the means (k, 2, n) of rows about them."""
        power = (rows @ self.unit / rows.shape[-1]) ** 2
        used = self.response >= MIN_RESPONSE * self.response[ROW_ORDERS]
        used[:ROW_ORDERS] = False
        level = power[..., used].sum(axis=-1) / self.response[used].sum()
        # The median of powers with k degrees of freedom is smaller than their mean.
        median = np.median(power[..., used].mean(axis=0) / self.response[used], axis=-1) * len(rows) / chi_square_quantile(0.5, len(rows))
        share = np.divide(median, level.mean(axis=0), out=np.zeros_like(median), where=median > 0.0)
        return (level * share)[..., None] * self.response[:ROW_ORDERS]


def detrended(disparity: DisparityMap) -> tuple[Array, Array] | None:
    """(ny, nx) u and v of a map without the trend of the drift, outliers clipped, zero where not valid; None for too few points."""
    valid = disparity.valid
    if int(valid.sum()) < 4 * len(TREND):
        return None
    columns = trend_columns(disparity)
    fields = []
    for values in (disparity.u_px, disparity.v_px):
        rest = values[valid] - columns @ np.linalg.lstsq(columns, values[valid], rcond=None)[0]
        limit = CLIP * 1.4826 * float(np.median(np.abs(rest)))
        field = np.zeros(disparity.grid.shape)
        field[valid] = np.clip(rest, -limit, limit)
        fields.append(field)
    return fields[0], fields[1]


def trend_columns(disparity: DisparityMap) -> Array:
    """(n, 6) powers of the trend at the n valid points of a map."""
    x, y = ((axis - axis.mean()) / max(float(np.ptp(axis)), 1.0) for axis in disparity.grid.mesh())
    return np.stack([(x**i * y**j)[disparity.valid] for i, j in TREND], axis=-1)


def displacement_scatter(maps: Sequence[DisparityMap]) -> Scatter | None:
    """Scatter of u and v of one subset size; None if the maps are too small for it."""
    observed, rows, subset = [], [], maps[0].grid.subset_px if maps else 0
    area = min((float(disparity.valid.sum()) * disparity.grid.step_px**2 for disparity in maps), default=0.0)
    independent = area / subset**2 if subset else 0.0
    if independent < MIN_INDEPENDENT:
        return None
    for disparity in maps:
        fields = detrended(disparity)
        if fields is not None:
            rows.append([_row_means(field, disparity.valid) for field in fields])
            observed.append([_observed(field[disparity.valid], row, independent) for field, row in zip(fields, rows[-1], strict=True)])
    if not observed:
        return None
    followed = _followed(RowOrders.of(maps[0].grid), rows).sum(axis=-1)
    return Scatter(subset, np.array(observed), followed, min(independent_points(disparity, 2) for disparity in maps))


def _followed(orders: RowOrders | None, rows: Sequence[Sequence[Array]]) -> Array:
    """(k, 2, ROW_ORDERS) variance that the trends of k maps followed, zero for too few rows, from the means of rows about them."""
    return np.zeros((len(rows), 2, ROW_ORDERS)) if orders is None else orders.followed(np.array(rows))


def _row_means(field: Array, valid: NDArray[np.bool_]) -> Array:
    """(ny,) mean of the valid points of each row, whose other points are zero; zero for a row without one."""
    return field.sum(axis=1) / np.maximum(valid.sum(axis=1), 1)


def _observed(values: Array, rows: Array, independent: float) -> float:
    """Variance of the values of a map; what differs within the rows is white, and the other terms of the trend followed a share of it."""
    total, common = float(np.mean(values**2)), float(np.mean(rows**2))
    return common + max(total - common, 0.0) * independent / (independent - OTHER_TERMS)


def independent_points(disparity: DisparityMap, power: int) -> float:
    """Independent values in a map for a mean (power 1) or a variance (power 2): two subsets are correlated by their overlap."""
    grid = disparity.grid
    overlap = 1.0 - np.arange(0, grid.subset_px, grid.step_px) / grid.subset_px
    along_axis = 2.0 * float(np.sum(overlap**power)) - 1.0
    return max(float(disparity.valid.sum()) / along_axis**2, 1.0)


def white_noise(maps: Sequence[DisparityMap]) -> tuple[float, float]:
    """Standard uncertainty of u and v from image noise, root mean squares over all points, px."""
    pieces = [(disparity.sigma_u_px[disparity.valid], disparity.sigma_v_px[disparity.valid]) for disparity in maps]
    u, v = (np.concatenate([piece[axis] for piece in pieces]) for axis in (0, 1))
    return float(np.sqrt(np.mean(u**2))), float(np.sqrt(np.mean(v**2)))


def strain_scatter(maps: Sequence[DisparityMap], window_points: int) -> Scatter | None:
    """Scatter of exx, eyy and exy of one gauge between gauges; None if fewer than 24 gauges fit side by side."""
    grid = maps[0].grid
    gauge_px = grid.vsg_px(window_points)
    independent = grid.nx * grid.ny * grid.step_px**2 / gauge_px**2
    if window_points > min(grid.nx, grid.ny) or independent < 0.5 * MIN_INDEPENDENT:
        return None
    observed, rows = [], []
    for disparity in maps:
        fields = detrended(disparity)
        if fields is None:
            continue
        moved = Displacement(0, grid, *fields, disparity.sigma_u_px, disparity.sigma_v_px, disparity.valid)
        strains = _mean_squares(moved, window_points)
        if strains is not None:
            observed.append(strains)
            rows.append([_row_means(field, disparity.valid) for field in fields])
    if not observed:
        return None
    orders = RowOrders.of(grid)
    along_x, along_y = (_followed(orders, rows) @ _slope_variance(orders, grid.step_px, window_points)).T
    followed = np.stack((np.zeros_like(along_x), along_y, 0.25 * along_x), axis=-1)
    return Scatter(gauge_px, np.array(observed), followed, OVERLAP_GAIN * independent)


def rotation_sigma_rad(maps: Sequence[DisparityMap]) -> float:
    """Standard uncertainty of the rotation of a pair by motion of its rows, from the map within each pair; 0 if they are too small.

    The map of two frames shows the slope of both, which is twice the rotation; a pair is the mean of both.
    """
    orders = RowOrders.of(maps[0].grid) if maps else None
    fields = [(detrended(disparity), disparity.valid) for disparity in maps]
    rows = [[_row_means(field, valid) for field in found] for found, valid in fields if found is not None]
    if orders is None or not rows:
        return 0.0
    line_px = float(np.sqrt(_followed(orders, rows)[:, 0, 1].mean()))  # root mean square of the straight line along y
    return 0.25 * line_px * np.sqrt(12.0) / (maps[0].grid.ny * maps[0].grid.step_px)


def _mean_squares(moved: Displacement, window_points: int) -> list[float] | None:
    """Mean squares of exx, eyy and exy of gauges within the grid; None without a valid one."""
    grid, half = moved.grid, window_points // 2
    found = mechanics.strain(moved, window_points)
    inner = np.zeros(grid.shape, dtype=np.bool_)
    inner[half : grid.ny - half, half : grid.nx - half] = True
    inner &= found.valid
    return [float(np.mean(value[inner] ** 2)) for value in (found.exx, found.eyy, found.exy)] if inner.any() else None


def _slope_variance(orders: RowOrders | None, step_px: int, window_points: int) -> Array:
    """(ROW_ORDERS,) variance of the slopes along y over a window, of each order of a trend."""
    if orders is None:
        return np.zeros(ROW_ORDERS)
    offsets = np.arange(window_points) - window_points // 2
    windows = np.lib.stride_tricks.sliding_window_view(orders.unit[:, :ROW_ORDERS], window_points, axis=0)
    slopes = windows @ offsets / (step_px * float(offsets @ offsets))
    return np.asarray(np.mean(slopes**2, axis=0))
