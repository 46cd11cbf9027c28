"""Exposure in separate steps: beam position, coverage with gold, noise. `raster_rows` computes the plain raster in one loop."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from semlive_simulators.kernels.film import GRAINS, cut_off, reaches, shared_cell, thickness
from semlive_simulators.kernels.pattern import _STEP_X, _STEP_Y, cover, gaussian, gaussian_pair, load_dots, mix64

DOTS, FILM = 0, 1
_HEXAGON_X = np.array([0.0, 2.0, 1.0, -1.0, -2.0, -1.0, 1.0])
_HEXAGON_Y = np.array([0.0, 0.0, 1.0, 1.0, 0.0, -1.0, -1.0]) * np.array([0.0, 0.0, *[math.sqrt(3.0)] * 2, 0.0, *[math.sqrt(3.0)] * 2])
_HEXAGON_WEIGHT = np.array([0.5, *[1.0 / 12.0] * 6])


@njit(cache=True, nogil=True)
def beam_points(x_px, y_px, first_row, offset_x_px, offset_y_px, begin_maps, end_maps, reversed_rows):
    """The material point at each scan address: xi = A (R - offset) + b, where A and b change linearly within a row.

    Args:
        x_px: (rows, width) float64, written.
        y_px: likewise.
        first_row: number of the first row in the frame.
        offset_x_px: (rows, width) float64, distortion and all displacements of the image at each scan address.
        offset_y_px: likewise.
        begin_maps: (rows, 2, 3) float64, [A | b] at the first visited pixel of a row.
        end_maps: (rows, 2, 3) float64, [A | b] one dwell time after the last visited pixel.
        reversed_rows: (rows,) bool, whether the row is scanned from right to left.
    """
    width = x_px.shape[1]
    for index in range(x_px.shape[0]):
        begin = begin_maps[index]
        end = end_maps[index]
        for column in range(width):
            px = column - offset_x_px[index, column]
            py = first_row + index - offset_y_px[index, column]
            visited = width - 1 - column if reversed_rows[index] else column
            f = visited / width
            x0 = begin[0, 0] * px + begin[0, 1] * py + begin[0, 2]
            y0 = begin[1, 0] * px + begin[1, 1] * py + begin[1, 2]
            x_px[index, column] = x0 + f * (end[0, 0] * px + end[0, 1] * py + end[0, 2] - x0)
            y_px[index, column] = y0 + f * (end[1, 0] * px + end[1, 1] * py + end[1, 2] - y0)


@njit(cache=True, nogil=True)
def _add_dots(uncovered, xs, ys, seed, numbers, dots, box):
    """Multiply the uncovered fraction of points (n,) of a row by that of every dot."""
    pitch_px, edge_px = numbers[0], numbers[4]
    begin = 0
    while begin < xs.size:
        end = shared_cell(xs, ys, begin, pitch_px, box)
        cell_x, cell_y = np.int64(math.floor(xs[begin] / pitch_px)), np.int64(math.floor(ys[begin] / pitch_px))
        load_dots(cell_x, cell_y, seed, pitch_px, numbers[1], numbers[2], numbers[3], dots)
        for slot in range(9):
            if dots[slot, 2] >= 0.0 and reaches(dots[slot, 0], dots[slot, 1], dots[slot, 2] + edge_px, box):
                part = xs[begin:end], ys[begin:end]
                cover(uncovered[begin:end], *part, dots[slot, 0], dots[slot, 1], dots[slot, 2], dots[slot, 3], edge_px)
        begin = end


@njit(cache=True, nogil=True)
def add_coverage(signal, x_px, y_px, probe_px, weight, kind, pattern_seed, numbers):
    """Add the coverage with gold, averaged over a probe of finite size.

    A Gaussian probe is seven points: the centre with weight 1/2 and a hexagon of radius 2 sigma with 1/12 each, exact for
    polynomials up to degree 5 (Stroud 1971, E2 r2 5-1); an elliptic one has the hexagon stretched.

    Args:
        signal: (rows, width) float64, added to.
        x_px: (rows, width) float64, material points.
        y_px: likewise.
        probe_px: (rows, 2, 2) float64, L of the probe's covariance L L^T; zeros for a point.
        weight: weight of this visit.
        kind: DOTS or FILM.
        pattern_seed: seed of the pattern.
        numbers: (5,) float64; edge of a cell first, the rest see `load_dots` and `coverage`, or `thickness` and `cut_off`.
    """
    dots = np.empty((9, 4))
    grains = np.empty((GRAINS, 3))
    box = np.empty(4)
    covered = np.empty(signal.shape[1])
    for index in range(signal.shape[0]):
        probe = probe_px[index]
        points = 7 if probe[0, 0] > 0.0 or probe[1, 1] > 0.0 else 1
        for point in range(points):
            share = weight * _HEXAGON_WEIGHT[point] if points == 7 else weight
            xs = x_px[index] + (probe[0, 0] * _HEXAGON_X[point] + probe[0, 1] * _HEXAGON_Y[point])
            ys = y_px[index] + (probe[1, 0] * _HEXAGON_X[point] + probe[1, 1] * _HEXAGON_Y[point])
            if kind == FILM:
                covered[:] = 0.0
                thickness(covered, xs, ys, pattern_seed, numbers[0], grains, box)
                cut_off(covered, numbers[1], numbers[2])
                signal[index] += share * covered
            else:
                covered[:] = 1.0
                _add_dots(covered, xs, ys, pattern_seed, numbers, dots, box)
                signal[index] += share * (1.0 - covered)


@njit(cache=True, nogil=True)
def digitise(out, first_row, grey, variance, scale, noise_seed, frame):
    """Add noise and round; the noise is that of `raster_rows`.

    Args:
        out: (rows, width) uint8 or uint16, written.
        first_row: number of the first row in the frame.
        grey: (rows, width) float64, levels of 8 bit.
        variance: (rows, width) float64, of the noise, levels squared.
        scale: 1 for 8 bit, 256 for 16 bit.
        noise_seed: seed of the noise.
        frame: number of the frame.
    """
    top = 256.0 * scale - 1.0
    frame_key = mix64(np.uint64(noise_seed) * _STEP_X + np.uint64(frame))
    for index in range(out.shape[0]):
        row_key = mix64(frame_key + np.uint64(first_row + index) * _STEP_Y)
        spare = 0.0
        for column in range(out.shape[1]):
            if column % 2 == 0:
                noise, spare = gaussian_pair(row_key + np.uint64(column) * _STEP_X)
            else:
                noise = spare
            level = scale * (grey[index, column] + noise * math.sqrt(variance[index, column]))
            out[index, column] = min(top, max(0.0, math.floor(level + 0.5)))


@njit(cache=True, nogil=True)
def gaussians(seed, stream, first_number, count):
    """Standard normal numbers `first_number` ... `first_number + count - 1` of a stream, (count,) float64."""
    values = np.empty(count)
    for index in range(count):
        values[index] = gaussian(seed, stream, first_number + index)
    return values
