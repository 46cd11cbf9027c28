"""Accumulation of the maps of a pair in the state of the estimator. The result equals batch least squares exactly."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap
from semlive.data.drift import FrameTime
from semlive.data.experiment import Phase
from semlive.errors import IllPosed
from semlive.estimate.joint.observations.design_columns import with_rates
from semlive.estimate.joint.observations.normal_equations import (
    NormalMatrix,
    add_prior,
    add_rows,
    with_normal_matrix,
    without_normal_matrix,
)
from semlive.estimate.joint.observations.observations import observation_rows
from semlive.estimate.joint.observations.state import EstimatorState, Extent, MapObservations, init, offload_rows, rows_of
from semlive.model import DriftSpline, Layout, MotionKind, PairMotions, RasterChange, RasterTerm, UniformSpline

MAX_DRIFT_KNOTS = 250_000
"""15 kB each: 10,000 pairs at the published rate, 50 days, need 136,000. Those of pauses count: a clock that jumps by years is refused."""
PAUSE_KNOTS = 64
"""The coefficients of longer pauses are integrated out before anything else, so a pause of any length costs nothing. With all its knots, a
pause of 15 hours had 4,700. The differences of the drift between both ends have the same distribution.
"""
RASTER_PAUSE_KNOTS = 8
"""Likewise for changes of the raster, whose knots are further apart, in such a pause."""
DENSE_PAIRS = 32
"""Number of first pairs whose sums form one dense matrix, from which hyperparameters are selected."""
DENSE_KNOTS = 640
"""Largest number of drift knots of the dense matrix. Short pauses contain knots, too: with holds of 20 minutes, 24 pairs have 1,200 knots,
and a selection took 17 s.
"""
_END_KNOTS = 4
"""Knots of a cubic spline beyond those of its length: three at the ends, and one for a last interval that is not complete."""
MAX_COARSENING = 8.0
"""Largest factor by which knots are placed further apart. With factors of 4 and 8 a run without effects stayed without; knots further apart
than the pairs cannot follow the drift between them, and what they leave would be identified as an effect.
"""
TREND_KNOTS = 6
"""Number of last knots from which the drift is extrapolated."""
RASTER_KNOT_FRAMES = 8.0
"""Knot distance of the raster changes in frame times: lens current and high voltage drift over hours."""

_KIND = {Phase.CALIBRATION: MotionKind.RIGID, Phase.TRANSLATION: MotionKind.GRADIENT, Phase.TENSION: MotionKind.GRADIENT}


def update(
    state: EstimatorState, pair: int, phase: Phase, times: tuple[FrameTime, FrameTime], maps: tuple[DisparityMap, ...]
) -> EstimatorState:
    """Add one pair to the state.

    The maps of a run share the noise of their frames. All maps from frame 0 share the noise of frame 0. With drift of one sign this noise
    resembles distortion; treating it as independent doubled the error of the distortion. The maps of one pair share the noise of the frames
    of the pair. Each frame is given independent noise with half the variance of a map. The noise of frame 0 is estimated block
    by block. Given
    it, the two maps from frame 0 are independent and the map within the pair is their difference. The map within the pair therefore counts
    only in blocks where one of the two maps is missing.

    Args:
        state: the state before the pair.
        pair: number of the pair. Pair 0 comes first; the others may come in any order, because frame times define their position.
        phase: purpose of the pair. In calibration the specimen moves rigidly; otherwise its displacement gradient is free.
        times: scan times of the two frames.
        maps: maps 2k -> 2k+1 and, for k > 0, also 0 -> 2k and 0 -> 2k+1. Any of them may be missing.

    Returns:
        The new state. The given state is not changed.

    Raises:
        IllPosed: pair 0 is missing, a pair occurs twice or precedes pair 0, or the run exceeds the largest drift spline.
    """
    _check_pair(state, pair, times, maps)
    if state.frames:  # stored once for all frames with the same scan
        shared = state.frames[-1].timing
        first, second = (replace(when, timing=shared) if when.timing == shared else when for when in times)
        times = first, second
    state = _with_knots_for(state, times)
    duration_s = max(when.timing.duration_s for when in times)
    drift = state.drift or DriftSpline(UniformSpline(0.0, duration_s / state.settings.drift_knots_per_frame, 1))
    drift, raster = _continued(drift, state.raster or _raster(state, duration_s), times)
    if drift.spline.intervals > MAX_DRIFT_KNOTS:
        raise IllPosed(f"the run is {times[1].start_s:.0f} s long at pair {pair}, more than {MAX_DRIFT_KNOTS} drift knots: start a new run")
    motions = state.motions if pair == 0 else state.motions.with_pair(pair, _KIND[phase])
    frames, phases = tuple(sorted((*state.frames, *times), key=_start)), (*state.phases, phase)
    lines = state.row_shifts.with_frames((2 * pair, 2 * pair + 1))
    starts = state.start_time_errors.with_pairs(pair, math.hypot(*(when.start_sigma_s for when in times)))
    larger = replace(
        state, drift=drift, raster=raster, motions=motions, frames=frames, phases=phases, row_shifts=lines, start_time_errors=starts
    )
    grown = with_rates(_grown(larger, state.layout), state.start_time_errors)
    # Stored at once: a solution refers to them as well and must not refer to the version before storage.
    rows = [offload_rows(observation_row, state.storage) for observation_row in observation_rows(grown, maps)]
    sums = NormalMatrix(grown.precision, grown.information, grown.reference.copy())  # made by `_grown` for this state alone
    for map_rows in rows:
        if grown.summed:
            add_rows(grown, map_rows, grown.linearisation_point, sums)
        add_prior(map_rows, sums.reference)
    calibrated = state.calibrated if phase is Phase.TENSION else _widened(state, state.calibrated, rows)
    extended = replace(grown, rows=state.storage.append(grown.rows, rows), calibrated=calibrated)
    return replace(extended, precision=sums.precision, information=sums.information, reference=sums.reference)


def _check_pair(state: EstimatorState, pair: int, times: tuple[FrameTime, FrameTime], maps: tuple[DisparityMap, ...]) -> None:
    if not state.phases and pair != 0:
        raise IllPosed(f"pair {pair} came before pair 0, the reference of all others: give pair 0 first")
    if pair in state.motions.pairs or (state.phases and not pair):
        raise IllPosed(f"pair {pair} is in the estimate already: give each pair once")
    if state.frames and times[0].start_s < state.frames[0].start_s:
        raise IllPosed(f"pair {pair} was scanned before pair 0, the reference of all others: begin with the earliest pair")
    if not any(dmap.valid.any() for dmap in maps):
        raise IllPosed(f"no point of pair {pair} was correlated, so it has no information: check focus and contrast of its frames")


def dense_limit(state: EstimatorState) -> int:
    """Number of first pairs for which hyperparameters are selected from one dense matrix; at least 1."""
    if state.drift is None:
        return len(state.phases)
    end_s = {when.frame // 2: _end_s(when) for when in state.frames}
    knots = [state.drift.spline.shortened(end_s[pair]).size for pair in (0, *state.motions.pairs)[:DENSE_PAIRS]]
    return next((count for count, size in enumerate(knots) if count and size > DENSE_KNOTS), len(knots))


def first_pairs(state: EstimatorState, pairs: int) -> EstimatorState:
    """Return the state restricted to the first `pairs` pairs in order of arrival."""
    retained = {0, *state.motions.pairs[: pairs - 1]}
    loaded = {pair for pair, phase in zip((0, *state.motions.pairs), state.phases, strict=True) if phase is Phase.TENSION}
    frames = tuple(when for when in state.frames if when.frame // 2 in retained)
    end_s = max(_end_s(when) for when in frames)
    assert state.drift is not None  # there are pairs
    shorter = without_normal_matrix(state)
    return with_normal_matrix(
        replace(
            shorter,
            drift=replace(state.drift, spline=state.drift.spline.shortened(end_s)),
            raster=tuple(replace(raster_effect, spline=raster_effect.spline.shortened(end_s)) for raster_effect in state.raster),
            motions=PairMotions(state.motions.pairs[: pairs - 1], state.motions.kinds[: pairs - 1]),
            start_time_errors=state.start_time_errors.only(retained),
            frames=frames,
            phases=state.phases[:pairs],
            rows=tuple(rows_of(state, retained)),
            linearisation_point=np.zeros(0),
            calibrated=_widened(state, None, rows_of(state, retained - loaded)),
        )
    )


def with_coarser_drift(state: EstimatorState) -> EstimatorState:
    """Return the state of the same maps, with the knots of drift and raster so far apart that one dense matrix contains the complete run.

    Many pauses of at most `PAUSE_KNOTS` have too many: 16 pairs with 50 knots between them have 950. The state is returned where the knots
    are few enough or would be more than `MAX_COARSENING` times as far apart, and with more than `DENSE_PAIRS` pairs.
    """
    count = len(state.phases)
    if state.drift is None or count > DENSE_PAIRS or dense_limit(state) == count:
        return state
    factor, coarse = 1.0, state
    while dense_limit(coarse) < count and factor <= MAX_COARSENING:  # a pause that is short in such knots contains them
        assert coarse.drift is not None  # there are pairs
        factor *= max(coarse.drift.spline.size / (DENSE_KNOTS - _END_KNOTS), 1.05)
        coarse = _again(state, factor, state.drift, state.raster)
    return with_normal_matrix(coarse) if factor <= MAX_COARSENING else state


def _with_knots_for(state: EstimatorState, times: tuple[FrameTime, FrameTime]) -> EstimatorState:
    """The state itself, or that of the same maps with knots for a pair within a pause between earlier pairs."""
    begin_s, end_s = _begin_s(times[0]), _end_s(times[1])
    if state.drift is None or all(one.spline.has(begin_s, end_s) for one in (state.drift, *state.raster)):
        return state
    remade = _again(state, 1.0, state.drift, state.raster, times)
    return with_normal_matrix(remade) if dense_limit(remade) == len(remade.phases) else remade


def _again(
    state: EstimatorState, factor: float, drift: DriftSpline, raster: tuple[RasterChange, ...], *further: tuple[FrameTime, FrameTime]
) -> EstimatorState:
    """The state of the same maps without its sums, with knots further apart by a factor, and with knots at the times of further pairs."""
    settings = replace(state.settings, drift_knots_per_frame=state.settings.drift_knots_per_frame / factor)
    times = [(state.frame_time(2 * pair), state.frame_time(2 * pair + 1)) for pair in (0, *state.motions.pairs)]
    drift = replace(drift, spline=UniformSpline(0.0, factor * drift.spline.spacing, 1))
    raster = tuple(replace(one, spline=UniformSpline(0.0, factor * one.spline.spacing, 1)) for one in raster)
    for pair_times in sorted((*times, *further), key=lambda both: both[0].start_s):
        drift, raster = _continued(drift, raster, pair_times)
    # Without its sums, a state may have a drift and a raster before its first pair.
    empty = without_normal_matrix(init(settings, state.grid, state.width_px, state.height_px))
    again = replace(empty, drift=drift, raster=raster, storage=state.storage)
    for pair, phase, pair_times in zip((0, *state.motions.pairs), state.phases, times, strict=True):
        again = update(again, pair, phase, pair_times, tuple(rows.dmap for rows in rows_of(state, (pair,))))
    return again


def _widened(state: EstimatorState, extent: Extent | None, maps: Sequence[MapObservations]) -> Extent | None:
    for rows in maps:
        used = rows.weight.any(axis=1)
        if rows.from_reference and not rows.within_pair and used.any():
            there = (rows.position_px + rows.disparity_px)[used] + state.centre_px
            here = Extent(there.min(axis=0), there.max(axis=0))
            extent = extent.union(here) if extent else here
    return extent


def _continued(
    drift: DriftSpline, raster: tuple[RasterChange, ...], times: tuple[FrameTime, FrameTime]
) -> tuple[DriftSpline, tuple[RasterChange, ...]]:
    """The effects in time lengthened to a pair, without the knots of a long pause before it."""
    begin_s, end_s = _begin_s(times[0]), _end_s(times[1])
    after = drift.spline.after_gap(begin_s, PAUSE_KNOTS)
    if after is not drift.spline:
        raster = tuple(replace(one, spline=one.spline.after_gap(begin_s, RASTER_PAUSE_KNOTS)) for one in raster)
    return DriftSpline(after.until(end_s)), tuple(replace(one, spline=one.spline.until(end_s)) for one in raster)


def _begin_s(when: FrameTime) -> float:
    """Scan start of a frame, s, less an eighth of a frame."""
    return when.start_s - 0.125 * when.timing.duration_s


def _end_s(when: FrameTime) -> float:
    """Scan end of a frame, s, plus an eighth of a frame: a subset inside the image may have points below the last row."""
    return when.start_s + 1.125 * when.timing.duration_s


def _start(when: FrameTime) -> float:
    return when.start_s


def _raster(state: EstimatorState, duration_s: float) -> tuple[RasterChange, ...]:
    x, y = (float(value) for value in state.centre_px)
    spline = UniformSpline(0.0, RASTER_KNOT_FRAMES * duration_s, 1)
    return tuple(RasterChange(term, spline, (x, y), x) for term in RasterTerm)


def _grown(state: EstimatorState, before: Layout) -> EstimatorState:
    layout = state.layout
    index = before.within(layout)
    about = extended_parameters(state, before, state.linearisation_point)
    if not state.summed or dense_limit(state) < len(state.phases):
        return replace(without_normal_matrix(state), linearisation_point=about)
    precision, information = np.zeros((layout.size, layout.size)), np.zeros(layout.size)
    moved = [(before.part(name), slice(layout.part(name).start, layout.part(name).start + size)) for name, size in before.of_each()]
    for old_row, row in moved:
        for old_column, column in moved:
            precision[row, column] = state.precision[old_row, old_column]
    information[index] = state.information
    before_noise = state.reference
    coupling = np.zeros((2, state.blocks.size, layout.size))
    coupling[:, :, index] = before_noise.coupling
    return replace(
        state, precision=precision, information=information, linearisation_point=about, reference=replace(before_noise, coupling=coupling)
    )


def extended_parameters(state: EstimatorState, before: Layout, parameters: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) parameters in the layout of a shorter run in that of a state. The drift continues at its last rate; motions are zero."""
    if not parameters.size or state.drift is None:
        return parameters
    layout = state.layout
    about = np.zeros(layout.size)
    about[before.within(layout)] = parameters
    _extrapolate(about[layout.part("drift")].reshape(-1, 2), before.part("drift"), state.drift.spline)
    return about


def _extrapolate(drift: NDArray[np.float64], estimated: slice, spline: UniformSpline) -> None:
    """Extrapolate, in place, drift coefficients that no pair has touched at the rate of the last ones.

    Some columns need the drift there.
    """
    count = (estimated.stop - estimated.start) // 2
    last, at = min(TREND_KNOTS, count - 1), spline.place(np.arange(len(drift)))
    rate = (drift[count - 1] - drift[count - 1 - last]) / (at[count - 1] - at[count - 1 - last])
    drift[count:] = drift[count - 1] + rate * (at[count:] - at[count - 1])[:, None]
