"""Speckle of gold dots, evaluated at any point of an infinite plane (no image is warped)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_STEP_X = np.uint64(0x9E3779B97F4A7C15)
_STEP_Y = np.uint64(0xC2B2AE3D27D4EB4F)
_S27 = np.uint64(27)
_S30 = np.uint64(30)
_S31 = np.uint64(31)
_S11 = np.uint64(11)
_S16 = np.uint64(16)
_S32 = np.uint64(32)
_S48 = np.uint64(48)
_LOW16 = np.uint64(0xFFFF)
_TO_UNIT16 = 1.0 / 65536.0
_TO_UNIT53 = 1.0 / 9007199254740992.0


@njit(cache=True, nogil=True, inline="always")
def mix64(z):
    """The finaliser of splitmix64 (Steele, Lea & Flood 2014, doi:10.1145/2660193.2660195): 64 bits in, 64 scrambled bits out."""
    z = (z ^ (z >> _S30)) * _MIX_1
    z = (z ^ (z >> _S27)) * _MIX_2
    return z ^ (z >> _S31)


@njit(cache=True, nogil=True)
def gaussian_pair(key):
    """Two independent standard normal numbers from a 64 bit key (Box & Muller 1958)."""
    first = mix64(key)
    second = mix64(key ^ _STEP_Y)
    radius = math.sqrt(-2.0 * math.log((np.float64(first >> _S11) + 1.0) * _TO_UNIT53))
    angle = 2.0 * math.pi * np.float64(second >> _S11) * _TO_UNIT53
    return radius * math.cos(angle), radius * math.sin(angle)


@njit(cache=True, nogil=True)
def gaussian(seed, stream, number):
    """One standard normal number, a pure function of three integers."""
    key = mix64(mix64(np.uint64(seed) * _STEP_X + np.uint64(stream)) + np.uint64(number) * _STEP_Y)
    return gaussian_pair(key)[0]


@njit(cache=True, nogil=True)
def load_dots(cell_x, cell_y, seed, pitch_px, radius_px, radius_spread, presence, dots):
    """The dots of the 3 x 3 cells around a cell.

    Args:
        cell_x: column of the middle cell.
        cell_y: row of the middle cell.
        seed: seed of the pattern.
        pitch_px: edge of a cell.
        radius_px: mean radius of a dot.
        radius_spread: half range of the radius as a fraction of it.
        presence: probability of a dot in a cell.
        dots: (9, 4) float64, filled with centre x, centre y, radius (-1 without a dot), brightness.
    """
    slot = 0
    for row in range(cell_y - 1, cell_y + 2):
        for column in range(cell_x - 1, cell_x + 2):
            bits = mix64(mix64(np.uint64(seed) + np.uint64(column) * _STEP_X) + np.uint64(row) * _STEP_Y)
            u = np.float64(bits >> _S48) * _TO_UNIT16
            dots[slot, 0] = (column + np.float64(bits & _LOW16) * _TO_UNIT16) * pitch_px
            dots[slot, 1] = (row + np.float64((bits >> _S16) & _LOW16) * _TO_UNIT16) * pitch_px
            spread = 2.0 * np.float64((bits >> _S32) & _LOW16) * _TO_UNIT16 - 1.0
            dots[slot, 2] = radius_px * (1.0 + radius_spread * spread) if u < presence else -1.0
            dots[slot, 3] = 0.85 + 0.15 * u / presence
            slot += 1


@njit(cache=True, nogil=True, inline="always")
def coverage(x, y, dots, edge_px):
    """Coverage with gold at a point, 0 to 1, by the dots around it.

    The edge of a dot is a quintic step of half width `edge_px` (its slope has a standard deviation of 0.378 edge_px):
    twice differentiable, as smooth as an image with an electron probe of finite size.
    """
    uncovered = 1.0
    for slot in range(9):
        radius = dots[slot, 2]
        if radius < 0.0:
            continue
        dx = x - dots[slot, 0]
        dy = y - dots[slot, 1]
        square = dx * dx + dy * dy
        extent = radius + edge_px
        if square < extent * extent:
            t = (extent - math.sqrt(square)) / (2.0 * edge_px)
            if t > 1.0:
                t = 1.0
            uncovered *= 1.0 - dots[slot, 3] * t * t * t * (10.0 + t * (6.0 * t - 15.0))
    return 1.0 - uncovered


@njit(cache=True, nogil=True, error_model="numpy")
def cover(uncovered, xs, ys, centre_x, centre_y, radius, brightness, edge_px):
    """Reduce the uncovered fraction of points (n,) by one dot, as `coverage`, without a branch."""
    extent = radius + edge_px
    for column in range(uncovered.size):
        dx = xs[column] - centre_x
        dy = ys[column] - centre_y
        t = (extent - math.sqrt(dx * dx + dy * dy)) / (2.0 * edge_px)
        t = min(1.0, max(0.0, t))
        uncovered[column] *= 1.0 - brightness * t * t * t * (10.0 + t * (6.0 * t - 15.0))
