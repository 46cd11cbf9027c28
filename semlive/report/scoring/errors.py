"""Measured minus true, with what was stated of it: everything a score and its figures are made from."""

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
    """Drift within one frame, counted from its middle: across a motion drift is one number with the motion.

    Attributes:
        frame: number of the frame.
        time_s: (n,) seconds since frame 0 began.
        true_px: (n, 2) in the raster with its affine distortion, as for a shift.
        measured_px: (n, 2).
        sigma_px: (n, 2) stated.
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
    """Distortion minus truth over subsets, less the best affine map of the difference; unknown translations leave that map open.

    Attributes:
        grid: scan addresses.
        error_px: (ny, nx, 2), zero where not valid.
        sigma_px: (ny, nx) stated.
        valid: (ny, nx) where the run claims to know it.
        affine: (2, 2) gradient B of the map removed: true motion s and true drift d are measured as ``s + B s`` and ``d + B d``.
    """

    grid: Grid
    error_px: Field
    sigma_px: Field
    valid: NDArray[np.bool_]
    affine: Field


@dataclass(frozen=True, slots=True, eq=False)
class ShiftError:
    """Motion of the specimen's centre from pair 0 to a pair, drift across the motion included in what was stated.

    Attributes:
        pair: number of the pair.
        true_px: (2,) as unknown translations can tell it: in the raster with its affine distortion.
        measured_px: (2,).
        sigma_px: (2,) stated.
    """

    pair: int
    true_px: Field
    measured_px: Field
    sigma_px: Field


@dataclass(frozen=True, slots=True, eq=False)
class FrameErrors:
    """Displacement and strain of one frame.

    Attributes:
        frame: number of the frame.
        phase: of its pair.
        load_n: mean load, or None.
        valid: (ny, nx).
        displacement_px: (ny, nx, 2) error less its mean (a constant is drift across the motion), zero where not valid.
        sigma_px: (ny, nx, 2) stated.
        true_strain: (3,) exx, eyy, exy.
        mean_strain: (3,) measured.
        mean_sigma: (3,) stated.
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
    """A run against its truth.

    Attributes:
        grid: the POI.
        drift: of every frame.
        distortion: of the field.
        shifts: of every pair but the first.
        frames: every frame but frame 0.
        noise_floor_px: what the run says that its model leaves unexplained.
    """

    grid: Grid
    drift: tuple[DriftWithin, ...]
    distortion: DistortionError
    shifts: tuple[ShiftError, ...]
    frames: tuple[FrameErrors, ...]
    noise_floor_px: float


def compare_with_truth(result: RunResult, truth: Truth) -> RunErrors:
    """Everything that a run recovered against truth.

    Raises:
        BadInput: the truth lacks a frame of the run.
    """
    infos = dict(_infos(result))
    distortion = distortion_error(result.estimate.distortion, truth)
    frames = tuple(_frame_errors(one, _decision(result, one.summary.frame), infos, truth) for one in result.frames if one.summary.frame > 0)
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
    """A distortion field against truth as subsets show it, where it claims to be known."""
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
    for one in result.decisions:
        yield 2 * one.pair, one.first
        yield 2 * one.pair + 1, one.second


def _decision(result: RunResult, frame: int) -> PairDecision:
    return next(one for one in result.decisions if one.pair == frame // 2)


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
    """With E = E' + a + B R the raster that the run knows shows R - E'(R) = (p + a + B R) + d, and R itself moves with s + d.

    So s and d together appear as (1 + B) (s + d). How drift changes within frames shows that (1 + B) d of it is drift's, and
    (1 + B) s is left for the motion. (Counting B d as motion: 2.2e-3 px off without noise where it is 5e-4, B d being 1.8e-3.)

    A shift is that of the point which the estimate has at the image's centre in frame 0. Its drift and distortion begin at zero there, so
    that point lies tens of px from the specimen's centre, and what strain makes of that was 0.2 px at 3e-3.
    """
    zero = result.decisions[0]
    middle = _seen_in_the_middle(result, truth)
    decisions = {one.pair: one for one in result.decisions}
    for motion in result.estimate.motions:
        if motion.pair == zero.pair:
            continue
        infos = (decisions[motion.pair].first, decisions[motion.pair].second)
        moved = np.mean([true_motion(truth, zero.first, info, middle).displacement_px for info in infos], axis=0)
        yield ShiftError(motion.pair, moved + distortion.affine @ moved, motion.shift_px, motion.shift_sigma_px)


def _seen_in_the_middle(result: RunResult, truth: Truth) -> Field:
    """(2,) address at which frame 0 shows what the estimate has at the image's centre."""
    field, drift = result.estimate.distortion, result.estimate.drift
    inside = drift.frame == 0
    row, column = (
        int(np.argmin(np.abs(axis - at))) for axis, at in zip((field.grid.y_px, field.grid.x_px), truth.centre_px[::-1], strict=True)
    )
    first_s, row_s = drift.time_s[inside][0], truth.frame(result.decisions[0].first.name).row_time_s
    scan_s = first_s + truth.centre_px[1] * row_s
    drift_px = np.array([np.interp(scan_s, drift.time_s[inside], drift.drift_px[inside, axis]) for axis in (0, 1)])
    return truth.centre_px + drift_px + np.array([field.ex_px[row, column], field.ey_px[row, column]])


def _frame_errors(one: FrameResult, decision: PairDecision, infos: dict[int, FrameInfo], truth: Truth) -> FrameErrors:
    moved, said, frame = one.displacement, one.summary, one.summary.frame
    valid = moved.valid
    address = np.stack(moved.grid.mesh(), axis=-1)
    error = np.stack((moved.u_px, moved.v_px), axis=-1) - true_motion(truth, infos[0], infos[frame], address).displacement_px
    if valid.any():
        error = error - error[valid].mean(axis=0)
    gradient = strain_gradient(truth, infos[0], infos[frame])
    true_strain = np.array([gradient[0, 0], gradient[1, 1], 0.5 * (gradient[0, 1] + gradient[1, 0])])
    mean, sigma, sd = (np.array([getattr(part, name) for name in COMPONENTS]) for part in (said.mean, said.mean_sigma, said.sd))
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
        one.strain.window_points,
    )
