"""Noise of displacement against the subset, and noise of strain against the gauge length, from the maps within pairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive import mechanics
from semlive.data.disparity import DisparityMap
from semlive.data.strain import Displacement
from semlive.qualify.figures.intervals import scatter_interval

Array = NDArray[np.float64]
SUBSETS_PX = (21, 31, 43, 61, 87)
WINDOWS = (5, 9, 15, 23, 35)
MIN_INDEPENDENT = 24.0
"""Fewer subsets side by side in a map do not determine a scatter beyond the six terms of the trend."""
CLIP = 5.0
TREND = ((0, 0), (1, 0), (0, 1), (0, 2), (0, 3), (1, 1))
"""Powers of x and y of the trend of a map within a pair: the drift varies with the row, and little else."""
STRAIN_TERMS = (2, 4, 3)
"""Terms of the trend that take part in exx, eyy and exy."""
OVERLAP_GAIN = 2.25
"""Independent values of a variance per gauge: the squared triangular correlation of overlapping gauges has the area 4/9 gauge^2."""


@dataclass(frozen=True, slots=True, eq=False)
class Scatter:
    """Variances of one quantity in the pairs.

    Attributes:
        size_px: edge of the subset or of the gauge.
        variance: (k, c) variance of each pair and component.
        independent: number of independent values of a variance in each pair.
    """

    size_px: int
    variance: Array
    independent: float

    def worst(self) -> tuple[float, float, float]:
        """Standard deviation of the component with the largest scatter, and its 95 % interval."""
        worst = int(np.argmax(self.variance.mean(axis=0)))
        return scatter_interval(self.variance[:, worst], self.independent)


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
    rows, subset = [], maps[0].grid.subset_px if maps else 0
    area = min((float(disparity.valid.sum()) * disparity.grid.step_px**2 for disparity in maps), default=0.0)
    independent = area / subset**2 if subset else 0.0
    if independent < MIN_INDEPENDENT:
        return None
    for disparity in maps:
        fields = detrended(disparity)
        if fields is not None:
            freed = independent / (independent - len(TREND))
            rows.append([freed * float(np.mean(field[disparity.valid] ** 2)) for field in fields])
    return Scatter(subset, np.array(rows), min(independent_points(disparity, 2) for disparity in maps)) if rows else None


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
    rows = []
    for disparity in maps:
        fields = detrended(disparity)
        if fields is None:
            continue
        moved = Displacement(0, grid, *fields, disparity.sigma_u_px, disparity.sigma_v_px, disparity.valid)
        found = mechanics.strain(moved, window_points)
        half = window_points // 2
        inner = np.zeros(grid.shape, dtype=np.bool_)
        inner[half : grid.ny - half, half : grid.nx - half] = True
        inner &= found.valid
        if inner.any():
            freed = [independent / (independent - terms) for terms in STRAIN_TERMS]
            values = (found.exx, found.eyy, found.exy)
            rows.append([gain * float(np.mean(value[inner] ** 2)) for gain, value in zip(freed, values, strict=True)])
    return Scatter(gauge_px, np.array(rows), OVERLAP_GAIN * independent) if rows else None
