"""Design matrix of a map: columns of all effects for its block means, stored or computed at a linearisation point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from semlive.estimate.joint.observations.block_means import BlockColumns, PackedColumns, StoredColumns, contiguous_slice, own_columns
from semlive.estimate.joint.observations.state import NO_START_TIME_ERRORS, EstimatorState, ManyColumns, MapObservations
from semlive.model import Axis, FrameObservation, Layout, StartTimeErrors


def map_columns(
    state: EstimatorState, rows: MapObservations, about: NDArray[np.float64]
) -> tuple[tuple[NDArray[np.int64], NDArray[np.float64]], ...]:
    """For x and for y: (m,) joint parameter indices and (blocks, m) design matrix of a map, linearised about parameters."""
    layout, parts = state.layout, columns_of(state, rows, about)
    return tuple(component_design(layout, parts, axis) for axis in (Axis.X, Axis.Y))


def predicted(state: EstimatorState, rows: MapObservations, parameters: NDArray[np.float64]) -> NDArray[np.float64]:
    """(blocks, 2) disparity of a map predicted by the model, px, with the linearisation of the state."""
    return evaluated(state.layout, columns_of(state, rows, state.linearisation_point), parameters, len(rows.position_px))


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
    add_projected(state.layout, columns_of(state, rows, state.linearisation_point), field, total)


def add_projected(layout: Layout, columns: Sequence[BlockColumns], field: NDArray[np.float64], total: NDArray[np.float64]) -> None:
    """Add columns, transposed, times a field (blocks, 2) to `total` (n,), in place."""
    for part in columns:
        own = total[layout.part(part.effect)]
        if part.axis is Axis.EACH:
            own.reshape(-1, 2)[part.index] += part.value.T @ field
        else:
            own[part.index] += part.value.T @ field[:, int(part.axis is Axis.Y)]


def columns_of(state: EstimatorState, rows: MapObservations, about: NDArray[np.float64]) -> list[BlockColumns]:
    """All columns of a map. Columns that need the ideal position or the drift rate are computed here."""
    late, blocks = _start_time_columns(state, rows), len(rows.position_px)
    if rows.within_pair:
        return [*_unpacked(rows.difference_columns), *late]
    layout = state.layout
    ideal = rows.position_px + (evaluated(layout, _unpacked(rows.reference_columns), about, blocks) if about.size else 0.0)
    nowhere = np.zeros(0)
    pair = rows.current // 2
    turn_rad = state.motions.turn_rad(pair, about[layout.part("motion")]) if about.size else 0.0
    observation = FrameObservation(rows.current, pair, nowhere, nowhere, nowhere, ideal, turn_rad)
    moving = [own_columns(effect.name, part) for effect in (state.axes, state.motions) for part in effect.columns(observation)]
    return [*_unpacked(rows.difference_columns), *late, *moving]


def _start_time_columns(state: EstimatorState, rows: MapObservations) -> list[BlockColumns]:
    """Columns of the start-time error of the second frame of a pair."""
    if not state.start_time_errors.size or not rows.weight.any():
        return []
    nowhere = np.zeros(len(rows.position_px))
    observation = FrameObservation(rows.current, rows.current // 2, nowhere, nowhere, nowhere)
    return [own_columns(state.start_time_errors.name, column) for column in state.start_time_errors.columns(observation)]


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


def component_design(layout: Layout, columns: list[BlockColumns], axis: Axis) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Joint indices and design matrix of one component. Columns that share a parameter are summed."""
    indices, values = [], []
    for part in columns:
        at = joint_indices(layout, part, axis)
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


def joint_indices(layout: Layout, part: BlockColumns, axis: Axis) -> NDArray[np.int64] | None:
    """(m,) joint parameter indices of columns in one component, or None if they do not act on it."""
    if part.axis is Axis.EACH:
        return layout.part(part.effect).start + 2 * part.index + (axis is Axis.Y)
    return layout.part(part.effect).start + part.index if part.axis is axis else None
