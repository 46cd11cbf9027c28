"""Blocks of the specimen tracked through all frames: their positions, and their pixels aligned with frame 0."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap
from semlive.data.grid import Grid

Array = NDArray[np.float64]
Grey = NDArray[np.floating]
Spectra = NDArray[np.complexfloating]
MIN_POINTS = 6
MAX_LOG_CORRECTION = 0.5  # largest correction, as a logarithm, for the attenuation of a wave by displacements within a block
_SPREAD = 1.0 / 12.0 - 1.0 / (2.0 * np.pi**2)  # variance of a position under the window, in squares of its width


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Square blocks of frame 0 covered by points of the maps.

    Attributes:
        edge_px: edge of each block.
        x_px: (b,) first columns.
        y_px: (b,) first rows.
        inside: (b, points) 1 where a point of the grid lies in the block.
        grid: the points.
    """

    edge_px: int
    x_px: NDArray[np.int64]
    y_px: NDArray[np.int64]
    inside: Array
    grid: Grid

    @property
    def waves(self) -> tuple[Array, Array]:
        """Angular frequencies along y (edge,) and x (edge // 2 + 1,), radians per px."""
        n = self.edge_px
        down, along = (np.asarray(2.0 * np.pi * value, dtype=np.float64) for value in (np.fft.fftfreq(n), np.fft.rfftfreq(n)))
        return down, along


@dataclass(frozen=True, slots=True, eq=False)
class BlockPositions:
    """Positions of the blocks in a frame, x_current = x + shift + gradient (x - middle).

    Attributes:
        shift_px: (b, 2) shift of the middle of each block along x and y.
        gradient: (b, 2, 2) d(u, v) / d(x, y).
        measured: (b,) whether enough points of the block were measured.
    """

    shift_px: Array
    gradient: Array
    measured: NDArray[np.bool_]


def blocks_of(grid: Grid) -> Blocks:
    """Adjacent blocks, 1.5 times as large as a subset, over the area of all subsets."""
    edge = max(16, 8 * round(1.5 * grid.subset_px / 8))
    half = grid.subset_px // 2
    starts = []
    for first, count in ((grid.x0_px, grid.nx), (grid.y0_px, grid.ny)):
        begin, length = first - half, (count - 1) * grid.step_px + 2 * half + 1
        fit = length // edge
        starts.append(begin + (length - fit * edge) // 2 + edge * np.arange(fit))
    y, x = (coordinates.ravel() for coordinates in np.meshgrid(starts[1], starts[0], indexing="ij"))
    column, row = (coordinates.ravel() for coordinates in grid.mesh())
    tolerance_px = 0.5 * grid.step_px
    inside = (
        (column >= x[:, None] - tolerance_px)
        & (column < x[:, None] + edge + tolerance_px)
        & (row >= y[:, None] - tolerance_px)
        & (row < y[:, None] + edge + tolerance_px)
    )
    return Blocks(edge, x, y, inside.astype(np.float64), grid)


def reference_positions(blocks: Blocks) -> BlockPositions:
    """Positions in frame 0."""
    count = len(blocks.x_px)
    return BlockPositions(np.zeros((count, 2)), np.zeros((count, 2, 2)), np.ones(count, dtype=np.bool_))


def block_positions(blocks: Blocks, disparity: DisparityMap, shape: tuple[int, int]) -> BlockPositions:
    """Positions from a plane fitted to the displacements of the points of each block.

    Args:
        blocks: blocks of frame 0.
        disparity: map from frame 0.
        shape: height and width of the frame; a block that extends beyond it is not measured.
    """
    middle = np.array([blocks.grid.x_px.mean(), blocks.grid.y_px.mean()])
    scale = float(blocks.edge_px)
    column, row = (coordinates.ravel() for coordinates in blocks.grid.mesh())
    valid = disparity.valid.ravel().astype(np.float64)
    basis = np.stack([np.ones_like(column), (column - middle[0]) / scale, (row - middle[1]) / scale], axis=-1)
    products = (basis[:, :, None] * basis[:, None, :]).reshape(-1, 9) * valid[:, None]
    values = np.stack([disparity.u_px.ravel(), disparity.v_px.ravel()], axis=-1) * valid[:, None]
    edges = (basis[:, :, None] * values[:, None, :]).reshape(-1, 6)
    sums = blocks.inside @ np.concatenate([products, edges], axis=-1)
    normal, side = sums[:, :9].reshape(-1, 3, 3), sums[:, 9:].reshape(-1, 3, 2)
    count = blocks.inside.sum(axis=-1)
    used = (normal[:, 0, 0] >= MIN_POINTS) & (normal[:, 0, 0] >= 0.6 * count)
    plane = np.linalg.solve(np.where(used[:, None, None], normal, np.eye(3)) + 1e-9 * np.eye(3), side)
    centre = (np.stack([blocks.x_px, blocks.y_px], axis=-1) + 0.5 * (blocks.edge_px - 1) - middle) / scale
    shift_px = plane[:, 0] + centre[:, :1] * plane[:, 1] + centre[:, 1:] * plane[:, 2]
    corner = np.stack([blocks.x_px, blocks.y_px], axis=-1) + np.round(shift_px)
    largest_corner_px = np.array([shape[1], shape[0]]) - blocks.edge_px
    used &= np.all((corner >= 0) & (corner <= largest_corner_px), axis=-1)
    return BlockPositions(shift_px, np.asarray(np.swapaxes(plane[:, 1:], 1, 2) / scale, dtype=np.float64), used)


def gather_blocks(image: Grey, blocks: Blocks, positions: BlockPositions) -> Grey:
    """(b, edge, edge) pixels of each block, with its position rounded to integers; unmeasured blocks at their position in frame 0."""
    shift_px = np.where(positions.measured[:, None], np.round(positions.shift_px), 0.0).astype(np.int64)
    along = np.arange(blocks.edge_px)
    rows = np.clip((blocks.y_px + shift_px[:, 1])[:, None] + along, 0, image.shape[0] - 1)
    columns = np.clip((blocks.x_px + shift_px[:, 0])[:, None] + along, 0, image.shape[1] - 1)
    return image[rows[:, :, None], columns[:, None, :]]


def window(blocks: Blocks, positions: BlockPositions) -> Grey:
    """(b, edge, edge) raised cosine centred on each block with its subpixel position."""
    remainder_px = (positions.shift_px - np.round(positions.shift_px))[:, :, None]
    phase = 2.0 * np.pi * (np.arange(blocks.edge_px) + 0.5 - remainder_px) / blocks.edge_px
    edges = (0.5 - 0.5 * np.cos(phase)).astype(np.float32)
    return np.asarray(edges[:, 1, :, None] * edges[:, 0, None, :], dtype=np.float32)


def aligned_spectra(values: Grey, blocks: Blocks, positions: BlockPositions) -> Spectra:
    """(b, edge, edge // 2 + 1) spectra of windowed blocks, shifted back by the subpixel remainder of the displacement.

    Different displacements within a block blur it like a Gaussian with their covariance; the spectra are corrected for this attenuation.
    """
    spectrum = np.fft.rfft2(values * window(blocks, positions)).astype(np.complex64)
    down, along = (wave.astype(np.float32) for wave in blocks.waves)
    remainder_px = (positions.shift_px - np.round(positions.shift_px)).astype(np.float32)
    turn_y, turn_x = np.exp(1j * remainder_px[:, 1, None] * down), np.exp(1j * remainder_px[:, 0, None] * along)
    spread = _SPREAD * blocks.edge_px**2 * np.einsum("bij,bkj->bik", positions.gradient, positions.gradient)
    xx, xy, yy = (0.5 * spread[:, i, j, None].astype(np.float32) for i, j in ((0, 0), (0, 1), (1, 1)))
    log_attenuation = (xx * along**2)[:, None, :] + (yy * down**2)[:, :, None] + (2.0 * xy * down)[:, :, None] * along
    return np.asarray(
        spectrum * turn_y[:, :, None] * turn_x[:, None, :] * np.exp(np.minimum(log_attenuation, MAX_LOG_CORRECTION)), dtype=np.complex64
    )
