"""Disparity maps from tables on a regular grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.grid import Grid
from semlive.formats.tables.disparity_table import DisparityTable
from semlive.formats.tables.sentinels import doubtful_pair

Field = NDArray[np.float64]
MIN_POINTS = 3  # points along an axis; the strain cannot be determined from fewer
_MAX_POINTS = 10**7
_LAG, _PARTS = 9, 8
_FOURTH = 70.0  # 1 + 16 + 36 + 16 + 1: variance of a fourth difference of white noise
_MAD_TO_SIGMA = 1.4826
_MAX_DEVIATION_PX = 0.5  # from neighbouring points: a strain of 10 % at a step of 5 px, which no specimen has


def grid_of(table: DisparityTable, subset_px: int) -> Grid:
    """Return the grid of the points of a map.

    Args:
        table: the map.
        subset_px: edge of the subset; 0 if there is none.

    Raises:
        BadInput: the points are not on a regular grid with integer pixel coordinates, or are too few.
    """
    for column, values in enumerate((table.x_px, table.y_px)):
        if (fractional := values != np.round(values)).any():
            point = int(np.argmax(fractional))
            problem = f"{values[point]:g} is not an integer"
            advice = "points must be on a regular grid with integer coordinates; x and y are those of the reference frame, in px"
            raise table.error(point, column, problem, advice)
    steps = []
    for column, values in enumerate((table.x_px, table.y_px)):
        distinct = np.unique(values)
        if len(distinct) < MIN_POINTS:
            raise table.error(
                0,
                column,
                f"the map has {len(distinct)} different {'xy'[column]}",
                f"at least {MIN_POINTS} x {MIN_POINTS} points are needed",
            )
        steps.append(int(np.bincount(np.diff(distinct).astype(np.int64)).argmax()))
    if steps[0] != steps[1]:
        raise table.error(0, 0, f"points are {steps[0]} px apart along x but {steps[1]} px along y", "export both with the same step")
    step = steps[0]
    x0, y0 = (_start_of(values, step) for values in (table.x_px, table.y_px))
    nx, ny = (int((values.max() - start) // step) + 1 for values, start in ((table.x_px, x0), (table.y_px, y0)))
    if nx * ny > _MAX_POINTS:
        raise table.error(0, 0, f"{nx} x {ny} points {step} px apart", f"at most {_MAX_POINTS} points are read")
    return Grid(x0, y0, step, nx, ny, subset_px)


def _start_of(values: NDArray[np.float64], step: int) -> int:
    """Return the smallest value on the most frequent offset, so that an error names a stray point and not all other points."""
    offsets = values.astype(np.int64) % step
    return int(values[offsets == np.bincount(offsets).argmax()].min())


def map_on(table: DisparityTable, grid: Grid, reference: int, current: int) -> DisparityMap:
    """Return the map on a grid; points that are missing in the table were not found.

    Raises:
        BadInput: a point is not on the grid or occurs twice, a required point is missing, or points that were not found have zero
            displacement or one pair of numbers.
    """
    place = _places(table, grid)
    counts = np.bincount(place, minlength=grid.nx * grid.ny)
    if counts.max() > 1:
        repeated = int(np.argmax(counts > 1))
        second = int(np.flatnonzero(place == repeated)[1])
        raise table.error(second, 0, f"the point ({table.x_px[second]:.0f}, {table.y_px[second]:.0f}) occurs twice", "keep one")
    if table.dialect.lists_all_points and not counts.all():
        missing = int(np.argmin(counts))
        x, y = grid.x0_px + grid.step_px * (missing % grid.nx), grid.y0_px + grid.step_px * (missing // grid.nx)
        problem = f"{int((counts == 0).sum())} points of the grid are missing, the first ({x}, {y})"
        raise table.error(len(place) - 1, 0, problem, "list every point in every map, with valid 0 where it was not found")
    valid = np.zeros(grid.shape, dtype=np.bool_)
    valid.ravel()[place] = table.valid
    u, v = (_on_grid(values, place, grid) for values in (table.u_px, table.v_px))
    _check_moved(table, place, np.stack((u, v)), valid)
    _check_repeated(table, place, u, v, valid)
    if table.sigma_u_px is None or table.sigma_v_px is None:
        sigma_u, sigma_v = (np.where(valid, scatter_px(values, valid), 0.0) for values in (u, v))
    else:
        sigma_u, sigma_v = (_on_grid(values, place, grid) for values in (table.sigma_u_px, table.sigma_v_px))
    status = np.where(valid, PoiStatus.CONVERGED, PoiStatus.NOT_CONVERGED).astype(np.uint8)
    return DisparityMap(reference, current, grid, u, v, sigma_u, sigma_v, valid.astype(np.float64), status)


def _check_moved(table: DisparityTable, place: NDArray[np.int64], displacement: NDArray[np.float64], valid: NDArray[np.bool_]) -> None:
    """Refuse zero displacements of lost points, which some programs write: 1 % of such points reduces a strain by 1 %.

    Raises:
        BadInput: a point has zero displacement where the points around it move.
    """
    still = valid & (displacement == 0.0).all(axis=0)
    moving = uniform_filter((valid & ~still).astype(np.float64), 3)
    mean_around = np.stack([uniform_filter(component, 3) for component in displacement]) / np.maximum(moving, 1e-9)
    deviation_px = np.where(still & (moving > 1e-9), np.hypot(*mean_around), 0.0)
    lost = deviation_px > _MAX_DEVIATION_PX
    if lost.any():
        first = int(np.flatnonzero(lost.ravel()[place])[0])
        around = f"{deviation_px.ravel()[place[first]]:.3g} px"
        problem = f"{int(lost.sum())} points moved by exactly 0 where the points around them moved by {around}"
        raise table.error(first, 2, problem, f"mark with the column {table.dialect.mark} which points were not found")


def _check_repeated(table: DisparityTable, place: NDArray[np.int64], u: Field, v: Field, valid: NDArray[np.bool_]) -> None:
    """Refuse a pair of numbers that many points have although all points next to them moved otherwise.

    Raises:
        BadInput: there is such a pair.
    """
    doubtful = doubtful_pair(u, v, valid)
    if doubtful is not None:
        points = np.flatnonzero(doubtful[0].ravel()[place])
        first = int(points[0])
        pairs = set(zip(table.u_px[points], table.v_px[points], strict=True))
        moved = f"moved by exactly ({table.u_px[first]:g}, {table.v_px[first]:g}) px" if len(pairs) == 1 else "have exactly 0 as u or as v"
        problem = f"{int(doubtful[0].sum())} points {moved}, and all points around them by {doubtful[1]:.3g} px less or more"
        raise table.error(first, 2, problem, f"mark with the column {table.dialect.mark} which points were not found")


def scatter_px(values: NDArray[np.float64], valid: NDArray[np.bool_]) -> float:
    """Return the standard deviation of the noise of a map from its fourth differences, for maps without uncertainties.

    Points at this distance share no subset of up to nine steps, and smooth fields cancel: a wave of 1 px amplitude and 1,000 px length
    contributes 6e-3 px at 45 px.
    """
    estimates = []
    for field, good in ((values, valid), (values.T, valid.T)):
        lag = max(1, min(_LAG, (field.shape[1] - 1) // _PARTS))
        count = field.shape[1] - 4 * lag
        if count < 1:
            continue
        parts = [field[:, at * lag : at * lag + count] for at in range(5)]
        inside = np.all([good[:, at * lag : at * lag + count] for at in range(5)], axis=0)
        if inside.any():
            fourth = (parts[0] - 4 * parts[1] + 6 * parts[2] - 4 * parts[3] + parts[4])[inside]
            estimates.append(_MAD_TO_SIGMA * float(np.median(np.abs(fourth))) / np.sqrt(_FOURTH))
    return float(np.mean(estimates)) if estimates else 0.0


def _places(table: DisparityTable, grid: Grid) -> NDArray[np.int64]:
    """Return the index of every listed point in the grid, (n,)."""
    index = []
    for column, (values, start, count) in enumerate(((table.x_px, grid.x0_px, grid.nx), (table.y_px, grid.y0_px, grid.ny))):
        steps = (values - start) / grid.step_px
        bad = (steps != np.round(steps)) | (steps < 0) | (steps > count - 1)
        if bad.any():
            point = int(np.argmax(bad))
            last = start + grid.step_px * (count - 1)
            problem = f"{values[point]:g} is not on the grid of the first map ({start}, {start + grid.step_px}, ... {last})"
            raise table.error(point, column, problem, "export all maps on one grid")
        index.append(steps.astype(np.int64))
    return index[1] * grid.nx + index[0]


def _on_grid(values: NDArray[np.float64], place: NDArray[np.int64], grid: Grid) -> NDArray[np.float64]:
    field = np.zeros(grid.shape)
    field.ravel()[place] = values
    return field


def check_inside(table: DisparityTable, width_px: int, height_px: int) -> None:
    """Check that points are inside the frame and move by less than its size; otherwise they are not in pixels.

    Raises:
        BadInput: a point does not; the message names the first.
    """
    for column, (values, size) in enumerate(
        ((table.x_px, width_px), (table.y_px, height_px), (table.u_px, width_px), (table.v_px, height_px))
    ):
        bad = (values < 0) | (values > size - 1) if column < 2 else np.abs(values) >= size
        if bad.any():
            point = int(np.argmax(bad))
            what = "is outside" if column < 2 else "is longer than"
            problem = f"{values[point]:g} px {what} the frame of {width_px} x {height_px} px"
            raise table.error(point, column, problem, "give it in pixels, (0, 0) at the centre of the first")
