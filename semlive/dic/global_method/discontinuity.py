"""Discontinuities that a smooth field bridges: steps in the residual, and steps in the field itself.

- With a stiff field, the residual at a crack corresponds to opposite displacements on both sides. On both halves of a disc, this
  displacement and its covariance follow from the weighted normal equations of one shift; the disc is divided along four directions. With a
  field that describes the pair, the squared difference over its covariance is a chi-square variable of two degrees of freedom.
- A flexible field turns the jump into a steep slope over about a subset. The difference of the displacement across the subset then exceeds
  what the slopes on both sides explain.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from semlive.data.grid import Grid
from semlive.dic.global_method.solver import Solution

Array = NDArray[np.float64]
Image = NDArray[np.float32]

CELL_PX = 4  # sums are formed in cells first
RADIUS_CELLS = 7  # of the disc: 28 px, about the length over which the field bends
DIRECTIONS = 4
MIN_FULL = 0.6  # fraction of a half of the disc that both frames show
MIN_STEP_PX = 0.4  # smaller differences cause no wrong point
CERTAIN, POSSIBLE = 16.0, 8.0  # chi-square of the difference: at most 12 in 8 rendered rasters without a step, 21 to 60 at cracks
# Possible cells belong to a discontinuity if they are connected to a certain one.
MAX_STEP_PX = 1.0  # of the field across a subset beyond the slopes around it; half of it is the error at the line
STEP_SIGMAS = 8.0  # a step contains the noise of values half a subset and one subset away
STEP_FRACTION = 0.5  # of the largest step within a subset: the slope next to a large step is no step of its own
ONE_SIDED = 1.5  # a jump J in the middle of a subset has the slope 1.5 J / edge


def discontinuous(solution: Solution, grid: Grid, sigma: Array) -> NDArray[np.bool_]:
    """(ny, nx) whether the subset of a point reaches a discontinuity that the field bridges.

    Args:
        solution: of the global method.
        grid: points.
        sigma: (ny, nx) standard uncertainty of their displacement, px.
    """
    gx, gy = solution.gradient
    w, r = solution.weight, solution.residual
    sums = [_cells(values) for values in (w * gx * gx, w * gx * gy, w * gy * gy, -w * gx * r, -w * gy * r)]
    shown = _cells(solution.used) / CELL_PX**2
    chi_square = np.zeros(shown.shape)
    for first, second in _halves():
        full = np.minimum(*(_filtered(shown, half) / half.sum() for half in (first, second)))
        chi_square = np.maximum(chi_square, np.where(full >= MIN_FULL, _difference(sums, first, second), 0.0))
    marked = np.zeros(shown.shape, dtype=np.int32)
    ndimage.label(chi_square > POSSIBLE, np.ones((3, 3), dtype=int), output=marked)
    certain = np.unique(marked[chi_square > CERTAIN])
    reach = max(1, round(0.5 * grid.subset_px / CELL_PX))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    found = cv2.dilate(np.isin(marked, certain[certain > 0]).astype(np.uint8), disc)
    rows, columns = (
        np.clip(np.rint((axis - 0.5 * (CELL_PX - 1)) / CELL_PX).astype(np.intp), 0, n - 1)
        for axis, n in zip((grid.y_px, grid.x_px), found.shape, strict=True)
    )
    step = _field_step(solution, grid)
    around = ndimage.maximum_filter(step, 2 * round(grid.subset_px / grid.step_px) + 1)
    return np.asarray(found[np.ix_(rows, columns)] > 0) | (
        step > np.maximum.reduce([STEP_FRACTION * around, STEP_SIGMAS * sigma, np.full(grid.shape, MAX_STEP_PX)])
    )


def _field_step(solution: Solution, grid: Grid) -> Array:
    """(ny, nx) step of the field across the subset beyond the slopes one subset away on both sides, px; zero near the border.

    Along y the displacement that is common to a row is left out: rows of a raster jump without a crack.
    """
    whole, edge, half = np.stack(solution.field.displacement()), grid.subset_px, grid.subset_px // 2
    out = np.zeros(whole.shape[1:])
    for axis, field in ((1, whole - np.median(whole, axis=2, keepdims=True)), (2, whole)):
        count = field.shape[axis]
        if count <= 2 * edge:
            continue
        slope = np.gradient(field, axis=axis)

        def at(values: Array, offset: int, axis: int = axis, count: int = count) -> Array:
            return np.take(values, range(edge + offset, count - edge + offset), axis)

        before, here, after = (at(slope, offset) for offset in (-edge, 0, edge))
        step = np.hypot(*(at(field, half) - at(field, -half) - (before + after) * half))
        for side in (before, after):
            step = np.minimum(step, np.hypot(*(here - side)) * (edge / ONE_SIDED))
        inner = np.s_[edge : count - edge, :] if axis == 1 else np.s_[:, edge : count - edge]
        out[inner] = np.maximum(out[inner], step)
    rows, columns = (axis.astype(np.intp) for axis in (grid.y_px, grid.x_px))
    return out[np.ix_(rows, columns)]


def _cells(values: Image) -> Array:
    """Sums over cells of CELL_PX; the remainder at the right and the bottom is left out."""
    height, width = (n // CELL_PX for n in values.shape)
    inner = values[: height * CELL_PX, : width * CELL_PX].astype(np.float64)
    return np.asarray(cv2.resize(inner, (width, height), interpolation=cv2.INTER_AREA) * CELL_PX**2, dtype=np.float64)


def _halves() -> Iterator[tuple[Array, Array]]:
    """Both halves of the disc, divided along each direction."""
    n = np.arange(-RADIUS_CELLS, RADIUS_CELLS + 1, dtype=np.float64)
    disc = np.hypot(n, n[:, None]) <= RADIUS_CELLS + 0.3
    for k in range(DIRECTIONS):
        angle = np.pi * k / DIRECTIONS
        across = n * np.cos(angle) + n[:, None] * np.sin(angle)
        yield (disc & (across > 0.3)).astype(np.float64), (disc & (across < -0.3)).astype(np.float64)


def _filtered(values: Array, kernel: Array) -> Array:
    return np.asarray(cv2.filter2D(values, cv2.CV_64F, kernel, borderType=cv2.BORDER_CONSTANT), dtype=np.float64)


def _difference(sums: list[Array], first: Array, second: Array) -> Array:
    """Chi-square of the difference of the displacements of both halves, zero where it is below MIN_STEP_PX."""
    step, covariance = np.zeros((2, *sums[0].shape)), np.zeros((3, *sums[0].shape))
    for half, sign in ((first, 1.0), (second, -1.0)):
        xx, xy, yy, right_x, right_y = (_filtered(values, half) for values in sums)
        determinant = np.maximum(xx * yy - xy * xy, 1e-9 * np.maximum(xx * yy, 1e-30))
        step += sign * np.stack([yy * right_x - xy * right_y, xx * right_y - xy * right_x]) / determinant
        covariance += np.stack([yy, -xy, xx]) / determinant
    xx, xy, yy = covariance
    determinant = np.maximum(xx * yy - xy * xy, 1e-9 * np.maximum(xx * yy, 1e-30))
    chi_square = (yy * step[0] ** 2 - 2.0 * xy * step[0] * step[1] + xx * step[1] ** 2) / determinant
    return np.asarray(np.where(np.hypot(step[0], step[1]) >= MIN_STEP_PX, chi_square, 0.0), dtype=np.float64)
