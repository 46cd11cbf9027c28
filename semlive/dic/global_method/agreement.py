"""Independent checks of a solved field: two band-passes, and forward against backward."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from semlive.data.grid import Grid
from semlive.dic.global_method.coarse import AGREEMENT_PX, COARSE, FINE, peak_of
from semlive.dic.global_method.filters import band_pass, smoothed
from semlive.dic.global_method.solver import Field
from semlive.kernels import images
from semlive.kernels.splines.spline_sampling import sample

Array = NDArray[np.float64]
Image = NDArray[np.float32]

REACH_PX = 8  # largest offset at which a block is searched in the displaced frame
BLOCK_PX = 33
STEP_PX = 8
BLOCKS_ALONG = 96  # largest number of blocks along the longer edge


def support(f: Image, g: Image, field: Field, grid: Grid) -> tuple[Array, Array]:
    """Fraction of the blocks around each point that are found where the field predicts them, in each of two band-passes.

    The current frame is displaced by the field; each block is searched within REACH_PX around the prediction.

    Args:
        f: (height, width) reference, without row offsets.
        g: (height, width) current frame, without row offsets.
        field: displacement.
        grid: points.

    Returns:
        (2, ny, nx) fraction of the blocks within about half a subset for the fine and the coarse band-pass; (ny, nx) 1 where blocks lie in
        both frames around the point, else less.
    """
    (height, width), edge = f.shape, BLOCK_PX // 2 + REACH_PX + 1
    step = max(STEP_PX, -(-max(f.shape) // BLOCKS_ALONG))
    ys, xs = np.arange(edge, height - edge, step), np.arange(edge, width - edge, step)
    if len(ys) < 2 or len(xs) < 2:
        return np.zeros((2, *grid.shape)), np.zeros(grid.shape)
    u, v = field.displacement(rows=True)
    at_x = np.ascontiguousarray(np.arange(width) + u, dtype=np.float32)
    at_y = np.ascontiguousarray(np.arange(height)[:, None] + v, dtype=np.float32)
    confirmed, searched = np.zeros((2, len(ys), len(xs)), dtype=np.float32), np.zeros((len(ys), len(xs)), dtype=np.float32)
    for k, band in enumerate((FINE, COARSE)):
        a = band_pass(f, band)
        b, _, _, inside = sample(images.coefficients(band_pass(g, band)), at_x, at_y)
        for j, y in enumerate(ys):
            for i, x in enumerate(xs):
                outer = np.s_[y - edge + 1 : y + edge, x - edge + 1 : x + edge]
                if not inside[outer].all():
                    continue
                searched[j, i] = 1.0
                block = np.s_[y - BLOCK_PX // 2 : y + BLOCK_PX // 2 + 1, x - BLOCK_PX // 2 : x + BLOCK_PX // 2 + 1]
                at = peak_of(b[outer], a[block])
                confirmed[k, j, i] = at is not None and np.hypot(at[0] - REACH_PX, at[1] - REACH_PX) <= AGREEMENT_PX
    sd = max(0.25 * grid.subset_px / step, 0.5)
    weight = smoothed(searched, sd, cv2.BORDER_CONSTANT)
    rows, columns = np.clip(grid.y_px, ys[0], ys[-1]), np.clip(grid.x_px, xs[0], xs[-1])
    mesh = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1)

    def at_points(values: NDArray) -> Array:
        return np.asarray(RegularGridInterpolator((ys, xs), values.astype(np.float64))(mesh), dtype=np.float64)

    share = np.stack([at_points(smoothed(part * searched, sd, cv2.BORDER_CONSTANT) / np.maximum(weight, 1e-6)) for part in confirmed])
    return share, at_points((weight > 1e-3).astype(np.float32))


def round_trip(forward: Field, backward: Field, grid: Grid) -> Array:
    """(ny, nx) distance in px between each point and its position after displacement forward and backward."""
    shape = forward.lattice.shape
    axes = (np.arange(shape[0], dtype=np.float64), np.arange(shape[1], dtype=np.float64))
    x, y = grid.mesh()
    points = np.stack([y, x], axis=-1).astype(np.float64)
    u, v = (np.asarray(RegularGridInterpolator(axes, values)(points)) for values in forward.displacement())
    there = np.stack([np.clip(y + v, 0, shape[0] - 1), np.clip(x + u, 0, shape[1] - 1)], axis=-1)
    back_u, back_v = (np.asarray(RegularGridInterpolator(axes, values)(there)) for values in backward.displacement())
    return np.hypot(u + back_u, v + back_v)
