"""Errors of a run, measured minus true, with their stated uncertainties; input of scores and their figures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.data.drift import DistortionField
from semlive.data.experiment import Phase
from semlive.data.frame import FrameInfo
from semlive.data.grid import Grid
from semlive.data.pair import PairDecision
from semlive.data.results import FrameResult, RunResult
from semlive.report.scoring.truth import Truth, average_over_subset, strain_gradient, true_motion

Field = NDArray[np.float64]
COMPONENTS = ("exx", "eyy", "exy")


@dataclass(frozen=True, slots=True, eq=False)
class DriftWithin:
    """Drift within one frame relative to its middle, because drift between frames is not separable from motion.

    Attributes:
        frame: number of the frame.
        time_s: (n,) seconds since frame 0 began.
        true_px: (n, 2) true drift in the raster with its affine distortion, as for a shift.
        measured_px: (n, 2) measured drift.
        sigma_px: (n, 2) stated standard uncertainty.
    """

    frame: int
    time_s: Field
    true_px: Field
    measured_px: Field
    sigma_px: Field

    @property
    def error_px(self) -> Field:
        """(n, 2) measured minus true."""
        return self.measured_px - self.true_px


@dataclass(frozen=True, slots=True, eq=False)
class DistortionError:
    """Distortion minus truth over subsets, minus the best affine map of the difference, which unknown translations do not determine.

    Attributes:
        grid: scan addresses.
        error_px: (ny, nx, 2), zero where not valid.
        sigma_px: (ny, nx) stated standard uncertainty.
        valid: (ny, nx) points with a valid distortion.
        affine: (2, 2) gradient B of the map removed: true motion s and true drift d are measured as ``s + B s`` and ``d + B d``.
    """

    grid: Grid
    error_px: Field
    sigma_px: Field
    valid: NDArray[np.bool_]
    affine: Field


@dataclass(frozen=True, slots=True, eq=False)
class ShiftError:
    """Motion of the specimen's centre from pair 0 to a pair; the stated uncertainty includes the drift during the motion.

    Attributes:
        pair: number of the pair.
        true_px: (2,) true motion in the raster with its affine distortion, as observable with unknown translations.
        measured_px: (2,) measured motion.
        sigma_px: (2,) stated standard uncertainty.
    """

    pair: int
    true_px: Field
    measured_px: Field
    sigma_px: Field


@dataclass(frozen=True, slots=True, eq=False)
class FrameErrors:
    """Errors of displacement and strain of one frame.

    Attributes:
        frame: number of the frame.
        phase: phase of the pair.
        load_n: mean load, or None.
        valid: (ny, nx) valid points.
        displacement_px: (ny, nx, 2) error minus its mean (a constant is drift during the motion), zero where not valid.
        sigma_px: (ny, nx, 2) stated standard uncertainty.
        true_strain: (3,) exx, eyy, exy.
        mean_strain: (3,) measured mean strain.
        mean_sigma: (3,) stated standard uncertainty of the mean.
        strain_sd: (3,) scatter over the field.
        window_points: edge of the gauge.
    """

    frame: int
    phase: Phase
    load_n: float | None
    valid: NDArray[np.bool_]
    displacement_px: Field
    sigma_px: Field
    true_strain: Field
    mean_strain: Field
    mean_sigma: Field
    strain_sd: Field
    window_points: int


@dataclass(frozen=True, slots=True, eq=False)
class RunErrors:
    """Errors of a run.

    Attributes:
        grid: the POI.
        drift: errors of every frame.
        distortion: error of the distortion.
        shifts: errors of every pair except the first.
        frames: errors of every frame except frame 0.
        noise_floor_px: noise floor estimated by the run.
    """

    grid: Grid
    drift: tuple[DriftWithin, ...]
    distortion: DistortionError
    shifts: tuple[ShiftError, ...]
    frames: tuple[FrameErrors, ...]
    noise_floor_px: float


def compare_with_truth(result: RunResult, truth: Truth) -> RunErrors:
    """Compare all results of a run with the truth.

    Raises:
        BadInput: the truth lacks a frame of the run.
    """
    infos = dict(_infos(result))
    distortion = distortion_error(result.estimate.distortion, truth)
    frames = tuple(
        _frame_errors(frame, _decision(result, frame.summary.frame), infos, truth) for frame in result.frames if frame.summary.frame > 0
    )
    grid = result.frames[0].displacement.grid
    floor_px = result.estimate.noise_floor_px
    return RunErrors(
        grid,
        tuple(_drift(result, truth, infos, distortion.affine)),
        distortion,
        tuple(_shifts(result, truth, distortion)),
        frames,
        floor_px,
    )


def distortion_error(field: DistortionField, truth: Truth) -> DistortionError:
    """Error of a distortion field relative to the truth averaged over subsets, at valid points."""
    x, y = field.grid.mesh()
    address, valid = np.stack((x, y), axis=-1), field.valid
    difference = np.stack((field.ex_px, field.ey_px), axis=-1) - average_over_subset(truth.distortion_at, address, field.grid.subset_px)
    error = np.zeros_like(difference)
    affine: Field = np.zeros((2, 2))
    if valid.any():
        columns = np.column_stack((np.ones(int(valid.sum())), address[valid] - truth.centre_px))
        plane = np.linalg.lstsq(columns, difference[valid], rcond=None)[0]
        error[valid] = difference[valid] - columns @ plane
        affine = -np.asarray(plane[1:].T, dtype=np.float64)
    return DistortionError(field.grid, error, field.sigma_px, valid, affine)


def _infos(result: RunResult) -> Iterator[tuple[int, FrameInfo]]:
    for decision in result.decisions:
        yield 2 * decision.pair, decision.first
        yield 2 * decision.pair + 1, decision.second


def _decision(result: RunResult, frame: int) -> PairDecision:
    return next(decision for decision in result.decisions if decision.pair == frame // 2)


def _drift(result: RunResult, truth: Truth, infos: dict[int, FrameInfo], affine: Field) -> Iterator[DriftWithin]:
    drift = result.estimate.drift
    for frame in np.unique(drift.frame):
        inside = drift.frame == frame
        time_s = drift.time_s[inside]
        true_px = truth.drift_at(truth.frame(infos[int(frame)].name), time_s - time_s[0]) @ (np.eye(2) + affine).T
        yield DriftWithin(
            int(frame), time_s, _from_middle(time_s, true_px), _from_middle(time_s, drift.drift_px[inside]), drift.sigma_px[inside]
        )


def _from_middle(time_s: Field, value_px: Field) -> Field:
    middle_s = 0.5 * (time_s[0] + time_s[-1])
    return value_px - np.array([np.interp(middle_s, time_s, value_px[:, axis]) for axis in (0, 1)])


def _shifts(result: RunResult, truth: Truth, distortion: DistortionError) -> Iterator[ShiftError]:
    """Errors of the shifts, with the affine part a + B R of the distortion E = E' + a + B R that translations do not determine.

    The raster of the run gives R - E'(R) = (p + a + B R) + d, so motion s and drift d appear as (1 + B) (s + d). The change of drift within
    frames determines (1 + B) d as drift, so the motion is (1 + B) s. (With B d = 1.8e-3 px counted as motion, the error without noise is
    2.2e-3 px instead of 5e-4 px.)

    A shift is that of the point at the image centre of frame 0 in the estimate. Drift and distortion are zero there by definition, so that
    point is tens of px from the specimen's centre; without this a strain of 3e-3 caused an error of 0.2 px.
    """
    zero = result.decisions[0]
    middle = _centre_address(result, truth)
    decisions = {decision.pair: decision for decision in result.decisions}
    for motion in result.estimate.motions:
        if motion.pair == zero.pair:
            continue
        infos = (decisions[motion.pair].first, decisions[motion.pair].second)
        moved = np.mean([true_motion(truth, zero.first, info, middle).displacement_px for info in infos], axis=0)
        yield ShiftError(motion.pair, moved + distortion.affine @ moved, motion.shift_px, motion.shift_sigma_px)


def _centre_address(result: RunResult, truth: Truth) -> Field:
    """(2,) scan address in frame 0 of the point that the estimate places at the image centre."""
    field, drift = result.estimate.distortion, result.estimate.drift
    inside = drift.frame == 0
    row, column = (
        int(np.argmin(np.abs(axis - at))) for axis, at in zip((field.grid.y_px, field.grid.x_px), truth.centre_px[::-1], strict=True)
    )
    first_s, row_s = drift.time_s[inside][0], truth.frame(result.decisions[0].first.name).row_time_s
    scan_s = first_s + truth.centre_px[1] * row_s
    drift_px = np.array([np.interp(scan_s, drift.time_s[inside], drift.drift_px[inside, axis]) for axis in (0, 1)])
    return truth.centre_px + drift_px + np.array([field.ex_px[row, column], field.ey_px[row, column]])


def _frame_errors(result: FrameResult, decision: PairDecision, infos: dict[int, FrameInfo], truth: Truth) -> FrameErrors:
    moved, summary, frame = result.displacement, result.summary, result.summary.frame
    valid = moved.valid
    address = np.stack(moved.grid.mesh(), axis=-1)
    error = np.stack((moved.u_px, moved.v_px), axis=-1) - true_motion(truth, infos[0], infos[frame], address).displacement_px
    if valid.any():
        error = error - error[valid].mean(axis=0)
    gradient = strain_gradient(truth, infos[0], infos[frame])
    true_strain = np.array([gradient[0, 0], gradient[1, 1], 0.5 * (gradient[0, 1] + gradient[1, 0])])
    mean, sigma, sd = (np.array([getattr(part, name) for name in COMPONENTS]) for part in (summary.mean, summary.mean_sigma, summary.sd))
    return FrameErrors(
        frame,
        decision.step.phase,
        decision.loads[frame % 2].mean_n if decision.loads else None,
        valid,
        np.where(valid[..., None], error, 0.0),
        np.stack((moved.sigma_u_px, moved.sigma_v_px), axis=-1),
        true_strain,
        mean,
        sigma,
        sd,
        result.strain.window_points,
    )
