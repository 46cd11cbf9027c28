"""Initial guesses of frames of any size."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from semlive.data.grid import Grid
from semlive.dic.bands.image_pair import ImagePair
from semlive.dic.initial_guess.fields import smooth_field
from semlive.dic.initial_guess.search import match, prepare_coarse

MAX_UNDIVIDED_PX = 4096  # edge of frames whose initial guesses are computed at once, not cell by cell
CELL_PX = 2048
CELL_MARGIN_PX = 192
FIELD_MARGIN_PX = 300  # four times the width over which initial guesses are smoothed


def initial_guesses(pair: ImagePair, grid: Grid, search_px: float | None) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return (n, 4) matches of blocks of the frame, and (ny, nx) where the pattern is periodic."""
    height, width = pair.reference.shape
    if max(height, width) <= MAX_UNDIVIDED_PX:
        f, g = pair.grey(slice(None), slice(None))
        coarse = prepare_coarse(f, grid, search_px)
        return match(coarse, g), coarse.ambiguous
    matches, ambiguous = [], np.zeros(grid.shape, dtype=bool)
    for j, rows in cells(grid.y_px, CELL_PX):
        for i, columns in cells(grid.x_px, CELL_PX):
            y0, x0 = (max(0, int(p[0]) - CELL_MARGIN_PX) for p in (grid.y_px[j:rows], grid.x_px[i:columns]))
            y1, x1 = (int(p[-1]) + CELL_MARGIN_PX for p in (grid.y_px[j:rows], grid.x_px[i:columns]))
            f, g = (np.ascontiguousarray(a) for a in pair.grey(slice(y0, min(y1, height)), slice(x0, min(x1, width))))
            cell = dataclasses.replace(
                grid,
                x0_px=int(grid.x_px[i]) - x0,
                y0_px=int(grid.y_px[j]) - y0,
                nx=columns - i,
                ny=rows - j,
            )
            coarse = prepare_coarse(f, cell, search_px)
            matches.append(match(coarse, g) + np.array([x0, y0, 0, 0]))
            ambiguous[j:rows, i:columns] = coarse.ambiguous
    return np.concatenate(matches), ambiguous


def cells(positions: NDArray[np.float64], cell_px: int) -> Iterator[tuple[int, int]]:
    """First and last (exclusive) index of the points of each cell along one axis."""
    edges = np.searchsorted(positions, np.arange(positions[0], positions[-1] + cell_px, cell_px))
    for first, last in itertools.pairwise(edges):
        if last > first:
            yield int(first), int(last)


def local_field(matches: NDArray[np.float64], grid: Grid) -> NDArray[np.float64]:
    """Initial guesses from nearby matches, cell by cell."""
    seeds = np.zeros((*grid.shape, 6))
    in_rows = (matches[:, 1] >= grid.y_px[0] - FIELD_MARGIN_PX) & (matches[:, 1] <= grid.y_px[-1] + FIELD_MARGIN_PX)
    for first, last in cells(grid.x_px, CELL_PX):
        cell = dataclasses.replace(grid, x0_px=int(grid.x_px[first]), nx=last - first)
        near = in_rows & (matches[:, 0] >= cell.x_px[0] - FIELD_MARGIN_PX) & (matches[:, 0] <= cell.x_px[-1] + FIELD_MARGIN_PX)
        selected = matches[near] if near.any() else matches
        if len(selected):
            seeds[:, first:last] = smooth_field(selected, cell)
    return seeds
