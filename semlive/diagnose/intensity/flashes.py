"""Flashes: short brightening of some rows in one frame of a pair only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, median_filter

from semlive.diagnose.intensity.frames import IntensityFrame

Array = NDArray[np.float64]
DETREND_ROWS = 51
DETECTION_SIGMAS = 6.5
"""Detection threshold in standard deviations of a row mean; the largest of 38,000 rows without a flash was 4.5."""
MIN_LEVELS = 2.0
MAX_ROWS = 25
NEIGHBOUR_ROWS = 40
MAX_ASYMMETRY = 0.5
"""Largest darkening of neighbouring rows relative to a flash; a jump of the pattern darkens as much as it brightens."""
PAIR_MATCH_ROWS = 3


@dataclass(frozen=True, slots=True)
class Flash:
    """One flash.

    Attributes:
        frame: number of the frame.
        at_s: instant of the flash, seconds after the start of frame 0.
        length_s: duration, s.
        levels: brightening of the brightest row, grey levels.
        sigma_levels: standard uncertainty of `levels`.
    """

    frame: int
    at_s: float
    length_s: float
    levels: float
    sigma_levels: float


def flashes(frames: Sequence[IntensityFrame]) -> tuple[Flash, ...]:
    """Flashes in all frames of complete pairs, in order of time."""
    detected: list[Flash] = []
    for first, second in pairwise(frames):
        if first.frame // 2 == second.frame // 2:
            detected += _of_pair(first, second)
    return tuple(detected)


def _of_pair(first: IntensityFrame, second: IntensityFrame) -> list[Flash]:
    """Flashes of a pair, from rows of the second frame minus those of the first, where flashes of the first are negative."""
    rows = np.arange(len(first.row_levels), dtype=np.float64)
    at, moved = _moved(first, second)
    down = np.interp(rows, at, moved)
    inside = (rows + down >= 1.0) & (rows + down <= len(rows) - 2.0)
    change = np.where(inside, np.interp(rows + down, rows, second.row_levels) - first.row_levels, 0.0)
    change = change - median_filter(change, DETREND_ROWS, mode="nearest")
    # At strong gradients between rows, a subpixel error along y changes the difference.
    steep = np.gradient(gaussian_filter1d(first.row_levels, 1.0))
    scale = np.sqrt(_spread(change) ** 2 + (0.3 * steep) ** 2)
    detected = []
    for sign, frame in ((1.0, second), (-1.0, first)):
        significant = sign * change > np.maximum(DETECTION_SIGMAS * scale, MIN_LEVELS)
        for begin, end in _runs(significant):
            neighbourhood = sign * change[max(0, begin - NEIGHBOUR_ROWS) : end + NEIGHBOUR_ROWS]
            if end - begin > MAX_ROWS or -neighbourhood.min() > MAX_ASYMMETRY * neighbourhood.max():
                continue
            middle = 0.5 * (begin + end - 1)
            place = middle + (float(np.interp(middle, rows, down)) if sign > 0 else 0.0)
            sigma = float(np.sqrt(np.mean(scale[begin:end] ** 2)))
            length_s = (end - begin) * frame.row_time_s
            at_s = frame.start_s + (place + 0.5) * frame.row_time_s
            detected.append(Flash(frame.frame, at_s, length_s, float(np.max(sign * change[begin:end])), sigma))
    return sorted(detected, key=lambda candidate: candidate.at_s)


def _moved(first: IntensityFrame, second: IntensityFrame) -> tuple[Array, Array]:
    """Rows of the first frame and their displacement along y to the second, from rows of blocks measured in both."""
    measured_in_both = first.measured & second.measured
    starts = np.unique(first.block_row[measured_in_both])
    rows = [measured_in_both & (first.block_row == start) for start in starts]
    at = np.array([first.row_px[map_rows].mean() for map_rows in rows])
    return at, np.array([second.row_px[map_rows].mean() for map_rows in rows]) - at


def _spread(values: Array) -> float:
    return 1.4826 * float(np.median(np.abs(values - np.median(values)))) + 1e-6


def _runs(significant: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First row and end of each group of significant rows; groups that lie close together are merged."""
    at = np.flatnonzero(significant)
    if not at.size:
        return []
    parts = np.split(at, np.flatnonzero(np.diff(at) > PAIR_MATCH_ROWS) + 1)
    return [(int(part[0]), int(part[-1]) + 1) for part in parts]
