"""Conversion of the posterior to the types of `semlive.data`: drift samples, distortion field, motions, corrections."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap
from semlive.data.drift import Correction, DistortionField, DriftEstimate, EstimateRevision, FrameTime, PairMotion, RasterDrift
from semlive.data.experiment import Phase
from semlive.data.grid import Grid
from semlive.data.notes import Note, NoteCode, information, warning
from semlive.estimate.joint.elimination.smoother import LIVE_WINDOW_PAIRS, PairCovariance, distortion_covariance, pair_covariances
from semlive.estimate.joint.outputs.calibration_quality import (
    CalibrationAssessment,
    calibration,
    outside_region_notes,
    pointwise,
    support,
)
from semlive.estimate.joint.outputs.consistency import consistency
from semlive.estimate.joint.outputs.correction_strain import frame_observations
from semlive.estimate.joint.outputs.drift_forecast import forecast
from semlive.estimate.joint.solution.posterior import Solution
from semlive.model import Effect, MotionKind, RasterChange, evaluate_drift, predicted_offsets, sighting

SAMPLES_PER_FRAME = 12
MODEL_MISFIT_FACTOR = 2.0  # times the stated noise; rendered frames and the numerical experiment stay within 1.1


def to_estimate(solution: Solution, revision: int, newest_only: bool = False) -> EstimateRevision:
    """Convert the solution to one revision; with `newest_only`, only pairs among the newest `LIVE_WINDOW_PAIRS` are included."""
    state = solution.state
    assessment = calibration(solution)
    distortion = _distortion(solution, assessment)
    by_pair = {
        pair_covariance.pair: _of_pair(solution, pair_covariance)
        for pair_covariance in pair_covariances(solution.shared_posterior, LIVE_WINDOW_PAIRS if newest_only else None)
    }
    motions = tuple(by_pair[pair].motion for pair in (0, *state.motions.pairs) if pair in by_pair)
    frames = sorted(
        (frame for pair_correction in by_pair.values() for frame in pair_correction.frames),
        key=lambda pair_correction: _start(pair_correction.when),
    )
    drift, wander = _drift(solution, revision, frames), _wander(solution, frames)
    return EstimateRevision(
        drift,
        distortion,
        motions,
        solution.noise_floor_px,
        _notes(solution, assessment, by_pair),
        solution.terms,
        wander,
        assessment.quality(),
    )


def consistency_notes(solution: Solution) -> tuple[Note, ...]:
    """Results of the consistency checks; a warning where a check fails."""
    notes = [check.note() for check in consistency(solution)]
    if solution.hyper.noise_scale > MODEL_MISFIT_FACTOR:
        text = (
            f"the residual of the model is {solution.noise_floor_px:.2g} px, {solution.hyper.noise_scale:.1f} times the noise of "
            "the correlation: an effect is missing from the model"
        )
        notes.append(warning(NoteCode.MODEL_MISFIT, text))
    return tuple(notes)


def current_drift_rate(solution: Solution) -> NDArray[np.float64]:
    """(2,) drift rate in px/s at the end of the newest frame."""
    drift = solution.state.drift
    assert drift is not None  # a solution has data
    newest = solution.state.frames[-1]
    rate = drift.rate_rows([newest.start_s + newest.timing.duration_s]) @ solution.part("drift").reshape(-1, 2)
    return rate[0]


def correction(solution: Solution, dmap: DisparityMap) -> Correction:
    """Drift and distortion in a map from frame 0, to be subtracted to obtain displacement.

    Points outside the scan addresses observed in calibration are marked, because the distortion there would be extrapolated.

    Raises:
        IllPosed: the frame of the map is not part of the estimate.
    """
    model, parameters = _acting(solution)
    _, current = frame_observations(solution, dmap)
    both = predicted_offsets(model, parameters, current) - _at_reference(solution, dmap.grid)
    both += solution.state.start_time_errors.late_px(dmap.current, solution.part("start_time"))
    both[~dmap.valid.ravel()] = 0.0
    u, v = (np.ascontiguousarray(value.reshape(dmap.grid.shape)) for value in both.T)
    u.setflags(write=False)
    v.setflags(write=False)
    area, valid = support(solution.state), None
    if area is not None and dmap.current > 1:
        valid = area.holds(current.x_px, current.y_px).reshape(dmap.grid.shape)
        valid.setflags(write=False)
    return Correction(dmap.current, u, v, valid)


def _acting(solution: Solution) -> tuple[tuple[Effect, ...], NDArray[np.float64]]:
    """Effects at the scan address with their parameters, without effects held at zero (to 1e-9 px)."""
    held = {
        raster_effect.name for raster_effect, size_px in zip(solution.state.raster, solution.hyper.raster_px, strict=True) if not size_px
    }
    model = tuple(effect for effect in solution.state.model if not effect.needs_ideal and effect.name not in held and effect.size)
    return model, np.concatenate([solution.part(effect.name) for effect in model])


@lru_cache(maxsize=1)
def _at_reference(solution: Solution, grid: Grid) -> NDArray[np.float64]:
    """(n, 2) displacement by the effects at the points of frame 0, px, common to all maps: half of the time of a correction."""
    observation = sighting(solution.state.frame_time(0), *grid.mesh())
    model, parameters = _acting(solution)
    found = predicted_offsets(model, parameters, evaluate_drift(model, parameters, observation))
    found.setflags(write=False)
    return found


def mean_strain_covariance(solution: Solution, frames: Sequence[int], of: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
    """(2 n, 2 n) joint covariance of the mean strains of n frames, first all exx, then all eyy.

    If `of` is given: (k, k) covariance of the functions `of` (k, 2 n).

    Errors of distortion and drift are common to the frames and may grow with load, because the specimen travels under load. Treating
    them as independent underestimates the uncertainty of Young's modulus. The displacement gradients of the pairs contain them and the DIC
    noise. Frames of one pair share a gradient; frames without a free gradient have zeros.
    """
    motions, start, count = solution.state.motions, solution.state.layout.part("motion").start, len(frames)
    of = np.eye(2 * count) if of is None else of
    rows = np.zeros((len(of), len(solution.mean)))
    for at, frame in enumerate(frames):
        if frame // 2 in motions.pairs:
            part, kind = motions.part(frame // 2)
            if kind is MotionKind.GRADIENT:
                rows[:, start + part.start + 1] += of[:, at]
                rows[:, start + part.start + 5] += of[:, count + at]
    return solution.covariance_of(rows)


@dataclass(frozen=True, slots=True, eq=False)
class _OfFrame:
    """Results for one frame.

    Attributes:
        when: scan times of the frame.
        time_s: (t,) sample times of the drift, s.
        drift_px: (t, 2) drift at these times, px.
        variance_px2: (t, 2) variance of the drift change from the middle of the frame, px^2.
        rate_px_s: (t, 2) drift rate, px/s.
        wander: value and variance of each raster term at the middle of the frame.
    """

    when: FrameTime
    time_s: NDArray[np.float64]
    drift_px: NDArray[np.float64]
    variance_px2: NDArray[np.float64]
    rate_px_s: NDArray[np.float64]
    wander: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True, eq=False)
class _OfPair:
    """Results for one pair, without the covariances, which need a hundred times the memory."""

    motion: PairMotion
    frames: tuple[_OfFrame, _OfFrame]


def _of_pair(solution: Solution, spread: PairCovariance) -> _OfPair:
    first, second = (_of_frame(solution, solution.state.frame_time(2 * spread.pair + member), spread) for member in (0, 1))
    return _OfPair(_motion(solution, spread), (first, second))


def _of_frame(solution: Solution, when: FrameTime, spread: PairCovariance) -> _OfFrame:
    drift, layout = solution.state.drift, solution.state.layout
    assert drift is not None  # a solution has data
    start, parameters = layout.part("drift").start, solution.part("drift").reshape(-1, 2)
    time_s = when.start_s + np.append(np.linspace(0.0, 1.0, SAMPLES_PER_FRAME), 0.5) * when.timing.duration_s
    (index, value), (_, rate) = drift.spline.local(time_s), drift.spline.local_rate(time_s)
    first = int(index.min())
    rows = np.zeros((len(time_s), int(index.max()) + 1 - first))
    np.put_along_axis(rows, index - first, value, axis=1)
    change = rows[:-1] - rows[-1]
    knots = start + 2 * np.arange(first, first + rows.shape[1])
    return _OfFrame(
        when,
        time_s[:-1],
        np.einsum("nk,nkc->nc", value, parameters[index])[:-1],
        np.stack([np.einsum("ni,ij,nj->n", change, spread.of(knots + axis), change) for axis in (0, 1)], axis=1),
        np.einsum("nk,nkc->nc", rate, parameters[index])[:-1],
        tuple(_wandered(solution, change, when, spread) for change in solution.state.raster),
    )


def _wandered(solution: Solution, change: RasterChange, when: FrameTime, spread: PairCovariance) -> tuple[float, float]:
    index, value = change.spline.local([when.start_s + 0.5 * when.timing.duration_s])
    at, row = solution.state.layout.part(change.name).start + index[0], value[0] / change.radius_px
    return float(row @ solution.mean[at]), float(row @ spread.of(at) @ row)


def _wander(solution: Solution, frames: Sequence[_OfFrame]) -> RasterDrift:
    values = []
    for number, _ in enumerate(solution.state.raster):
        found, variance = np.array([frame.wander[number] for frame in frames]).T
        values += [np.ascontiguousarray(found), np.sqrt(np.clip(variance, 0.0, None))]
    return RasterDrift(np.array([frame.when.frame for frame in frames], dtype=np.int64), *values)


def _drift(solution: Solution, revision: int, frames: Sequence[_OfFrame]) -> DriftEstimate:
    return DriftEstimate(
        np.concatenate([frame.time_s for frame in frames]),
        np.repeat([frame.when.frame for frame in frames], SAMPLES_PER_FRAME).astype(np.int64),
        np.concatenate([frame.drift_px for frame in frames]),
        np.sqrt(np.clip(np.concatenate([frame.variance_px2 for frame in frames]), 0.0, None)),
        np.concatenate([frame.rate_px_s for frame in frames]),
        revision,
        forecast(solution),
    )


def _distortion(solution: Solution, assessment: CalibrationAssessment) -> DistortionField:
    state, grid = solution.state, solution.state.grid
    part = state.layout.part("distortion")
    x, y = grid.mesh()
    ex, ey = (value.reshape(grid.shape) for value in state.distortion.field(solution.mean[part], x, y).T)
    covariance = distortion_covariance(solution.shared_posterior)
    variance = 0.5 * (pointwise(state, covariance[0::2, 0::2]) + pointwise(state, covariance[1::2, 1::2]))
    return DistortionField(grid, ex, ey, np.sqrt(variance), assessment.covered)


def _motion(solution: Solution, spread: PairCovariance) -> PairMotion:
    motions, pair = solution.state.motions, spread.pair
    shift, gradient = motions.shift_and_gradient(pair, solution.part("motion"))
    shift_sigma, gradient_sigma = np.zeros(2), np.zeros((2, 2))
    if pair in motions.pairs:
        part, kind = motions.part(pair)
        start = solution.state.layout.part("motion").start
        sigma = np.sqrt(np.diag(spread.of(start + np.arange(part.start, part.stop))))
        if kind is MotionKind.RIGID:
            shift_sigma, gradient_sigma = sigma[:2], np.array([[0.0, sigma[2]], [sigma[2], 0.0]])
        else:
            shift_sigma, gradient_sigma = sigma[[0, 3]], sigma[[1, 2, 4, 5]].reshape(2, 2)
    return PairMotion(pair, shift, shift_sigma, gradient, gradient_sigma)


def _notes(solution: Solution, assessment: CalibrationAssessment, pairs: Collection[int]) -> tuple[Note, ...]:
    notes: list[Note] = []
    if not assessment.sufficient:
        warned = "WARNING, the load steps are corrected with it all the same: " if Phase.TENSION in solution.state.phases else ""
        # No warning of the live run: control evaluates the quality of the calibration by itself.
        notes.append(information(NoteCode.CALIBRATION, warned + assessment.message()))
    else:
        text = (
            "the affine part of the distortion is not determined by unknown translations and set to zero: it scales strain, it makes none"
        )
        notes.append(information(NoteCode.CALIBRATION, text))
    notes += outside_region_notes(solution.state, pairs)
    notes += _term_notes(solution)
    frames = sorted(solution.state.frames, key=_start)
    gap_s = max((after.start_s - before.start_s - before.timing.duration_s for before, after in itertools.pairwise(frames)), default=0.0)
    if gap_s > 0:
        text = f"drift between pairs is interpolated over gaps of up to {gap_s:.0f} s: motion of the specimen there looks like drift"
        notes.append(information(NoteCode.DRIFT_GAP, text))
    return tuple(notes)


def _term_notes(solution: Solution) -> list[Note]:
    tests = {term.name: term for term in solution.terms}
    texts: list[str] = []
    gamma = tests.get("coupling")
    if gamma is not None and gamma.included:
        texts.append(
            f"the drift carries the distortion along (gamma {gamma.value:.2f} +- {gamma.sigma:.2f} before, 1 taken): E is at R - d"
        )
    lines = tests.get("line_shift")
    if lines is not None and lines.included:
        size_px = solution.hyper.row_shift_px
        texts.append(f"rows are shifted along x by {size_px:.2g} px, otherwise in every frame (evidence {lines.evidence:.0f}): corrected")
    strained = Phase.TENSION in solution.state.phases
    for name, strain in (("magnification", "strain"), ("raster_rotation", "rotation of the specimen")):
        if name in tests and tests[name].included:
            text = f"the {name.replace('_', ' ')} drifts (evidence {tests[name].evidence:.0f}) and is corrected"
            end = f", under load only its smooth part: a step of it cannot be separated from {strain}" if strained else ""
            texts.append(text + end)
    return [information(NoteCode.MODEL_TERM, text) for text in texts]


def _start(when: FrameTime) -> float:
    return when.start_s
