"""Numbers in the place of a displacement that was not found: ``-9999``, ``999.999``, ``1e+37``, or one pair of numbers at many points.

A number that programs are known to write is a mark if it is far from all other displacements of the map: ``99`` in a map of 0 to 3 px, not
in a map of 90 to 110 px, and not in a map where all points moved by 99 px. Any other pair of numbers is doubtful if it occurs several
times and jumps to every other number next to it, which no measured field does; in a map with
decimals a pair of integers, or a zero in one component, is doubtful at a single point.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from semlive.inputs.lost_numbers import MIN_SENTINEL, SINGLE_PRECISION, USUAL

Values, Points = NDArray[np.float64], NDArray[np.bool_]
Rule = Callable[[NDArray[np.complex128], NDArray[np.intp]], Values]
"""Multiple of the limit by which a mark jumps, 0 for no mark, by the values and their numbers of points."""
_IMPOSSIBLE_PX = 1e6
"""No image has so many columns, so 1e10, 1e+37 and the end of 32-bit integers are included."""
MIN_DISTANCE_PX = 10.0
MIN_POINTS = 3
"""Points with one pair of numbers; two outliers may have the same pair by chance."""
_LONE = 2.0
"""For a single point: a zero in a map with noise of 0.16 px jumped by 1.04 times the limit by chance (1 of 300 simulated maps)."""
_MAX_MARKS = 0.2
"""Part of the points with integers above which the map is rounded, or one side of a synthetic crack is at rest."""
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

    A pair of integers is doubtful at a single point where most displacements have decimals; so is a zero in one component alone.

    Args:
        u_px: (ny, nx) displacement along x.
        v_px: (ny, nx) displacement along y.
        valid: (ny, nx) points that were found.
    """
    pairs = (u_px + 1j * v_px)[valid]
    is_integer = (pairs.real == np.round(pairs.real)) & (pairs.imag == np.round(pairs.imag))
    found = _doubtful(
        (u_px + 1j * v_px).astype(np.complex128),
        valid,
        lambda values, counts: np.where(counts >= MIN_POINTS, 1.0, _LONE * _integers(values, is_integer)),
    )
    for component in (u_px, v_px):
        if found is None and (is_zero := component[valid] == 0).any():
            found = _doubtful(
                component.astype(np.complex128),
                valid,
                lambda values, counts, is_zero=is_zero: _LONE * ((values == 0) & _integers(values, is_zero)),
            )
    return found


def _integers(values: NDArray[np.complex128], is_mark: Points) -> Points:
    """Return which values are integers, if few points of the map have such values."""
    return (values == np.round(values)) & (np.mean(is_mark) <= _MAX_MARKS)


def _doubtful(displacement: NDArray[np.complex128], valid: Points, may_be_mark: Rule) -> tuple[Points, float] | None:
    values, number, counts = np.unique(displacement[valid], return_inverse=True, return_counts=True)
    if len(values) < 2 or not (limits := may_be_mark(values, counts)).any():
        return None
    at = np.full(valid.shape, -1)
    at[valid] = number.ravel()
    jump_px = np.full(len(values), np.inf)
    all_jumps: list[Values] = []
    for first, second in ((at[:, :-1], at[:, 1:]), (at[:-1], at[1:])):
        differ = (first >= 0) & (second >= 0) & (first != second)
        first, second = first[differ], second[differ]
        jumps = np.abs(values[first] - values[second])
        np.minimum.at(jump_px, first, jumps)
        np.minimum.at(jump_px, second, jumps)
        all_jumps.append(jumps)
    between = np.concatenate(all_jumps)
    limit_px = (
        min(max(_MIN_JUMP_PX, _JUMPS * float(np.median(between)), _JUMPS * float(between.min())), _MAX_JUMP_PX) if len(between) else 0.0
    )
    doubtful = (limits > 0) & (jump_px > limits * limit_px) & np.isfinite(jump_px)
    if not doubtful.any():
        return None
    rarest = int(np.flatnonzero(doubtful)[np.argmin(counts[doubtful])])
    return at == rarest, float(jump_px[rarest])
