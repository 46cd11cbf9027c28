"""The same maps with another model: advected distortion, row shifts, other maps; all columns are computed again."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap
from semlive.estimate.joint.observations.normal_equations import with_normal_matrix, without_normal_matrix
from semlive.estimate.joint.observations.observations import map_observations
from semlive.estimate.joint.observations.state import NO_ROW_SHIFTS, EstimatorState, MapObservations, offload_rows
from semlive.model import RowShiftEffect, UniformSpline


def with_advected_distortion(state: EstimatorState) -> EstimatorState:
    """Return the state with the distortion advected by the drift at the linearisation point. All columns are computed again."""
    return _remade(replace(state, distortion=replace(state.distortion, carried=True)))


def with_static_distortion(state: EstimatorState) -> EstimatorState:
    """Return the state with a distortion fixed to the scan address. All columns are computed again."""
    return _remade(replace(state, distortion=replace(state.distortion, carried=False)))


def with_row_shifts(state: EstimatorState, over_y: UniformSpline, about: NDArray[np.float64]) -> EstimatorState:
    """Return the state with row shifts in every frame, linearised about parameters (n,) of the old layout.

    All columns are computed again.
    """
    every = (0, *state.motions.pairs)
    larger = replace(
        without_normal_matrix(state), row_shifts=RowShiftEffect(over_y, tuple(2 * pair + member for pair in every for member in (0, 1)))
    )
    larger = replace(larger, linearisation_point=np.zeros(larger.layout.size))
    larger.linearisation_point[state.layout.within(larger.layout)] = about
    return with_normal_matrix(_remade(larger))


def with_maps(state: EstimatorState, changed: Callable[[DisparityMap], DisparityMap]) -> EstimatorState:
    """Return the state with other maps of the same pairs and without rejected blocks. All columns are computed again."""
    rebuilt = (map_observations(state, changed(map_rows.dmap)) if map_rows.weight.any() else map_rows for map_rows in state.rows)
    return _with_rows(
        state,
        (replace(new, weight=np.where(map_rows.weight > 0.0, new.weight, 0.0)) for new, map_rows in zip(rebuilt, state.rows, strict=True)),
    )


def reset_model_selection(state: EstimatorState, changed: Callable[[DisparityMap], DisparityMap]) -> EstimatorState:
    """Return the state with other maps of the same pairs and without selected terms: static distortion, no row shifts."""
    smaller = replace(without_normal_matrix(state), distortion=replace(state.distortion, carried=False), row_shifts=NO_ROW_SHIFTS)
    about = state.linearisation_point[smaller.layout.within(state.layout)] if state.linearisation_point.size else state.linearisation_point
    restarted = with_maps(replace(smaller, linearisation_point=about), changed)
    return with_normal_matrix(restarted) if state.summed else restarted


def _remade(state: EstimatorState) -> EstimatorState:
    return _with_rows(
        state,
        (
            replace(map_observations(state, map_rows.dmap), weight=map_rows.weight) if map_rows.weight.any() else map_rows
            for map_rows in state.rows
        ),
    )


def _with_rows(state: EstimatorState, rebuilt: Iterable[MapObservations]) -> EstimatorState:
    rebuilt_state = replace(state, rows=state.storage.append((), (offload_rows(value, state.storage) for value in rebuilt)))
    return with_normal_matrix(without_normal_matrix(rebuilt_state)) if state.summed else rebuilt_state
