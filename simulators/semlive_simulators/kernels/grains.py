"""Grains: Voronoi cells and smooth random fields, evaluated at any point of an infinite plane."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from semlive_simulators.kernels.film import GRAINS, thickness
from semlive_simulators.kernels.pattern import _LOW16, _S16, _S32, _STEP_X, _STEP_Y, _TO_UNIT16, mix64


@njit(cache=True, nogil=True)
def _load_seeds(cell_x, cell_y, seed, seeds):
    """Seeds of the 5 x 5 cells around a cell (one in each), which always contain the two nearest: x, y in cells, offset -1 ... 1."""
    slot = 0
    for row in range(cell_y - 2, cell_y + 3):
        for column in range(cell_x - 2, cell_x + 3):
            bits = mix64(mix64(np.uint64(seed) + np.uint64(column) * _STEP_X) + np.uint64(row) * _STEP_Y)
            seeds[slot, 0] = column + np.float64(bits & _LOW16) * _TO_UNIT16
            seeds[slot, 1] = row + np.float64((bits >> _S16) & _LOW16) * _TO_UNIT16
            seeds[slot, 2] = 2.0 * np.float64((bits >> _S32) & _LOW16) * _TO_UNIT16 - 1.0
            slot += 1


@njit(cache=True, nogil=True)
def grain_grey(x_px, y_px, seed, width_px, length_px, edge_px):
    """Offset of the grain at each point, -1 ... 1; a boundary is a quintic step of half width `edge_px` along x.

    Args:
        x_px: (rows, width) float64 points.
        y_px: likewise.
        seed: seed of the grains.
        width_px: edge of a cell along x.
        length_px: edge of a cell along y.
        edge_px: half width of a boundary.

    Returns:
        (rows, width) float64.
    """
    offsets = np.empty(x_px.shape)
    seeds = np.empty((25, 3))
    edge = edge_px / width_px
    for index in range(x_px.shape[0]):
        cell_x = np.int64(-(2**62))
        cell_y = np.int64(-(2**62))
        for column in range(x_px.shape[1]):
            x = x_px[index, column] / width_px
            y = y_px[index, column] / length_px
            new_x = np.int64(math.floor(x))
            new_y = np.int64(math.floor(y))
            if new_x != cell_x or new_y != cell_y:
                cell_x = new_x
                cell_y = new_y
                _load_seeds(cell_x, cell_y, seed, seeds)
            nearest = 1e300
            second = 1e300
            first_slot = 0
            second_slot = 0
            for slot in range(25):
                dx = x - seeds[slot, 0]
                dy = y - seeds[slot, 1]
                square = dx * dx + dy * dy
                if square < nearest:
                    second = nearest
                    second_slot = first_slot
                    nearest = square
                    first_slot = slot
                elif square < second:
                    second = square
                    second_slot = slot
            distance = math.hypot(seeds[first_slot, 0] - seeds[second_slot, 0], seeds[first_slot, 1] - seeds[second_slot, 1])
            t = min(1.0, 0.5 + (second - nearest) / (4.0 * distance * edge))
            share = t * t * t * (10.0 + t * (6.0 * t - 15.0))
            offsets[index, column] = share * seeds[first_slot, 2] + (1.0 - share) * seeds[second_slot, 2]
    return offsets


@njit(cache=True, nogil=True)
def smooth_field(x_px, y_px, seed, grain_px):
    """The film's `thickness`: a random field of standard deviation 1, (rows, width) float64 for points (rows, width)."""
    field = np.zeros(x_px.shape)
    grains = np.empty((GRAINS, 3))
    box = np.empty(4)
    for index in range(x_px.shape[0]):
        thickness(field[index], x_px[index], y_px[index], seed, grain_px, grains, box)
    return field
