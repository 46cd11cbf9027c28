"""Fields of initial guesses at the points of a grid, from matched blocks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from semlive.data.grid import Grid
from semlive.dic.initial_guess.affine_fit import BLOCK_DISTANCE_PX, MIN_INLIERS, design_matrix, robust_affine

FIELD_CELL_PX = 640  # edge of a cell of points whose initial guesses are smoothed from the same matches
FIELD_WIDTHS = 6.0  # at this distance a match weighs 1e-8; without farther ones the cost per point does not depend on the frame


def nearest_block_field(matches: NDArray[np.float64], grid: Grid) -> NDArray[np.float64]:
    """Return (ny, nx, 6) initial guesses: the motion of the nearest block, which is correct on both sides of a discontinuity."""
    x, y = grid.mesh()
    _, nearest = KDTree(matches[:, :2]).query(np.column_stack([x.ravel(), y.ravel()]))
    nearest = np.asarray(nearest).reshape(grid.shape)
    seeds = np.zeros((*grid.shape, 6))
    seeds[:, :, 0] = matches[nearest, 2]
    seeds[:, :, 3] = matches[nearest, 3]
    return seeds


def smooth_field(matches: NDArray[np.float64], grid: Grid) -> NDArray[np.float64]:
    """Return (ny, nx, 6) initial guesses: a robust affine field through the matches, and their smoothed residuals."""
    x, y = matches[:, 0], matches[:, 1]
    motion = matches[:, 2:]
    affine, inliers = robust_affine(x, y, motion)
    residual = motion[inliers] - design_matrix(x[inliers], y[inliers]) @ affine
    seeds = _affine_field(affine, grid)
    cell = max(1, FIELD_CELL_PX // grid.step_px)
    for rows in (slice(first, first + cell) for first in range(0, grid.ny, cell)):
        for columns in (slice(first, first + cell) for first in range(0, grid.nx, cell)):
            smoothed = _smoothed(x[inliers], y[inliers], residual, grid.x_px[columns], grid.y_px[rows])
            seeds[rows, columns, ::3] += smoothed
    return seeds


def residual_affine_field(matches: NDArray[np.float64], grid: Grid) -> NDArray[np.float64] | None:
    """Return (ny, nx, 6) initial guesses: the affine motion of most of the outliers of `smooth_field`; None without agreement.

    Blocks also match features that do not move with the specimen, such as the edge of a blank area.
    """
    _, inliers = robust_affine(matches[:, 0], matches[:, 1], matches[:, 2:])
    rejected = matches[~inliers]
    if len(rejected) < MIN_INLIERS:
        return None
    affine, agreeing = robust_affine(rejected[:, 0], rejected[:, 1], rejected[:, 2:])
    if agreeing.sum() < max(MIN_INLIERS, len(rejected) // 2):
        return None
    return _affine_field(affine, grid)


def _affine_field(affine: NDArray[np.float64], grid: Grid) -> NDArray[np.float64]:
    """Return (ny, nx, 6) parameters of an affine motion with (3, 2) coefficients."""
    field = np.zeros((*grid.shape, 6))
    for axis in range(2):
        c = affine[:, axis]
        field[:, :, 3 * axis] = c[0] + c[1] * grid.x_px[None, :] + c[2] * grid.y_px[:, None]
        field[:, :, 3 * axis + 1] = c[1]
        field[:, :, 3 * axis + 2] = c[2]
    return field


def _smoothed(
    x: NDArray[np.float64], y: NDArray[np.float64], values: NDArray[np.float64], x_px: NDArray[np.float64], y_px: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return (ny, nx, 2) Gaussian-weighted means of (n, 2) values at the crossings of columns and rows."""
    width = 0.7 * BLOCK_DISTANCE_PX
    half_width = FIELD_WIDTHS * width
    near = (x >= x_px[0] - half_width) & (x <= x_px[-1] + half_width) & (y >= y_px[0] - half_width) & (y <= y_px[-1] + half_width)
    gx = np.exp(-0.5 * ((x_px[:, None] - x[near]) / width) ** 2)
    gy = np.exp(-0.5 * ((y_px[:, None] - y[near]) / width) ** 2)
    weight = _product(gy, gx) + 1e-3
    return np.stack([_product(gy * values[near, axis], gx) / weight for axis in range(2)], axis=-1)


def _product(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Product ``a @ b.T`` without BLAS, whose threads stay busy after such a small product (48 ms of processor time for 1 ms)."""
    return np.einsum("ik,jk->ij", a, b)
