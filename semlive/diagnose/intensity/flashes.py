"""Flashes: rows of one frame of a pair that are brighter for a moment, and not those of the other."""

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
"""Standard deviations of a row's mean: of 38,000 rows without a flash the largest was at 4.5."""
LEAST_LEVELS = 2.0
LONGEST_ROWS = 25
NEIGHBOUR_ROWS = 40
MAX_ASYMMETRY = 0.5
"""Of a flash, what rows nearby may be darker by: a pattern that jumped is as often darker as brighter."""
PAIR_MATCH_ROWS = 3


@dataclass(frozen=True, slots=True)
class Flash:
    """Some bright rows.

    Attributes:
        frame: number of the frame.
        at_s: when they were scanned, after the start of frame 0.
        length_s: how long.
        levels: how much brighter the brightest of its rows.
        sigma_levels: standard uncertainty of that.
    """

    frame: int
    at_s: float
    length_s: float
    levels: float
    sigma_levels: float


def flashes(frames: Sequence[IntensityFrame]) -> tuple[Flash, ...]:
    """Of all frames whose pair is whole, in their order."""
    found: list[Flash] = []
    for first, second in pairwise(frames):
        if first.frame // 2 == second.frame // 2:
            found += _of_pair(first, second)
    return tuple(found)


def _of_pair(first: IntensityFrame, second: IntensityFrame) -> list[Flash]:
    """The second frame's rows against those of the first on the same material, whose flashes are dark then."""
    rows = np.arange(len(first.row_levels), dtype=np.float64)
    at, moved = _moved(first, second)
    down = np.interp(rows, at, moved)
    inside = (rows + down >= 1.0) & (rows + down <= len(rows) - 2.0)
    change = np.where(inside, np.interp(rows + down, rows, second.row_levels) - first.row_levels, 0.0)
    change = change - median_filter(change, DETREND_ROWS, mode="nearest")
    # Where the pattern's rows are steep, a part of a pixel along y is a difference of theirs.
    steep = np.gradient(gaussian_filter1d(first.row_levels, 1.0))
    scale = np.sqrt(_spread(change) ** 2 + (0.3 * steep) ** 2)
    found = []
    for sign, frame in ((1.0, second), (-1.0, first)):
        significant = sign * change > np.maximum(DETECTION_SIGMAS * scale, LEAST_LEVELS)
        for begin, end in _runs(significant):
            near = sign * change[max(0, begin - NEIGHBOUR_ROWS) : end + NEIGHBOUR_ROWS]
            if end - begin > LONGEST_ROWS or -near.min() > MAX_ASYMMETRY * near.max():
                continue
            middle = 0.5 * (begin + end - 1)
            place = middle + (float(np.interp(middle, rows, down)) if sign > 0 else 0.0)
            sigma = float(np.sqrt(np.mean(scale[begin:end] ** 2)))
            length_s = (end - begin) * frame.row_time_s
            at_s = frame.start_s + (place + 0.5) * frame.row_time_s
            found.append(Flash(frame.frame, at_s, length_s, float(np.max(sign * change[begin:end])), sigma))
    return sorted(found, key=lambda candidate: candidate.at_s)


def _moved(first: IntensityFrame, second: IntensityFrame) -> tuple[Array, Array]:
    """Rows of the first frame and how far down their material is in the second, by rows of blocks that both have."""
    both = first.measured & second.measured
    starts = np.unique(first.block_row[both])
    rows = [both & (first.block_row == start) for start in starts]
    at = np.array([first.row_px[map_rows].mean() for map_rows in rows])
    return at, np.array([second.row_px[map_rows].mean() for map_rows in rows]) - at


def _spread(values: Array) -> float:
    return 1.4826 * float(np.median(np.abs(values - np.median(values)))) + 1e-6


def _runs(significant: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and next-to-last row of each run, runs that lie close together being one."""
    at = np.flatnonzero(significant)
    if not at.size:
        return []
    parts = np.split(at, np.flatnonzero(np.diff(at) > PAIR_MATCH_ROWS) + 1)
    return [(int(part[0]), int(part[-1]) + 1) for part in parts]
