"""Order of the pairs in time, and the knots of temporal splines that a pair or the time before it touches."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from semlive.data.drift import FrameTime
from semlive.estimate.joint.elimination.shared_parameters import TemporalSpline
from semlive.estimate.joint.observations.priors import MAX_COUPLED_KNOTS
from semlive.estimate.joint.observations.state import EstimatorState, MapObservations, rows_of

KNOT_MARGIN = 0.125
"""Fraction of a frame before its first row and after its last row within which a point may be observed."""
GAP_KNOTS = 32
"""Number of knots that no pair touches and that are eliminated in one step."""

Knots = tuple[int, ...]
"""A number of knots, or the index of a knot, of each temporal spline."""


def gap_steps(
    splines: Sequence[TemporalSpline], present_sizes: Knots, first_active_knot: Knots, times: tuple[FrameTime, FrameTime]
) -> list[tuple[Knots, Knots]]:
    """Return the steps in which the time before a pair is eliminated, so that a long time without pairs is not eliminated in one step.

    Args:
        splines: temporal splines.
        present_sizes: number of knots of each spline added so far.
        first_active_knot: first knot of each spline not yet eliminated.
        times: scan times of the pair.

    Returns:
        For each step and spline, the number of knots and the first knot that remains.
    """
    sizes = tuple(max(first_knot(spline, times), size) for spline, size in zip(splines, present_sizes, strict=True))
    max_knots = max(after - before for before, after in zip(present_sizes, sizes, strict=True))
    steps = []
    for count in range(1, max_knots // GAP_KNOTS + 1):
        part = count * GAP_KNOTS / max_knots
        at = tuple(before + int(part * (after - before)) for before, after in zip(present_sizes, sizes, strict=True))
        coupled = (min(spline.since(size), size - MAX_COUPLED_KNOTS) for spline, size in zip(splines, at, strict=True))
        steps.append((at, tuple(max(begin, past) for begin, past in zip(coupled, first_active_knot, strict=True))))
    return steps


def maps_of(state: EstimatorState, pairs: Iterable[int]) -> dict[int, list[MapObservations]]:
    """Return the maps of pairs by the number of the pair."""
    maps: dict[int, list[MapObservations]] = {pair: [] for pair in pairs}
    for rows in rows_of(state, maps):
        maps[rows.current // 2].append(rows)
    return maps


def pair_times(state: EstimatorState) -> dict[int, tuple[FrameTime, FrameTime]]:
    """Return the scan times of all pairs by the number of the pair."""
    first = {when.frame: when for when in state.frames}
    return {pair: (first[2 * pair], first[2 * pair + 1]) for pair in (0, *state.motions.pairs)}


def first_knot(spline: TemporalSpline, times: tuple[FrameTime, FrameTime]) -> int:
    """Return the first knot that a pair may touch, without those of the border."""
    return max(spline.interval(min(when.start_s - KNOT_MARGIN * when.timing.duration_s for when in times)), spline.first)


def first_later_knots(splines: Sequence[TemporalSpline], times: Sequence[tuple[FrameTime, FrameTime]]) -> list[tuple[int, ...]]:
    """For each of several pairs in order of time, the first knot of each temporal spline that a later pair may touch."""
    limits, first = [], tuple(spline.spline.size for spline in splines)
    for time in reversed(times):
        limits.append(first)
        first = tuple(min(first_knot(spline, time), before) for spline, before in zip(splines, first, strict=True))
    return limits[::-1]


def last_row_s(times: tuple[FrameTime, FrameTime]) -> float:
    """Return the time before which a later pair touches no knot, s: the end of the scans less the margins."""
    return max(when.start_s + (1.0 - 2.0 * KNOT_MARGIN) * when.timing.duration_s for when in times)


def knots_end_s(times: tuple[FrameTime, FrameTime]) -> float:
    """Return the time up to which a pair needs knots, s."""
    return times[1].start_s + (1.0 + KNOT_MARGIN) * times[1].timing.duration_s
