"""A gold film rearranged into islands: a random thickness, cut off softly, evaluated at any point of an infinite plane."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from semlive_simulators.kernels.pattern import _LOW16, _S16, _S32, _STEP_X, _STEP_Y, _TO_UNIT16, mix64

PER_CELL = 2
GRAINS = 9 * PER_CELL
_SD = math.sqrt(PER_CELL * math.pi / 9.0)
"""Of the thickness: bumps of unit variance, (1 - q)^4 squared has the integral pi / 9 over a bump of radius 1 (cells of edge 1)."""


@njit(cache=True, nogil=True)
def load_grains(cell_x, cell_y, seed, grain_px, grains):
    """The bumps of the 3 x 3 cells around a cell.

    Args:
        cell_x: column of the middle cell.
        cell_y: row of the middle cell.
        seed: of the pattern.
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


@njit(cache=True, nogil=True, inline="always")
def film_coverage(x, y, grains, grain_px, level, softness):
    """How much gold is seen at a point, 0 to 1, given the bumps around it.

    The thickness is a sum of bumps (1 - r^2 / R^2)^4 of random place and sign (sparse convolution, Lewis 1989,
    doi:10.1145/74334.74360): no lattice, no period, three times differentiable, standard deviation 1 everywhere. What is
    thicker than `level` is gold; a quintic step of half width `softness` leads there.
    """
    thickness = 0.0
    scale = 1.0 / (grain_px * grain_px)
    for slot in range(GRAINS):
        dx = x - grains[slot, 0]
        dy = y - grains[slot, 1]
        left = 1.0 - (dx * dx + dy * dy) * scale
        if left > 0.0:
            square = left * left
            thickness += grains[slot, 2] * square * square
    t = 0.5 + (thickness - level) / (2.0 * softness)
    t = min(1.0, max(0.0, t))
    return t * t * t * (10.0 + t * (6.0 * t - 15.0))
