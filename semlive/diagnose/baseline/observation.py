"""Observations for the diagnosis: block means of every map from frame 0, and the conditions of each frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from semlive.data.experiment import Phase
from semlive.data.grid import Grid
from semlive.data.pair import PairDecision
from semlive.data.strain import MeasuredValue
from semlive.errors import IllPosed
from semlive.estimate.joint.elimination.elimination import eliminate_all
from semlive.estimate.joint.observations.accumulation import DENSE_PAIRS, dense_limit, with_coarser_drift
from semlive.estimate.joint.observations.design_columns import predicted
from semlive.estimate.joint.observations.normal_equations import relinearise
from semlive.estimate.joint.observations.priors import Smoothness
from semlive.estimate.joint.observations.state import EstimatorState, MapObservations
from semlive.estimate.joint.solution.posterior import Solution, mean_with, posterior_from_elimination, solve_both_couplings
from semlive.mechanics.strain_gage import mean_gage_strain
from semlive.model.effects import RunGeometry
from semlive.model.effects.run_geometry import FrameSteps

Value = TypeVar("Value")
MIN_PAIRS = 5
MIN_BLOCKS = 24
STEADIEST_DRIFT_PRIOR = Smoothness(3, 3e-4)
HOLD_S = 30.0
"""Hold time in Sutton et al. (2007), s; assumed between the end of a step and its pair if a log contains no hold time."""


@dataclass(frozen=True, slots=True, eq=False)
class StepConditions:
    """Conditions of the step before a pair.

    Attributes:
        pair: number of the pair.
        phase: phase of the pair.
        load_n: (2,) mean load during each frame, N; 0 without a load frame.
        shift_px: (2,) commanded position of the stage or beam, px.
        hold_s: time from the end of the step to the start of the first frame, s.
        gage: mean strain-gage reading during both frames; None without a gage or without readings.
    """

    pair: int
    phase: Phase
    load_n: tuple[float, float]
    shift_px: tuple[float, float]
    hold_s: float = HOLD_S
    gage: MeasuredValue | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """Block means of every frame, and the estimate from which they were derived.

    Attributes:
        state: state of the estimator, linearised about the first solution.
        solution: the first solution.
        rows: maps from frame 0, in the order of the frames of the geometry without frame 0.
        valid_blocks: (b,) blocks contained in every map.
        disparity_px: (f, b, 2) measured disparity, px; zero for frame 0.
        geometry: scan addresses and times of the blocks.
        steps: conditions before each pair.
        alternative_solution: the solution with the other distortion advection, if the selection is in doubt.
        pixel_um: pixel size, um; None if unknown.
    """

    state: EstimatorState
    solution: Solution
    rows: tuple[MapObservations, ...]
    valid_blocks: NDArray[np.int64]
    disparity_px: NDArray[np.float64]
    geometry: RunGeometry
    steps: tuple[StepConditions, ...]
    alternative_solution: Solution | None = None
    pixel_um: float | None = None

    @property
    def frames(self) -> int:
        """Number of frames, frame 0 included."""
        return len(self.geometry.frame)

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return len(self.valid_blocks)

    @property
    def grid(self) -> Grid:
        """Grid of the points in the blocks."""
        return self.state.grid

    def residual_px(self) -> NDArray[np.float64]:
        """(f - 1, b, 2) residual of the first solution for each map, px."""
        residual = [map_rows.disparity_px - predicted(self.state, map_rows, self.solution.mean) for map_rows in self.rows]
        return np.stack(residual)[:, self.valid_blocks]


def baseline_solution(state: EstimatorState) -> tuple[Solution, Solution | None]:
    """Solution from all pairs without further effects, and the one with the other distortion advection if the selection is in doubt.

    The knots of the drift are further apart where pauses have more of them than one matrix may have.

    Raises:
        IllPosed: there are too many pairs, or they are too far apart in time, for one matrix.
    """
    state = with_coarser_drift(state)
    max_pairs = dense_limit(state)
    if max_pairs < len(state.phases):
        reason = "are too many" if len(state.phases) > DENSE_PAIRS else "are too far apart in time"
        raise IllPosed(f"{len(state.phases)} pairs {reason} for one matrix, which contains the first {max_pairs}: diagnose a shorter run")
    selected, alternative = solve_both_couplings(state)
    return _with_smoothest_drift(selected), None if alternative is None else _with_smoothest_drift(alternative)


def _with_smoothest_drift(solution: Solution) -> Solution:
    """The solution linearised about the smoothest drift.

    Strain multiplies the ideal position of a point, from which drift and distortion of frame 0 are subtracted. If a hidden effect makes the
    drift rough, the ideal position is wrong by up to a pixel, and its product with strain adds a common field at all loads. A bending of
    0.16 px was estimated as 0.21 and 0.22 px with the correct drifts, which were less likely than wrong ones by log odds of 95 to 490.
    """
    still = tuple(0.0 for _ in solution.hyper.raster_px)
    steady = replace(solution.hyper, noise_scale=1.0, drift=(STEADIEST_DRIFT_PRIOR, STEADIEST_DRIFT_PRIOR), raster_px=still)
    state = relinearise(solution.state, mean_with(solution.state, steady))
    return posterior_from_elimination(
        eliminate_all(state, solution.hyper, mean_with(state, solution.hyper)), solution.terms, solution.noise_floor_px
    )


def make_observation(solution: Solution, steps: Sequence[StepConditions], alternative: Solution | None = None) -> Observation:
    """Derive the observation from an estimate.

    Args:
        solution: solution of the joint method.
        steps: conditions before each pair, in order of time.
        alternative: solution of the same maps with the other distortion advection, if the selection is in doubt; else None.

    Raises:
        IllPosed: there are too few pairs or points to identify an effect.
    """
    state = solution.state
    frames = np.array([2 * step.pair + member for step in steps for member in (0, 1)])
    rows, used = rows_from_frame_0(state, steps)
    disparity = np.concatenate((np.zeros((1, len(used), 2)), np.stack([map_rows.disparity_px[used] for map_rows in rows])))
    # Effects are predicted from the estimated disparity: sin(2 pi U) of a measured U would be correlated with the noise of U.
    predicted_px = np.concatenate(
        (np.zeros((1, len(used), 2)), np.stack([predicted(state, map_rows, solution.mean)[used] for map_rows in rows]))
    )
    # The position of a block is the mean position of its points in each map. With the points of the first map, points missing in other maps
    # shifted it by 6 px, and the bending of a specimen was estimated 22 % too large.
    position = np.stack([map_rows.position_px[used] for map_rows in (rows[0], *rows)])
    composed = np.array([False, *(map_rows.dmap.intermediate == map_rows.current - 1 for map_rows in rows)])
    scene = _scene(solution, steps, frames, position, predicted_px, composed)
    return Observation(state, solution, rows, used, disparity, scene, tuple(steps), alternative)


def rows_from_frame_0(state: EstimatorState, steps: Sequence[StepConditions]) -> tuple[tuple[MapObservations, ...], NDArray[np.int64]]:
    """The maps from frame 0 to every other frame, and the blocks contained in every map. A solution changes neither.

    Raises:
        IllPosed: a map is missing, or there are too few pairs or points to identify an effect.
    """
    rows_by_frame = {map_rows.current: map_rows for map_rows in state.rows if map_rows.reference == 0 and map_rows.weight.any()}
    frames = [frame for step in steps for frame in (2 * step.pair, 2 * step.pair + 1) if frame]
    missing = [frame for frame in frames if frame not in rows_by_frame]
    if missing:
        raise IllPosed(f"no map from frame 0 to frame {missing[0]}: diagnosis needs one to every frame of a run")
    rows = tuple(rows_by_frame[frame] for frame in frames)
    used = np.flatnonzero(np.all([map_rows.weight.all(axis=1) for map_rows in rows], axis=0)) if rows else np.zeros(0, dtype=np.int64)
    if len(steps) < MIN_PAIRS or len(used) < MIN_BLOCKS:
        raise IllPosed(
            f"{len(steps)} pairs with {len(used)} blocks of points common to all of them are too few to identify an effect; "
            f"diagnosis needs at least {MIN_PAIRS} pairs and {MIN_BLOCKS} blocks"
        )
    return rows, used


def step_conditions(decisions: Sequence[PairDecision], hold_s: float = HOLD_S) -> tuple[StepConditions, ...]:
    """Conditions from the decisions of a run, with the given hold time between step and pair."""
    conditions = []
    for decision in decisions:
        load = (0.0, 0.0) if decision.loads is None else (decision.loads[0].mean_n, decision.loads[1].mean_n)
        gage = None if decision.loads is None else mean_gage_strain(*decision.loads)
        conditions.append(StepConditions(decision.pair, decision.step.phase, load, decision.step.shift_px, hold_s, gage))
    return tuple(conditions)


def evaluate_estimate(solution: Solution, decisions: Sequence[PairDecision], evaluate: Callable[[Observation], Value]) -> Value | None:
    """Evaluate the observation of an estimate; None with too few pairs or points, or more pairs than one matrix holds.

    Args:
        solution: solution of the joint method after the newest pair.
        decisions: decisions of all pairs.
        evaluate: returns the value for an observation.
    """
    if len(decisions) < MIN_PAIRS or dense_limit(solution.state) < len(decisions):
        return None
    try:
        return evaluate(make_observation(solution, step_conditions(decisions)))
    except (IllPosed, np.linalg.LinAlgError):  # the run continues; `semlive diagnose` reports the reason
        return None


def _scene(
    solution: Solution,
    steps: Sequence[StepConditions],
    frames: NDArray[np.int64],
    position: NDArray[np.float64],
    disparity: NDArray[np.float64],
    composed: NDArray[np.bool_],
) -> RunGeometry:
    state = solution.state
    assert state.drift is not None  # there are pairs
    address = position + disparity
    time_s, in_frame, in_row = _visited(state, frames, address)
    start_s = np.array([state.frame_time(int(frame)).start_s for frame in frames])
    between = np.array([0.5 * sum(step.load_n) for step in steps])
    shift = np.array([step.shift_px for step in steps])
    return RunGeometry(
        address_px=address,
        disparity_px=disparity,
        composed=composed,
        time_s=time_s,
        time_in_frame_s=in_frame,
        time_in_row_s=in_row,
        drift_rate_px_s=_drift_rate(solution, time_s),
        distortion_px=_distortion(solution, address + state.centre_px),
        half_px=float(state.centre_px[0]),
        half_height_px=float(state.centre_px[1]),
        frame=frames,
        pair=frames // 2,
        start_s=start_s,
        steps=FrameSteps(
            loaded=np.repeat([step.phase is Phase.TENSION for step in steps], 2),
            gradient_free=np.repeat([step.phase is not Phase.CALIBRATION for step in steps], 2),
            load_n=np.array([load for step in steps for load in step.load_n]),
            load_change_n=np.repeat(np.diff(between, prepend=0.0), 2),
            move_px=np.repeat(np.diff(shift, axis=0, prepend=shift[:1]), 2, axis=0),
            since_step_s=np.repeat([step.hold_s for step in steps], 2) + start_s - np.repeat(start_s[::2], 2),
        ),
        drift_knot_s=state.drift.spline.spacing,
        distortion_knot_px=state.distortion.along_y.spacing,
        subset_s=state.grid.subset_px * state.frame_time(int(frames[0])).timing.row_time_s.value,
    )


def _visited(
    state: EstimatorState, frames: NDArray[np.int64], address_px: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """(f, b) times of the beam at addresses (f, b, 2), s: since the start of frame 0, of the frame and of the row."""
    pixel, frame_times = address_px + state.centre_px, [state.frame_time(int(frame)) for frame in frames]
    in_frame = np.stack(
        [frame_time.timing.time_in_frame_s(value[:, 0], value[:, 1]) for frame_time, value in zip(frame_times, pixel, strict=True)]
    )
    in_row = np.stack(
        [frame_time.timing.time_in_row_s(value[:, 0], value[:, 1]) for frame_time, value in zip(frame_times, pixel, strict=True)]
    )
    return in_frame + np.array([frame_time.start_s for frame_time in frame_times])[:, None], in_frame, in_row


def sample_within_blocks(observation: Observation) -> tuple[tuple[RunGeometry, RunGeometry], ...]:
    """Geometry at four positions of each block, in every frame and in frame 0, to average basis fields over points and subsets.

    The positions lie one standard deviation from the block centre along each axis, so the average is correct to third order. For settling
    within 56 rows, blocks of three points and subsets of 43 px show 5 % more displacement than the centre of the block. Missing points move
    the centre of a block by up to 6 px in both frames. With the centre of frame 0 for all maps, this shift alone distinguished a basis
    field from distortion and reduced the estimated settling by a sixth.
    """
    members = observation.state.blocks.members[observation.valid_blocks]
    points = np.stack([np.where(members < 0, np.nan, coordinates.ravel()[members]) for coordinates in observation.grid.mesh()], axis=-1)
    offset_px = np.sqrt(np.nanvar(points, axis=1) + observation.grid.subset_px**2 / 12.0)
    scene = observation.geometry
    first = np.zeros(observation.frames, dtype=np.int64)
    before = replace(scene, drift_rate_px_s=scene.drift_rate_px_s[first], address_px=scene.address_px - scene.disparity_px)
    directions = np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
    return tuple(
        (
            _moved(observation, scene, scene.frame, offset_px * direction),
            _moved(observation, before, scene.frame[first], offset_px * direction),
        )
        for direction in directions
    )


def _moved(observation: Observation, scene: RunGeometry, frames: NDArray[np.int64], by_px: NDArray[np.float64]) -> RunGeometry:
    """Blocks displaced by (b, 2) px, as observed in the given frames."""
    address = scene.address_px + by_px
    time_s, in_frame, in_row = _visited(observation.state, frames, address)
    return replace(scene, address_px=address, time_s=time_s, time_in_frame_s=in_frame, time_in_row_s=in_row, subset_s=0.0)


def _drift_rate(solution: Solution, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """(f, b, 2) mean drift rate between the two frames of a pair, px/s, interpolated in time between pairs.

    The drift within frames of the estimate is not used: it is wrong if the row time is wrong. With four integrated scans it is a quarter of
    the true drift, and an oscillation with the frame period was identified instead.
    """
    place_px = drift_px(solution, time_s)
    when_s = time_s.mean(axis=1)
    rate = (place_px[1::2] - place_px[::2]) / (when_s[1::2] - when_s[::2])[:, None]
    return make_interp_spline(0.5 * (when_s[::2] + when_s[1::2]), rate, k=1)(time_s)


def drift_px(solution: Solution, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """(f, 2) drift of frames whose blocks were scanned at times (f, b), px, mean over the blocks."""
    drift = solution.state.drift
    assert drift is not None  # there are pairs
    index, value = drift.spline.local(time_s.ravel())
    return np.einsum("nk,nkc->nc", value, solution.part("drift").reshape(-1, 2)[index]).reshape(*time_s.shape, 2).mean(axis=1)


def _distortion(solution: Solution, pixel: NDArray[np.float64]) -> NDArray[np.float64]:
    flat = pixel.reshape(-1, 2)
    return solution.state.distortion.field(solution.part("distortion"), flat[:, 0], flat[:, 1]).reshape(pixel.shape)
