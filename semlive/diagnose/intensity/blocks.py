"""Blocks of the specimen, each followed through all frames: where they lie, and what a frame shows in them, shifted back to frame 0."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap
from semlive.data.grid import Grid

Array = NDArray[np.float64]
Grey = NDArray[np.floating]
Spectra = NDArray[np.complexfloating]
LEAST_POINTS = 6
STEEPEST = 0.5  # of what the spread of displacements within a block may have taken from a wave, as a logarithm
_SPREAD = 1.0 / 12.0 - 1.0 / (2.0 * np.pi**2)  # variance of a position under the window, in squares of its width


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Squares of frame 0 that points of the maps cover.

    Attributes:
        edge_px: of each.
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
    """Where the blocks are in a frame, x_current = x + shift + gradient (x - middle).

    Attributes:
        shift_px: (b, 2) of each block's middle along x and y.
        gradient: (b, 2, 2) d(u, v) / d(x, y).
        known: (b,) where enough points were measured.
    """

    shift_px: Array
    gradient: Array
    measured: NDArray[np.bool_]


def blocks_of(grid: Grid) -> Blocks:
    """Blocks half again as large as a subset, side by side over what the points' subsets cover."""
    edge = max(16, 8 * round(1.5 * grid.subset_px / 8))
    half = grid.subset_px // 2
    starts = []
    for first, count in ((grid.x0_px, grid.nx), (grid.y0_px, grid.ny)):
        begin, length = first - half, (count - 1) * grid.step_px + 2 * half + 1
        fit = length // edge
        starts.append(begin + (length - fit * edge) // 2 + edge * np.arange(fit))
    y, x = (coordinates.ravel() for coordinates in np.meshgrid(starts[1], starts[0], indexing="ij"))
    column, row = (coordinates.ravel() for coordinates in grid.mesh())
    near = 0.5 * grid.step_px
    inside = (
        (column >= x[:, None] - near) & (column < x[:, None] + edge + near) & (row >= y[:, None] - near) & (row < y[:, None] + edge + near)
    )
    return Blocks(edge, x, y, inside.astype(np.float64), grid)


def reference_positions(blocks: Blocks) -> BlockPositions:
    """Of frame 0 itself."""
    count = len(blocks.x_px)
    return BlockPositions(np.zeros((count, 2)), np.zeros((count, 2, 2)), np.ones(count, dtype=np.bool_))


def block_positions(blocks: Blocks, disparity: DisparityMap, shape: tuple[int, int]) -> BlockPositions:
    """A plane through the displacements of each block's points.

    Args:
        blocks: of frame 0.
        disparity: from frame 0.
        shape: height and width of the frame; a block that is not wholly in it is not known.
    """
    middle = np.array([blocks.grid.x_px.mean(), blocks.grid.y_px.mean()])
    scale = float(blocks.edge_px)
    column, row = (coordinates.ravel() for coordinates in blocks.grid.mesh())
    valid = disparity.valid.ravel().astype(np.float64)
    basis = np.stack([np.ones_like(column), (column - middle[0]) / scale, (row - middle[1]) / scale], axis=-1)
    products = (basis[:, :, None] * basis[:, None, :]).reshape(-1, 9) * valid[:, None]
    values = np.stack([disparity.u_px.ravel(), disparity.v_px.ravel()], axis=-1) * valid[:, None]
    sides = (basis[:, :, None] * values[:, None, :]).reshape(-1, 6)
    sums = blocks.inside @ np.concatenate([products, sides], axis=-1)
    normal, side = sums[:, :9].reshape(-1, 3, 3), sums[:, 9:].reshape(-1, 3, 2)
    count = blocks.inside.sum(axis=-1)
    used = (normal[:, 0, 0] >= LEAST_POINTS) & (normal[:, 0, 0] >= 0.6 * count)
    plane = np.linalg.solve(np.where(used[:, None, None], normal, np.eye(3)) + 1e-9 * np.eye(3), side)
    centre = (np.stack([blocks.x_px, blocks.y_px], axis=-1) + 0.5 * (blocks.edge_px - 1) - middle) / scale
    shift_px = plane[:, 0] + centre[:, :1] * plane[:, 1] + centre[:, 1:] * plane[:, 2]
    corner = np.stack([blocks.x_px, blocks.y_px], axis=-1) + np.round(shift_px)
    room = np.array([shape[1], shape[0]]) - blocks.edge_px
    used &= np.all((corner >= 0) & (corner <= room), axis=-1)
    return BlockPositions(shift_px, np.asarray(np.swapaxes(plane[:, 1:], 1, 2) / scale, dtype=np.float64), used)


def gather_blocks(image: Grey, blocks: Blocks, places: BlockPositions) -> Grey:
    """(b, edge, edge) the nearest whole pixels of each block; zeros where it is not known."""
    full = np.where(places.measured[:, None], np.round(places.shift_px), 0.0).astype(np.int64)
    along = np.arange(blocks.edge_px)
    rows = np.clip((blocks.y_px + full[:, 1])[:, None] + along, 0, image.shape[0] - 1)
    columns = np.clip((blocks.x_px + full[:, 0])[:, None] + along, 0, image.shape[1] - 1)
    return image[rows[:, :, None], columns[:, None, :]]


def window(blocks: Blocks, places: BlockPositions) -> Grey:
    """(b, edge, edge) raised cosine about each block's middle, which goes along with the specimen to a fraction of a pixel."""
    over = (places.shift_px - np.round(places.shift_px))[:, :, None]
    phase = 2.0 * np.pi * (np.arange(blocks.edge_px) + 0.5 - over) / blocks.edge_px
    sides = (0.5 - 0.5 * np.cos(phase)).astype(np.float32)
    return np.asarray(sides[:, 1, :, None] * sides[:, 0, None, :], dtype=np.float32)


def aligned_spectra(values: Grey, blocks: Blocks, places: BlockPositions) -> Spectra:
    """(b, edge, edge // 2 + 1) spectra of windowed blocks, shifted back by what is left of the displacement.

    Displacements that differ within a block blur what it shows on average, as a Gaussian of their covariance would; that is taken back.
    """
    spectrum = np.fft.rfft2(values * window(blocks, places)).astype(np.complex64)
    down, along = (wave.astype(np.float32) for wave in blocks.waves)
    over = (places.shift_px - np.round(places.shift_px)).astype(np.float32)
    turn_y, turn_x = np.exp(1j * over[:, 1, None] * down), np.exp(1j * over[:, 0, None] * along)
    spread = _SPREAD * blocks.edge_px**2 * np.einsum("bij,bkj->bik", places.gradient, places.gradient)
    xx, xy, yy = (0.5 * spread[:, i, j, None].astype(np.float32) for i, j in ((0, 0), (0, 1), (1, 1)))
    lost = (xx * along**2)[:, None, :] + (yy * down**2)[:, :, None] + (2.0 * xy * down)[:, :, None] * along
    return np.asarray(spectrum * turn_y[:, :, None] * turn_x[:, None, :] * np.exp(np.minimum(lost, STEEPEST)), dtype=np.complex64)
