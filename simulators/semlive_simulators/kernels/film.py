"""A gold film rearranged into islands: a random thickness with a soft threshold, evaluated at any point of an infinite plane."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from semlive_simulators.kernels.pattern import _LOW16, _S16, _S32, _STEP_X, _STEP_Y, _TO_UNIT16, mix64

PER_CELL = 2
GRAINS = 9 * PER_CELL
_SD = math.sqrt(PER_CELL * math.pi / 9.0)
"""Standard deviation of the thickness with bumps of unit variance; (1 - q)^4 squared has the integral pi / 9 over a
bump of radius 1 (cells of edge 1)."""


@njit(cache=True, nogil=True)
def load_grains(cell_x, cell_y, seed, grain_px, grains):
    """The bumps of the 3 x 3 cells around a cell.

    Args:
        cell_x: column of the middle cell.
        cell_y: row of the middle cell.
        seed: seed of the pattern.
        grain_px: edge of a cell, radius of a bump.
        grains: (GRAINS, 3) float64, filled with centre x, centre y, height.
    """
    slot = 0
    for row in range(cell_y - 1, cell_y + 2):
        for column in range(cell_x - 1, cell_x + 2):
            bits = mix64(mix64(np.uint64(seed) + np.uint64(column) * _STEP_X) + np.uint64(row) * _STEP_Y)
            for _ in range(PER_CELL):
                bits = mix64(bits + _STEP_Y)
                grains[slot, 0] = (column + np.float64(bits & _LOW16) * _TO_UNIT16) * grain_px
                grains[slot, 1] = (row + np.float64((bits >> _S16) & _LOW16) * _TO_UNIT16) * grain_px
                grains[slot, 2] = math.sqrt(3.0) * (2.0 * np.float64((bits >> _S32) & _LOW16) * _TO_UNIT16 - 1.0) / _SD
                slot += 1


@njit(cache=True, nogil=True)
def shared_cell(xs, ys, begin, cell_px, box):
    """End of the points (n,) from `begin` on that are in one cell; their smallest and largest x, then y, are written to `box`."""
    corner_x = math.floor(xs[begin] / cell_px) * cell_px
    corner_y = math.floor(ys[begin] / cell_px) * cell_px
    min_x = max_x = xs[begin]
    min_y = max_y = ys[begin]
    end = begin + 1
    while end < xs.size:
        x = xs[end]
        y = ys[end]
        if x < corner_x or x >= corner_x + cell_px or y < corner_y or y >= corner_y + cell_px:
            break
        min_x = min(min_x, x)
        max_x = max(max_x, x)
        min_y = min(min_y, y)
        max_y = max(max_y, y)
        end += 1
    box[0], box[1], box[2], box[3] = min_x, max_x, min_y, max_y
    return end


@njit(cache=True, nogil=True)
def reaches(x, y, radius, box):
    """Whether a disc overlaps a box."""
    distance_x = max(0.0, box[0] - x, x - box[1])
    distance_y = max(0.0, box[2] - y, y - box[3])
    return distance_x * distance_x + distance_y * distance_y < radius * radius


@njit(cache=True, nogil=True)
def add_bump(values, xs, ys, centre_x, centre_y, height, scale):
    """Add height (1 - r^2 scale)^4 to values at points (n,), without a branch, so that the loop is vectorised."""
    for column in range(values.size):
        dx = xs[column] - centre_x
        dy = ys[column] - centre_y
        base = 1.0 - (dx * dx + dy * dy) * scale
        base = 0.5 * (base + abs(base))
        square = base * base
        values[column] += height * square * square


@njit(cache=True, nogil=True)
def thickness(values, xs, ys, seed, grain_px, grains, box):
    """Add the film's thickness at points (n,) of a row to values.

    The thickness is a sum of bumps (1 - r^2 / R^2)^4 of random position and sign (sparse convolution, Lewis 1989,
    doi:10.1145/74334.74360): no lattice, no period, three times differentiable, standard deviation 1 everywhere. All points of one
    cell are computed together, without the bumps that do not overlap them.

    Args:
        values: (n,) float64, added to.
        xs: (n,) float64 points.
        ys: likewise.
        seed: seed of the pattern.
        grain_px: edge of a cell, radius of a bump.
        grains: (GRAINS, 3) float64, scratch.
        box: (4,) float64, scratch.
    """
    scale = 1.0 / (grain_px * grain_px)
    begin = 0
    while begin < xs.size:
        end = shared_cell(xs, ys, begin, grain_px, box)
        load_grains(np.int64(math.floor(xs[begin] / grain_px)), np.int64(math.floor(ys[begin] / grain_px)), seed, grain_px, grains)
        for slot in range(GRAINS):
            if reaches(grains[slot, 0], grains[slot, 1], grain_px, box):
                part = xs[begin:end], ys[begin:end]
                add_bump(values[begin:end], *part, grains[slot, 0], grains[slot, 1], grains[slot, 2], scale)
        begin = end


@njit(cache=True, nogil=True)
def cut_off(values, level, softness):
    """Convert thickness (n,) to gold, 0 to 1, in place: a quintic step of half width `softness` at `level`."""
    for column in range(values.size):
        t = 0.5 + (values[column] - level) / (2.0 * softness)
        t = min(1.0, max(0.0, t))
        values[column] = t * t * t * (10.0 + t * (6.0 * t - 15.0))
