"""Posterior covariance of the field at points, and the part of it that a point's own subset determines."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from semlive.data.grid import Grid
from semlive.dic.global_method import block_tridiagonal
from semlive.dic.global_method.normal_equations import to_fields
from semlive.dic.global_method.solver import Solution

Array = NDArray[np.float64]
Image = NDArray[np.float32]


DRAWS = 256  # of the posterior; a standard uncertainty is then known within 4 %


def field_at(solution: Solution, grid: Grid) -> tuple[Array, Array]:
    """(ny, nx) mean u and v over the subset of each point, px."""
    along_y, along_x = _subset_means(solution, grid)
    u, v = (along_y @ c @ along_x.T for c in solution.field.control_px)
    return u, v


def covariance_at(solution: Solution, grid: Grid) -> Array:
    """(ny, nx, 2, 2) posterior covariance of `field_at`, from DRAWS random fields, px^2."""
    lattice = solution.field.lattice
    along_y, along_x = _subset_means(solution, grid)
    samples = block_tridiagonal.draws(solution.factor, DRAWS)
    out = np.zeros((*grid.shape, 2, 2))
    for k in range(DRAWS):
        u, v = (along_y @ c @ along_x.T for c in to_fields(lattice, samples[:, :, k]))
        out[..., 0, 0] += u * u
        out[..., 0, 1] += u * v
        out[..., 1, 1] += v * v
    out[..., 1, 0] = out[..., 0, 1]
    return out / DRAWS


def own_information(solution: Solution, grid: Grid) -> Array:
    """(ny, nx, 2, 2) information on u and v in the subset of each point alone, 1/px^2."""
    gx, gy = solution.gradient
    w = solution.weight
    sums = {key: subset_sum(w * a * b, grid) for key, a, b in (("xx", gx, gx), ("xy", gx, gy), ("yy", gy, gy))}
    return np.stack([np.stack([sums["xx"], sums["xy"]], -1), np.stack([sums["xy"], sums["yy"]], -1)], -2)


def subset_sum(values: Image, grid: Grid) -> Array:
    """(ny, nx) sum of an image over the subset of each point."""
    size = max(grid.subset_px, 1)
    total = cv2.boxFilter(values, cv2.CV_64F, (size, size), normalize=False, borderType=cv2.BORDER_CONSTANT)
    rows, columns = (np.asarray(axis, dtype=np.intp) for axis in (grid.y_px, grid.x_px))
    return np.asarray(total[np.ix_(rows, columns)], dtype=np.float64)


def neighbour_share(covariance: Array, information: Array) -> Array:
    """(ny, nx) part of a value that comes from neighbours and regularisation: 0, the subset alone; 1, nothing of it.

    The posterior of a point combines its own subset with the rest. The weight of the subset is the mean diagonal of the product of
    posterior covariance and own information.
    """
    own = 0.5 * np.einsum("yxab,yxba->yx", covariance, information)
    return np.clip(1.0 - own, 0.0, 1.0)


def _subset_means(solution: Solution, grid: Grid) -> tuple[Array, Array]:
    """Mean of each spline over the subsets: along y (ny, rows of control points), along x (nx, columns of control points)."""
    lattice, half = solution.field.lattice, max(grid.subset_px, 1) // 2

    def means(splines: Array, centres: Array) -> Array:
        total = np.vstack([np.zeros(splines.shape[1]), np.cumsum(splines, axis=0)])
        at = centres.astype(np.intp)
        first, last = np.maximum(at - half, 0), np.minimum(at + half + 1, len(splines))
        return (total[last] - total[first]) / (last - first)[:, None]

    return means(lattice.rows, grid.y_px), means(lattice.columns, grid.x_px)
