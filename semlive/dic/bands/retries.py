"""Retries of failed points of a map that was correlated in bands, from their converged neighbours.

Only columns of points with failed ones are read again. The strips of the images around them are placed side by side, as one narrow image,
in which the points have the same distance; points between the strips are not used. A subset of a strip has the same grey levels as in the
frame, therefore the results are bit-identical to those of the complete frame.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import PoiStatus
from semlive.data.grid import Grid
from semlive.data.settings import DicSettings
from semlive.dic.bands.image_pair import MARGIN_PX, ImagePair, prepare_cut, reaches_side
from semlive.dic.correlate import FINAL, ORDER, point_measurements, refine_fourth_order, retry_from_neighbours
from semlive.dic.outlier_rejection import PointMeasurements
from semlive.dic.reference import FrameStatistics
from semlive.kernels import images
from semlive.kernels.subset_matching import interface
from semlive.kernels.subset_matching.fourth_order_matrix import QUARTIC


@dataclass(frozen=True, slots=True, eq=False)
class _Strips:
    """Strips of columns side by side.

    Attributes:
        columns: columns of the images, one after the other.
        x0_px: position of the first point in the strips.
        points: column of points of each column of points in the strips; -1 between strips.
        low_px: first pixel of the strip of each of these columns in the strips; -inf where this is the first pixel of the frame.
        high_px: last pixel of it; inf where this is the last of the frame.
    """

    columns: NDArray[np.intp]
    x0_px: int
    points: NDArray[np.intp]
    low_px: NDArray[np.float64]
    high_px: NDArray[np.float64]


def retry(
    pair: ImagePair, rows: Grid, inner: slice, attempted: interface.Solutions, statistics: FrameStatistics, settings: DicSettings
) -> tuple[NDArray[np.intp], NDArray[np.intp], PointMeasurements] | None:
    """Retry the failed points of some rows.

    Args:
        pair: the images.
        rows: these rows of points, with as many more on each side as retries can reach.
        inner: the rows of `rows` whose points are returned.
        attempted: solutions of the rows before any retry; not changed.
        statistics: of the reference.
        settings: of the correlation.

    Returns:
        Rows (n,), columns (n,) and measurements (n,) of the failed points; None if none can be retried.
    """
    failed = ~FINAL[attempted.status]
    converged = (attempted.status == PoiStatus.CONVERGED).astype(np.uint8)
    reachable = failed & (cv2.dilate(converged, np.ones((3, 3), dtype=np.uint8)) > 0)
    if not failed[inner].any() or not reachable.any():
        return None
    half, height = rows.subset_px // 2, pair.reference.shape[0]
    margin = MARGIN_PX + int(np.abs(attempted.parameters[converged > 0][:, [0, 3]]).max(initial=0.0))
    while True:
        top = max(0, int(rows.y_px[0]) - half - margin)
        bottom = min(height, int(rows.y_px[-1]) + half + margin + 1)
        strips = _strips(rows, np.asarray(failed.any(axis=0), dtype=np.bool_), half + margin, pair.reference.shape[1])
        cut = dataclasses.replace(rows, x0_px=strips.x0_px, y0_px=rows.y0_px - top, nx=len(strips.points))
        f, g = _cut(pair, slice(top, bottom), strips.columns)
        usable = pair.usable(slice(top, bottom))
        usable = None if usable is None else np.ascontiguousarray(usable[:, strips.columns])
        reference = prepare_cut(f, usable, cut, settings, statistics, np.zeros(cut.shape, dtype=bool))
        solutions = _selected(attempted, strips.points, reference.sums.parameters)
        interpolator = images.interpolator(g, ORDER[settings.interpolation])
        retry_from_neighbours(reference, interpolator, solutions, settings)
        low_y, high_y = -np.inf if top == 0 else 0.0, np.inf if bottom == height else bottom - top - 1.0
        y, x = cut.y_px[:, None] + solutions.parameters[..., 3], cut.x_px + solutions.parameters[..., 0]
        near_side = reaches_side(solutions, y, rows.subset_px, np.array(low_y), np.array(high_y))
        if not near_side and not reaches_side(solutions, x, rows.subset_px, strips.low_px, strips.high_px):
            break
        margin *= 2
    again = failed[:, strips.points] & (strips.points >= 0)
    again[: inner.start] = again[inner.stop :] = False
    solutions.status[~again] = PoiStatus.MASKED  # these are not refined
    refine_fourth_order(reference, interpolator, solutions, settings)
    measured = point_measurements(reference, solutions, settings)
    values = {field.name: getattr(measured, field.name)[again] for field in dataclasses.fields(measured)}
    j, i = np.nonzero(again)
    return j, strips.points[i], PointMeasurements(**values)


def _cut(pair: ImagePair, rows: slice, columns: NDArray[np.intp]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Columns of both images as float32 grey levels, without a copy of complete rows."""
    breaks = np.flatnonzero(np.diff(columns) != 1) + 1
    parts = [pair.grey(rows, slice(int(run[0]), int(run[-1]) + 1)) for run in np.split(columns, breaks)]
    first, second = (np.ascontiguousarray(np.concatenate(images, axis=1)) for images in zip(*parts, strict=True))
    return first, second


def _strips(grid: Grid, failed: NDArray[np.bool_], reach_px: int, width_px: int) -> _Strips:
    """Strips around the columns of points that have failed ones, and their neighbours.

    Args:
        grid: the points.
        failed: (nx,) whether a column of points has failed ones.
        reach_px: distance from a point to the side of its strip.
        width_px: width of the images.
    """
    step = grid.step_px
    reach = -(-reach_px // step) * step
    near_failed = np.convolve(failed, np.ones(3), mode="same") > 0
    edges = np.flatnonzero(np.diff(np.concatenate([[0], near_failed.astype(np.int8), [0]]))).reshape(-1, 2)
    merged: list[list[int]] = []
    for first, last in edges.tolist():
        if merged and (first - merged[-1][1] + 1) * step <= 2 * reach + step:
            merged[-1][1] = last
        else:
            merged.append([first, last])
    columns: list[NDArray[np.intp]] = []
    points: list[NDArray[np.intp]] = []
    sides: list[tuple[float, float, int]] = []
    x0_px = at = filled = 0
    for first, last in merged:
        left = max(0, int(grid.x_px[first]) - reach)
        right = min(width_px, int(grid.x_px[last - 1]) + reach)  # the distance from a point to it is a multiple of the step
        columns.append(np.arange(left, right))
        position = at + int(grid.x_px[first]) - left
        if not points:
            x0_px = position
        between = (position - x0_px) // step - filled
        points += [np.full(between, -1), np.arange(first, last)]
        sides.append((-np.inf if left == 0 else at, np.inf if right == width_px else at + right - left - 1, between + last - first))
        filled += between + last - first
        at += right - left
    low, high = (np.repeat([side[k] for side in sides], [side[2] for side in sides]) for k in range(2))
    return _Strips(np.concatenate(columns), x0_px, np.concatenate(points), low, high)


def _selected(attempted: interface.Solutions, points: NDArray[np.intp], parameters: int) -> interface.Solutions:
    """Copy of the solutions of some columns of points; MASKED between strips."""
    status = np.ascontiguousarray(attempted.status[:, points])
    status[:, points < 0] = PoiStatus.MASKED
    values, zncc = (np.ascontiguousarray(array[:, points]) for array in (attempted.parameters, attempted.zncc))
    iterations = np.ascontiguousarray(attempted.iterations[:, points])
    return interface.Solutions(values, zncc, status, iterations, np.zeros((*status.shape, 6)) if parameters == QUARTIC else None)
