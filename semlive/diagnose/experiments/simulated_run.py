"""Simulation of a planned run for the diagnosis: geometry of its blocks and columns of its baseline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semlive.data.diagnosis.effects import ModelEffect
from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.drift import FrameTime
from semlive.data.experiment import Phase
from semlive.data.scan import ScanTiming
from semlive.diagnose.baseline.baseline import HyperparameterGrid, prior_point
from semlive.diagnose.baseline.design_matrix import BaselineEffect, design
from semlive.diagnose.baseline.model_effects import effect_class
from semlive.diagnose.baseline.observation import Observation, StepConditions, drift_px, make_observation
from semlive.errors import IllPosed
from semlive.estimate.joint.elimination.elimination import eliminate_all
from semlive.estimate.joint.observations.accumulation import update
from semlive.estimate.joint.observations.normal_equations import relinearise
from semlive.estimate.joint.observations.priors import Hyperparameters
from semlive.estimate.joint.observations.state import EstimatorState, init
from semlive.estimate.joint.solution.posterior import Solution, posterior_from_elimination

Array = NDArray[np.float64]
POI_SIGMA_PX = 0.02  # without influence: whitening uses the noise of the diagnosed run


@dataclass(frozen=True, slots=True, eq=False)
class PlannedStep:
    """A planned step.

    Attributes:
        phase: phase of the pair.
        load_n: commanded load, N; 0 without a load frame.
        shift_px: commanded position of the stage or beam, px.
        hold_s: time from the end of the motion to the start of the first frame, s.
        start_s: (2,) start of its frames, seconds after the start of the run.
    """

    phase: Phase
    load_n: float
    shift_px: tuple[float, float]
    hold_s: float
    start_s: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class PlannedRun:
    """A planned run.

    Attributes:
        steps: steps in order.
        scan_time_ratio: dwell, row and frame time, as a multiple of those of the diagnosed run.
        duration_s: duration of the run, s.
    """

    steps: tuple[PlannedStep, ...]
    scan_time_ratio: float
    duration_s: float


def simulate_baseline(before: HyperparameterGrid, run: PlannedRun, model_effects: Sequence[ModelEffect] = ()) -> HyperparameterGrid:
    """Baseline of a planned run with one point, with the smoothness and noise of the diagnosed run.

    Distortion, strain per load and drift are those of the diagnosed run. Without moves of the image the distortion is not observable and
    absorbs nothing. The noise decreases with the square root of the dwell.

    Args:
        before: baseline of a run on the same specimen and grid.
        run: the planned run.
        model_effects: effects in the baseline; their amplitudes are free in the planned run, too.

    Raises:
        IllPosed: too few pairs to identify an effect, or blocks that leave the field.
    """
    observed, whiten = before.design.observation, before.design.whiten
    state = _state(observed, run)
    solution = _solution(state, before.best.hyper)
    conditions = [
        StepConditions(pair, step.phase, (step.load_n, step.load_n), step.shift_px, step.hold_s) for pair, step in enumerate(run.steps)
    ]
    simulated = make_observation(solution, conditions)
    if not np.array_equal(simulated.valid_blocks, observed.valid_blocks):
        raise IllPosed("the planned run moves blocks out of the field: no forecast is possible; plan smaller moves")
    at = np.arange(simulated.frames) % observed.frames
    simulated = replace(simulated, geometry=replace(simulated.geometry, drift_rate_px_s=observed.geometry.drift_rate_px_s[at]))
    columns = design(simulated, replace(whiten, sigma_px=whiten.sigma_px / np.sqrt(run.scan_time_ratio), over_frames=None))
    for model_effect in model_effects:
        basis_field = effect_class(model_effect.name).basis_field(simulated.geometry, dict(model_effect.values))
        if basis_field is not None:
            columns = columns.with_effects(BaselineEffect(columns.whiten(basis_field.field_px), model_effect.size_px))
    return prior_point(columns)


def _state(observation: Observation, run: PlannedRun) -> EstimatorState:
    observed_state, grid = observation.state, observation.grid
    timing = _scaled(observed_state.frame_time(int(observation.geometry.frame[0])).timing, run.scan_time_ratio)
    per_n, when_s, drift = (
        _gradient_per_n(observation),
        observation.geometry.start_s,
        drift_px(observation.solution, observation.geometry.time_s),
    )
    valid = np.isin(observed_state.blocks.block, observation.valid_blocks).reshape(grid.shape)
    state, first_s = init(observed_state.settings, grid, observed_state.width_px, observed_state.height_px), run.steps[0].start_s[0]
    for pair, step in enumerate(run.steps):
        frames = [2 * pair, 2 * pair + 1]
        times = [FrameTime(frame, start_s - first_s, timing) for frame, start_s in zip(frames, step.start_s, strict=True)]
        drift_px_by_frame = [[np.interp(time.start_s, when_s, drift[:, axis] - drift[0, axis]) for axis in (0, 1)] for time in times]
        moved = [_moved(observation, step.shift_px + np.array(by), step.load_n * per_n) for by in drift_px_by_frame]
        maps = tuple(_map(observation, frame, valid, u, v) for frame, (u, v) in zip(frames, moved, strict=True) if frame)
        state = update(state, pair, step.phase, (times[0], times[1]), maps)
    return state


def _scaled(timing: ScanTiming, by: float) -> ScanTiming:
    names = ("dwell_time_s", "row_time_s", "frame_time_s")
    return replace(timing, **{name: replace(quantity := getattr(timing, name), value=quantity.value * by) for name in names})


def _gradient_per_n(observation: Observation) -> Array:
    """(2, 2) displacement gradient per N of load, fitted to the frames under load."""
    scene = observation.geometry
    square = float(np.sum(scene.steps.load_n[scene.steps.loaded] ** 2))
    if not square:
        return np.zeros((2, 2))
    place = scene.address_px - scene.disparity_px
    total = np.zeros((2, 2))
    for frame in np.flatnonzero(scene.steps.loaded):
        columns = np.column_stack((place[frame], np.ones(len(place[frame]))))
        total += scene.steps.load_n[frame] * np.linalg.lstsq(columns, scene.disparity_px[frame], rcond=None)[0][:2].T
    return total / square


def _moved(observation: Observation, shift_px: Array, gradient: Array) -> tuple[Array, Array]:
    """(ny, nx) displacements of the points by the image motion and the distortion."""
    state, part = observation.state, observation.solution.part("distortion")
    x, y = (coordinates.ravel() for coordinates in observation.grid.mesh())
    own = shift_px[:, None] + gradient @ (np.stack((x, y)) - state.centre_px[:, None])
    distortion_px = [state.distortion.field(part, *place) for place in ((x + own[0], y + own[1]), (x, y))]
    u, v = (own + (distortion_px[0] - distortion_px[1]).T).reshape(2, *observation.grid.shape)
    return u, v


def _map(observation: Observation, frame: int, valid: NDArray[np.bool_], u: Array, v: Array) -> DisparityMap:
    status = np.where(valid, PoiStatus.CONVERGED, PoiStatus.LOW_ZNCC).astype(np.uint8)
    u, v, sigma = (np.ascontiguousarray(np.where(valid, value, 0.0)) for value in (u, v, np.full(valid.shape, POI_SIGMA_PX)))
    return DisparityMap(0, frame, observation.grid, u, v, sigma, sigma, np.ones(valid.shape), status)


def _solution(state: EstimatorState, hyper: Hyperparameters) -> Solution:
    hyper = replace(hyper, row_shift_px=0.0)
    zero_parameters = np.zeros(state.layout.size)
    first_estimate = posterior_from_elimination(eliminate_all(state, hyper, zero_parameters), (), POI_SIGMA_PX)
    return posterior_from_elimination(
        eliminate_all(relinearise(first_estimate.state, first_estimate.mean), hyper, first_estimate.mean), (), POI_SIGMA_PX
    )
