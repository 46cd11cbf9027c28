"""Conversion of disparity maps to least-squares rows: block means of the measured disparity and of the columns of the design matrix."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap
from semlive.data.drift import FrameTime
from semlive.data.grid import Grid
from semlive.errors import IllPosed
from semlive.estimate.joint.observations.block_means import BlockColumns, PackedColumns, block_columns, blocks_of
from semlive.estimate.joint.observations.state import EstimatorState, MapObservations
from semlive.model import (
    Axis,
    DistortionSpline,
    DriftSpline,
    Effect,
    FrameObservation,
    RasterChange,
    RowShiftEffect,
    evaluate_drift,
    sighting,
)

SIGMA_FLOOR_PX = 1e-4  # noise-free synthetic maps have sigma 0


def observation_rows(state: EstimatorState, maps: tuple[DisparityMap, ...]) -> tuple[MapObservations, ...]:
    """Rows of all maps of a pair. The map within the pair counts only in blocks not measured against frame 0 in both frames."""
    across = {id(dmap): map_observations(state, dmap) for dmap in maps if dmap.reference == 0 and dmap.current > 1}
    measured = (
        np.all([map_rows.weight > 0 for map_rows in across.values()], axis=0)
        if len(across) == 2
        else np.zeros((state.blocks.size, 2), dtype=bool)
    )
    return tuple(across[id(dmap)] if id(dmap) in across else map_observations(state, dmap, measured) for dmap in maps)


def map_observations(state: EstimatorState, dmap: DisparityMap, measured: NDArray[np.bool_] | None = None) -> MapObservations:
    """Rows of one map; without columns if no block has weight.

    Args:
        state: the estimator state.
        dmap: the map.
        measured: (blocks, 2) True where other maps carry the same information; these blocks get no weight. None: all blocks count.

    Raises:
        IllPosed: the map has another grid than the state, or starts neither from frame 0 nor from its own pair.
    """
    if dmap.grid != state.grid:
        raise IllPosed(f"the map {dmap.reference} -> {dmap.current} is on another grid than the estimate: correlate all pairs on one grid")
    if dmap.reference != 0 and dmap.reference // 2 != dmap.current // 2:
        raise IllPosed(f"the map {dmap.reference} -> {dmap.current} starts from neither frame 0 nor its own pair: leave it out")
    blocks = state.blocks
    x, y = (coordinates.ravel() for coordinates in dmap.grid.mesh())
    disparity = np.stack((dmap.u_px.ravel(), dmap.v_px.ravel()), axis=1)
    valid = dmap.valid.ravel()
    used = blocks.inliers(disparity[:, 0], valid) & blocks.inliers(disparity[:, 1], valid)
    within, noisy = dmap.reference // 2 == dmap.current // 2, 1 if dmap.reference == 0 else 2
    weight, mean = _weights(state, dmap, used, noisy), blocks.mean(disparity, used)
    position = blocks.mean(np.stack((x, y), axis=1), used) - state.centre_px
    if measured is not None:
        weight = np.where(measured, 0.0, weight)
    if not weight.any():
        none = BlockColumns("distortion", Axis.EACH, np.zeros(1, dtype=np.int64), np.zeros((blocks.size, 1)))
        return MapObservations(dmap.reference, dmap.current, mean, weight, noisy, (none,), position, (), dmap)
    # In a map within a pair only a few blocks at the edge count; its other points carry no information and cost time.
    used = used & np.asarray(np.any(weight, axis=1), dtype=np.bool_)[blocks.block]
    at = blocks.block[used]
    reference = sighting(state.frame_time(dmap.reference), x[used], y[used])
    current = sighting(state.frame_time(dmap.current), x[used] + disparity[used, 0], y[used] + disparity[used, 1])
    if state.distortion.carried:
        reference, current = (evaluate_drift(state.model, state.linearisation_point, value) for value in (reference, current))
    difference: list[BlockColumns | PackedColumns] = []
    at_reference: list[BlockColumns | PackedColumns] = []
    for effect in state.model:
        if effect.needs_ideal or not effect.size:
            continue
        after = [block_columns(effect.name, part, at, blocks.size) for part in effect.columns(current)]
        resting = used.all() and not state.distortion.carried
        if resting:
            # The distortion depends on position only, so its columns at frame 0 are valid for every frame.
            when = state.frame_time(0 if isinstance(effect, DistortionSpline) else dmap.reference)
            before = _resting(_shortest(effect, reference), dmap.grid, state.settings.max_blocks, when)
        else:
            before = [block_columns(effect.name, part, at, blocks.size, sign=-1.0) for part in effect.columns(reference)]
        both = _together(after, before)
        if isinstance(effect, DistortionSpline):
            shape = effect.along_y.size, effect.along_x.size
            difference += [PackedColumns.of(value, shape) for value in both]
            # Static columns are stored once for all maps.
            at_reference += before if resting else [PackedColumns.of(value, shape) for value in before]
        else:
            difference += both
            at_reference += before
    columns = tuple(difference), position, () if within else tuple(at_reference)
    return MapObservations(dmap.reference, dmap.current, mean, weight, noisy, *columns, dmap)


def _together(after: list[BlockColumns], before: list[BlockColumns]) -> list[BlockColumns]:
    """Columns of one effect in two frames, as one matrix if both touch the same parameters (as for the distortion)."""
    if len(after) == len(before) and all(np.array_equal(later.index, earlier.index) for later, earlier in zip(after, before, strict=True)):
        return [replace(value, value=value.value + two.value) for value, two in zip(after, before, strict=True)]
    return [*after, *before]


def _shortest(effect: Effect, observation: FrameObservation) -> Effect:
    """The effect with the extent it had at the time of the observation, so that cached columns are found again."""
    if isinstance(effect, RowShiftEffect):
        return replace(effect, frames=effect.frames[:1])
    if not isinstance(effect, DriftSpline | RasterChange):
        return effect
    spline = effect.spline
    needed = int((float(observation.visit_time_s.max()) - spline.origin) / spline.spacing) + 1
    return replace(effect, spline=spline.of_intervals(needed))


@lru_cache(maxsize=16)
def _resting(effect: Effect, grid: Grid, max_blocks: int, when: FrameTime) -> list[BlockColumns]:
    """Columns of an effect at the undisplaced grid in the reference frame of a map, usually frame 0.

    They take a third of the time of a map.
    """
    blocks = blocks_of(grid, max_blocks)
    observation = sighting(when, *grid.mesh())
    return [block_columns(effect.name, part, blocks.block, blocks.size, sign=-1.0) for part in effect.columns(observation)]


def _weights(state: EstimatorState, dmap: DisparityMap, used: NDArray[np.bool_], noisy_frames: int) -> NDArray[np.float64]:
    """(blocks, 2) weights from DIC noise (the noise of two frames) and subset overlap, 1/px^2; zero for empty blocks."""
    blocks = state.blocks
    sigma = np.stack((dmap.sigma_u_px.ravel(), dmap.sigma_v_px.ravel()), axis=1)
    variance = blocks.mean(np.maximum(sigma, SIGMA_FLOOR_PX) ** 2, used)
    count = np.bincount(blocks.block[used], minlength=blocks.size)
    weight = (2 / noisy_frames) / np.maximum(variance * blocks.variance(count)[:, None], SIGMA_FLOOR_PX**2 * 1e-2)
    return np.where(count[:, None] > 0, weight, 0.0)
