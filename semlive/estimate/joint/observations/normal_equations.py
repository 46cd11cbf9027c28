"""Accumulation of disparity maps into normal equations, pair by pair. The result equals batch least squares exactly."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap
from semlive.data.drift import FrameTime
from semlive.data.experiment import Phase
from semlive.errors import IllPosed
from semlive.estimate.joint.observations.block_means import BlockColumns, PackedColumns, StoredColumns, block_columns, contiguous_slice
from semlive.estimate.joint.observations.observations import observation_rows
from semlive.estimate.joint.observations.state import (
    NO_START_TIME_ERRORS,
    EstimatorState,
    Extent,
    ManyColumns,
    MapObservations,
    ReferenceNoise,
    offload_rows,
    rows_of,
)
from semlive.model import (
    Axis,
    DriftSpline,
    FrameObservation,
    Layout,
    MotionKind,
    PairMotions,
    RasterChange,
    RasterTerm,
    StartTimeErrors,
    UniformSpline,
)

MAX_DRIFT_KNOTS = 250_000  # 15 kB each: 10,000 pairs of the published rate, 50 days, take 136,000; a clock that jumps by years is refused
DENSE_PAIRS = 32  # what the data choose is chosen from sums over all pairs in one matrix; with more, from the first so many
# Knots of the drift go on through pauses: with holds of 20 minutes 24 pairs have 1,200, and a choice from one matrix took 17 s.
DENSE_KNOTS = 640
TREND_KNOTS = 6
RASTER_KNOT_FRAMES = 8.0  # lens current and high voltage drift over hours; faster changes are not drift of the magnification

_KIND = {Phase.CALIBRATION: MotionKind.RIGID, Phase.TRANSLATION: MotionKind.GRADIENT, Phase.TENSION: MotionKind.GRADIENT}


@dataclass(frozen=True, slots=True, eq=False)
class NormalMatrix:
    """Arrays to which the information of maps is added.

    Attributes:
        precision: (n, n) information matrix A^T W A.
        information: (n,) information vector A^T W y.
        reference: the same quantities for the noise of frame 0.
    """

    precision: NDArray[np.float64]
    information: NDArray[np.float64]
    reference: ReferenceNoise


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
    duration_s = max(when.timing.duration_s for when in times)
    drift = state.drift or DriftSpline(UniformSpline(0.0, duration_s / state.settings.drift_knots_per_frame, 1))
    raster = state.raster or _raster(state, duration_s)
    end_s = _end_s(times[1])
    drift, raster = drift.until(end_s), tuple(raster_effect.until(end_s) for raster_effect in raster)
    if drift.spline.size > MAX_DRIFT_KNOTS:
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
        raise IllPosed(f"no point of pair {pair} was correlated, so it says nothing: check focus and contrast of its frames")


def with_normal_matrix(state: EstimatorState) -> EstimatorState:
    """Return the state with its normal matrix, computed again if the state does not hold it."""
    if state.summed:
        return state
    n = state.layout.size
    sums = NormalMatrix(np.zeros((n, n)), np.zeros(n), ReferenceNoise.empty(state.blocks.size, n))
    for map_rows in state.rows:
        add_rows(state, map_rows, state.linearisation_point, sums)
        add_prior(map_rows, sums.reference)
    return replace(state, precision=sums.precision, information=sums.information, reference=sums.reference)


def without_normal_matrix(state: EstimatorState) -> EstimatorState:
    """Return the state without its normal matrix. The matrix covers at most `DENSE_PAIRS` pairs and one linearisation point."""
    nothing = np.zeros((2, state.blocks.size, 0))
    return replace(state, precision=np.zeros((0, 0)), information=np.zeros(0), reference=replace(state.reference, coupling=nothing))


def reweight(state: EstimatorState, rows: Sequence[MapObservations]) -> EstimatorState:
    """Return the state with other weights. All sums are computed again at the same linearisation point."""
    return with_normal_matrix(without_normal_matrix(replace(state, rows=rows)))


def relinearise(state: EstimatorState, about: NDArray[np.float64]) -> EstimatorState:
    """Return the state linearised about other parameters. Only effects that need the ideal position are summed again."""
    state = with_rates(replace(state, linearisation_point=about))
    if not state.summed:
        return state
    precision, information, reference, layout = state.precision.copy(), state.information.copy(), state.reference.copy(), state.layout
    moving = np.zeros(len(information), dtype=bool)
    for effect in state.model:
        moving[layout.part(effect.name)] = effect.needs_ideal
    precision[moving, :] = 0.0
    precision[:, moving] = 0.0
    information[moving] = 0.0
    reference.coupling[:, :, moving] = 0.0
    for rows in state.rows:
        if rows.within_pair and not state.start_time_errors.size:
            continue
        parts = _parts(state, rows, about)
        own = [part for part in parts if moving[layout.part(part.effect)].any()]
        for axis in (Axis.X, Axis.Y) if own else ():
            index, design = _component(layout, own, axis)
            weighted = design * rows.weight[:, int(axis is Axis.Y), None]
            for part in parts:
                at = _joint_index(layout, part, axis)
                if at is not None:
                    precision[np.ix_(index, at)] += weighted.T @ part.value
            information[index] += weighted.T @ rows.disparity_px[:, int(axis is Axis.Y)]
            reference.coupling[int(axis is Axis.Y)][:, index] -= weighted
    precision[np.ix_(~moving, moving)] = precision[np.ix_(moving, ~moving)].T
    return replace(state, precision=precision, information=information, reference=reference)


def map_columns(
    state: EstimatorState, rows: MapObservations, about: NDArray[np.float64]
) -> tuple[tuple[NDArray[np.int64], NDArray[np.float64]], ...]:
    """For x and for y: (m,) joint parameter indices and (blocks, m) design matrix of a map, linearised about parameters."""
    layout, parts = state.layout, _parts(state, rows, about)
    return tuple(_component(layout, parts, axis) for axis in (Axis.X, Axis.Y))


def predicted(state: EstimatorState, rows: MapObservations, parameters: NDArray[np.float64]) -> NDArray[np.float64]:
    """(blocks, 2) disparity of a map predicted by the model, px, with the linearisation of the state."""
    return evaluated(state.layout, _parts(state, rows, state.linearisation_point), parameters, len(rows.position_px))


def add_rows(state: EstimatorState, rows: MapObservations, about: NDArray[np.float64], sums: NormalMatrix) -> None:
    """Add one map's information on parameters and on the noise of frame 0 to `sums`, in place."""
    for axis, (index, design) in enumerate(map_columns(state, rows, about)):
        weight, disparity = rows.weight[:, axis], rows.disparity_px[:, axis]
        weighted = design * weight[:, None]
        sums.precision[np.ix_(index, index)] += weighted.T @ design
        sums.information[index] += weighted.T @ disparity
        if rows.from_reference:
            noise = sums.reference
            noise.weight[:, axis] += weight
            noise.coupling[axis][:, index] -= weighted
            noise.information[:, axis] -= weight * disparity


def add_prior(rows: MapObservations, noise: ReferenceNoise) -> None:
    """Set, in place, the prior noise of frame 0 to that of the earliest frame measured against it, independent of the arrival order."""
    if not rows.from_reference:
        return
    earlier = (rows.weight > 0) & (rows.current < noise.first_seen_frame)
    noise.weight[earlier] += rows.weight[earlier] - noise.prior[earlier]
    noise.prior[earlier] = rows.weight[earlier]
    noise.first_seen_frame[earlier] = rows.current


def dense_limit(state: EstimatorState) -> int:
    """Number of first pairs for which hyperparameters are selected from one dense matrix; at least 1."""
    if state.drift is None:
        return len(state.phases)
    first = replace(state.drift, spline=replace(state.drift.spline, intervals=1))
    end_s = {when.frame // 2: _end_s(when) for when in state.frames}
    knots = [first.until(end_s[pair]).spline.size for pair in (0, *state.motions.pairs)[:DENSE_PAIRS]]
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
            drift=replace(state.drift, spline=replace(state.drift.spline, intervals=1)).until(end_s),
            raster=tuple(
                replace(raster_effect, spline=replace(raster_effect.spline, intervals=1)).until(end_s) for raster_effect in state.raster
            ),
            motions=PairMotions(state.motions.pairs[: pairs - 1], state.motions.kinds[: pairs - 1]),
            start_time_errors=state.start_time_errors.only(retained),
            frames=frames,
            phases=state.phases[:pairs],
            rows=tuple(rows_of(state, retained)),
            linearisation_point=np.zeros(0),
            calibrated=_widened(state, None, rows_of(state, retained - loaded)),
        )
    )


def _widened(state: EstimatorState, extent: Extent | None, maps: Sequence[MapObservations]) -> Extent | None:
    for rows in maps:
        used = rows.weight.any(axis=1)
        if rows.from_reference and not rows.within_pair and used.any():
            there = (rows.position_px + rows.disparity_px)[used] + state.centre_px
            here = Extent(there.min(axis=0), there.max(axis=0))
            extent = extent.union(here) if extent else here
    return extent


def marginal(state: EstimatorState) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(n, n) and (n,) information on the parameters after marginalising the noise of frame 0."""
    state = with_normal_matrix(state)
    precision, information = state.precision.copy(), state.information.copy()
    noise = state.reference
    for axis in (0, 1):
        used = noise.weight[:, axis] > 0
        touched = np.flatnonzero(noise.coupling[axis].any(axis=0))
        root = 1.0 / np.sqrt(noise.weight[used, axis])
        half = noise.coupling[axis][np.ix_(used, touched)] * root[:, None]
        precision[np.ix_(touched, touched)] -= half.T @ half
        information[touched] -= half.T @ (noise.information[used, axis] * root)
    return precision, information


def gradient(state: EstimatorState, parameters: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) gradient of the log-likelihood at `parameters`, ``A^T W (y - A parameters)``, after marginalising the noise of frame 0.

    It equals ``marginal(state)[1] - marginal(state)[0] @ parameters`` without the rounding error of that difference. For displacements of
    30 px that agree to 1e-7 px, the difference of the two sums has no significant digits.
    """
    state = with_normal_matrix(state)
    total, noise = np.zeros(len(parameters)), np.zeros((state.blocks.size, 2))
    for rows in state.rows:
        if not rows.weight.any():
            continue
        parts = _parts(state, rows, state.linearisation_point)
        misfit = (rows.disparity_px - evaluated(state.layout, parts, parameters, len(rows.position_px))) * rows.weight
        add_projected(state.layout, parts, misfit, total)
        if rows.from_reference:
            noise -= misfit
    for axis in (0, 1):
        weight = state.reference.weight[:, axis]
        total -= state.reference.coupling[axis].T @ np.where(weight > 0, noise[:, axis] / np.where(weight > 0, weight, 1.0), 0.0)
    return total


def evaluated(layout: Layout, columns: Sequence[BlockColumns], parameters: NDArray[np.float64], blocks: int) -> NDArray[np.float64]:
    """(blocks, 2) product of columns and parameters, px."""
    total = np.zeros((blocks, 2))
    for part in columns:
        own = parameters[layout.part(part.effect)]
        if part.axis is Axis.EACH:
            total += part.value @ own.reshape(-1, 2)[part.index]
        else:
            total[:, int(part.axis is Axis.Y)] += part.value @ own[part.index]
    return total


def add_transposed_product(state: EstimatorState, rows: MapObservations, field: NDArray[np.float64], total: NDArray[np.float64]) -> None:
    """Add a map's design matrix, transposed, times a field (blocks, 2) to `total` (n,), in place."""
    add_projected(state.layout, _parts(state, rows, state.linearisation_point), field, total)


def add_projected(layout: Layout, columns: Sequence[BlockColumns], field: NDArray[np.float64], total: NDArray[np.float64]) -> None:
    """Add columns, transposed, times a field (blocks, 2) to `total` (n,), in place."""
    for part in columns:
        own = total[layout.part(part.effect)]
        if part.axis is Axis.EACH:
            own.reshape(-1, 2)[part.index] += part.value.T @ field
        else:
            own[part.index] += part.value.T @ field[:, int(part.axis is Axis.Y)]


def _parts(state: EstimatorState, rows: MapObservations, about: NDArray[np.float64]) -> list[BlockColumns]:
    """All columns of a map. Columns that need the ideal position or the drift rate are computed here."""
    late, blocks = _late(state, rows), len(rows.position_px)
    if rows.within_pair:
        return [*_unpacked(rows.difference_columns), *late]
    layout = state.layout
    ideal = rows.position_px + (evaluated(layout, _unpacked(rows.reference_columns), about, blocks) if about.size else 0.0)
    nowhere, every = np.zeros(0), np.arange(blocks)
    pair = rows.current // 2
    turn_rad = state.motions.turn_rad(pair, about[layout.part("motion")]) if about.size else 0.0
    observation = FrameObservation(rows.current, pair, nowhere, nowhere, nowhere, ideal, turn_rad)
    moving = [
        block_columns(effect.name, part, every, blocks) for effect in (state.axes, state.motions) for part in effect.columns(observation)
    ]
    return [*_unpacked(rows.difference_columns), *late, *moving]


def _late(state: EstimatorState, rows: MapObservations) -> list[BlockColumns]:
    """Columns of the start-time error of the second frame of a pair."""
    if not state.start_time_errors.size or not rows.weight.any():
        return []
    every, nowhere = np.arange(len(rows.position_px)), np.zeros(len(rows.position_px))
    observation = FrameObservation(rows.current, rows.current // 2, nowhere, nowhere, nowhere)
    return [
        block_columns(state.start_time_errors.name, column, every, len(every)) for column in state.start_time_errors.columns(observation)
    ]


def with_rates(state: EstimatorState, given: StartTimeErrors = NO_START_TIME_ERRORS) -> EstimatorState:
    """Return the state with start-time errors linearised about its drift. The entries of `given` keep their values."""
    if not state.start_time_errors.size or not state.linearisation_point.size or state.drift is None:
        return state
    drift = state.linearisation_point[state.layout.part("drift")].reshape(-1, 2)
    second = [state.frame_time(2 * pair + 1) for pair in state.start_time_errors.pairs]
    index, value = state.drift.spline.local_rate([when.start_s + 0.5 * when.timing.duration_s for when in second])
    rate = np.einsum("nk,nkc->nc", value, drift[index])
    rates = {pair: (float(x), float(y)) for pair, (x, y) in zip(state.start_time_errors.pairs, rate, strict=True)}
    return replace(state, start_time_errors=state.start_time_errors.about(rates | dict(zip(given.pairs, given.rate_px_s, strict=True))))


def _unpacked(columns: ManyColumns) -> list[BlockColumns]:
    every = columns.columns() if isinstance(columns, StoredColumns) else columns
    return [columns.unpacked() if isinstance(columns, PackedColumns) else columns for columns in every]


def _component(layout: Layout, columns: list[BlockColumns], axis: Axis) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Joint indices and design matrix of one component. Columns that share a parameter are summed."""
    indices, values = [], []
    for part in columns:
        at = _joint_index(layout, part, axis)
        if at is not None:
            indices.append(at)
            values.append(part.value)
    joined = np.concatenate(indices)
    unique, where = np.unique(joined, return_inverse=True)
    design = np.zeros((len(values[0]), len(unique)))
    at = 0
    for value in values:  # columns of one part are distinct, those of two parts (drift in two frames) may coincide
        design[:, contiguous_slice(where[at : at + value.shape[1]])] += value
        at += value.shape[1]
    return unique, design


def _joint_index(layout: Layout, part: BlockColumns, axis: Axis) -> NDArray[np.int64] | None:
    """(m,) joint parameter indices of columns in one component, or None if they do not act on it."""
    if part.axis is Axis.EACH:
        return layout.part(part.effect).start + 2 * part.index + (axis is Axis.Y)
    return layout.part(part.effect).start + part.index if part.axis is axis else None


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
    about = extended_parameters(layout, before, state.linearisation_point)
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


def extended_parameters(layout: Layout, before: Layout, parameters: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) parameters of a shorter run in the layout of a longer one. The drift continues at its last rate; motions are zero."""
    if not parameters.size:
        return parameters
    about = np.zeros(layout.size)
    about[before.within(layout)] = parameters
    _go_on(about[layout.part("drift")].reshape(-1, 2), before.part("drift"))
    return about


def _go_on(drift: NDArray[np.float64], estimated: slice) -> None:
    """Extrapolate, in place, drift coefficients that no pair has touched at the rate of the last ones.

    Some columns need the drift there.
    """
    count = (estimated.stop - estimated.start) // 2
    last = min(TREND_KNOTS, count - 1)
    rate = (drift[count - 1] - drift[count - 1 - last]) / last
    drift[count:] = drift[count - 1] + rate * np.arange(1, len(drift) - count + 1)[:, None]
