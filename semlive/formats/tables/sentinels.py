"""Numbers in the place of a displacement that was not found: ``-9999``, ``999.999``, ``1e+37``, or one pair of numbers at many points.

A number that programs are known to write is a mark if it is far from all other displacements of the map: ``99`` in a map of 0 to 3 px, not
in a map of 90 to 110 px, and not in a map where all points moved by 99 px. Any other pair of numbers is doubtful if it occurs several
times and jumps to every other number next to it, which no measured field does.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semlive.inputs.lost_numbers import MIN_SENTINEL, SINGLE_PRECISION, USUAL

Values, Points = NDArray[np.float64], NDArray[np.bool_]
_IMPOSSIBLE_PX = 1e6
"""No image has so many columns, so 1e10, 1e+37 and the end of 32-bit integers are included."""
MIN_DISTANCE_PX = 10.0
MIN_POINTS = 3
"""Points with one pair of numbers; two outliers may have the same pair by chance."""
_MIN_JUMP_PX, _MAX_JUMP_PX = 0.5, 20.0
"""Range of the smallest jump to all numbers next to such a pair; no specimen is displaced by more between neighbouring points."""
_JUMPS = 3.0
"""Jump as a multiple of the median and of the smallest one between neighbours, for large gradients and for displacements in integers."""


def sentinels_in(u_px: Values, v_px: Values, valid: Points) -> Points:
    """Return which points contain a usual mark without a displacement.

    Args:
        u_px: (n,) displacement along x.
        v_px: (n,) displacement along y.
        valid: (n,) points that count as found so far.
    """
    usual = _is_usual(u_px), _is_usual(v_px)
    lost = np.zeros(len(u_px), dtype=np.bool_)
    others = valid & ~usual[0] & ~usual[1]
    if not others.any():
        return lost
    for values, is_usual in zip((u_px, v_px), usual, strict=True):
        low, high = float(values[others].min()), float(values[others].max())
        margin = max(high - low, MIN_DISTANCE_PX)
        lost |= is_usual & ((values < low - margin) | (values > high + margin))
    return lost


def is_sentinel(value: float) -> bool:
    """Whether a single number may mark a missing value: -999 or less and of nines only, or the end of 16-bit integers."""
    return value <= -10 * MIN_SENTINEL and bool(_is_usual(np.array([value]))[0])


def _is_usual(values: Values) -> Points:
    size = np.abs(values)
    usual = (size >= _IMPOSSIBLE_PX) & np.isfinite(size)
    if (size >= MIN_SENTINEL).any():
        for number in USUAL:
            usual |= np.abs(size - number) <= SINGLE_PRECISION * number
    return usual


def doubtful_pair(u_px: Values, v_px: Values, valid: Points) -> tuple[Points, float] | None:
    """Return the points with a pair of numbers that may mark points that were not found, and its smallest jump in px; None without one.

    Args:
        u_px: (ny, nx) displacement along x.
        v_px: (ny, nx) displacement along y.
        valid: (ny, nx) points that were found.
    """
    pairs, number, counts = np.unique((u_px + 1j * v_px)[valid], return_inverse=True, return_counts=True)
    if len(pairs) < 2 or counts.max() < MIN_POINTS:
        return None
    at = np.full(valid.shape, -1)
    at[valid] = number.ravel()
    jump_px = np.full(len(pairs), np.inf)
    all_jumps: list[Values] = []
    for first, second in ((at[:, :-1], at[:, 1:]), (at[:-1], at[1:])):
        differ = (first >= 0) & (second >= 0) & (first != second)
        first, second = first[differ], second[differ]
        jumps = np.abs(pairs[first] - pairs[second])
        np.minimum.at(jump_px, first, jumps)
        np.minimum.at(jump_px, second, jumps)
        all_jumps.append(jumps)
    between = np.concatenate(all_jumps)
    limit_px = (
        min(max(_MIN_JUMP_PX, _JUMPS * float(np.median(between)), _JUMPS * float(between.min())), _MAX_JUMP_PX) if len(between) else 0.0
    )
    doubtful = (counts >= MIN_POINTS) & (jump_px > limit_px) & np.isfinite(jump_px)
    if not doubtful.any():
        return None
    rarest = int(np.flatnonzero(doubtful)[np.argmin(counts[doubtful])])
    return at == rarest, float(jump_px[rarest])
