"""A plain raster scan: one grey level for each pixel, at the time and position of that pixel."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from semlive_simulators.kernels.pattern import _STEP_X, _STEP_Y, coverage, gaussian_pair, load_dots, mix64


@njit(cache=True, nogil=True)
def raster_rows(
    out,
    first_row,
    ex_px,
    ey_px,
    row_maps,
    row_fraction_per_px,
    pattern_seed,
    pitch_px,
    radius_px,
    radius_spread,
    presence,
    edge_px,
    offset,
    gain,
    read_noise,
    shot_noise,
    noise_seed,
    frame,
):
    """Write rows of an image.

    The material point at scan address R is xi = A (R - E(R)) + b; A and b are given at the start of each row and change linearly in
    between.

    Args:
        out: (rows, width) uint8, written.
        first_row: number of the first row in the frame.
        ex_px: (height, width) float64, distortion E in x at each scan address.
        ey_px: (height, width) float64, distortion E in y.
        row_maps: (rows + 1, 2, 3) float64, [A | b] at the beginning of each row, and of the row after the last.
        row_fraction_per_px: dwell time / row time.
        pattern_seed: seed of the speckle.
        pitch_px: see `load_dots`.
        radius_px: see `load_dots`.
        radius_spread: see `load_dots`.
        presence: see `load_dots`.
        edge_px: see `coverage`.
        offset: grey level of the metal without gold.
        gain: grey levels from metal to gold.
        read_noise: standard deviation of the noise without signal, grey levels.
        shot_noise: variance of the noise per grey level of signal.
        noise_seed: seed of the noise.
        frame: number of the frame, which determines its noise.
    """
    dots = np.empty((9, 4))
    frame_key = mix64(np.uint64(noise_seed) * _STEP_X + np.uint64(frame))
    for index in range(out.shape[0]):
        row = first_row + index
        row_key = mix64(frame_key + np.uint64(row) * _STEP_Y)
        begin = row_maps[index]
        end = row_maps[index + 1]
        cell_x = np.int64(-(2**62))
        cell_y = np.int64(-(2**62))
        spare = 0.0
        for column in range(out.shape[1]):
            px = column - ex_px[row, column]
            py = row - ey_px[row, column]
            f = column * row_fraction_per_px
            x0 = begin[0, 0] * px + begin[0, 1] * py + begin[0, 2]
            y0 = begin[1, 0] * px + begin[1, 1] * py + begin[1, 2]
            x = x0 + f * (end[0, 0] * px + end[0, 1] * py + end[0, 2] - x0)
            y = y0 + f * (end[1, 0] * px + end[1, 1] * py + end[1, 2] - y0)
            new_x = np.int64(math.floor(x / pitch_px))
            new_y = np.int64(math.floor(y / pitch_px))
            if new_x != cell_x or new_y != cell_y:
                cell_x = new_x
                cell_y = new_y
                load_dots(cell_x, cell_y, pattern_seed, pitch_px, radius_px, radius_spread, presence, dots)
            signal = gain * coverage(x, y, dots, edge_px)
            if column % 2 == 0:
                noise, spare = gaussian_pair(row_key + np.uint64(column) * _STEP_X)
            else:
                noise = spare
            grey = offset + signal + noise * math.sqrt(read_noise * read_noise + shot_noise * (offset + signal))
            out[index, column] = np.uint8(min(255.0, max(0.0, math.floor(grey + 0.5))))
