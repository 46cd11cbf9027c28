"""Results of the procedure as values of `semlive.data`, like those of the joint method."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap
from semlive.data.drift import CalibrationQuality, Correction, DistortionField, DriftEstimate, EstimateRevision, FrameTime, PairMotion
from semlive.data.notes import Note, NoteCode, information
from semlive.data.strain import Tensor2
from semlive.estimate.sutton.procedure import SuttonSolution
from semlive.estimate.sutton.start_times import start_time_strain
from semlive.estimate.sutton.state import PairMaps

Array = NDArray[np.float64]
SAMPLES_PER_FRAME = 12
UNKNOWN_PX = 1e3  # uncertainty of the distortion where no data determine it
MIN_SPAN_PX = 4.0  # translations along an axis that differ by less than this do not show distortion along it


@dataclass(frozen=True, slots=True, eq=False)
class CorrectionStrain:
    """Mean strain of the correction of a map at one time.

    Attributes:
        dmap: the map.
        value: exx, eyy and exy then.
        sigma: standard uncertainty then.
    """

    dmap: DisparityMap
    value: Tensor2
    sigma: Tensor2


def to_estimate(solution: SuttonSolution, revision: int, newest_only: bool = False) -> EstimateRevision:
    """The complete estimate as one revision; a batch contains all pairs."""
    del newest_only
    distortion = _distortion(solution)
    motions = tuple(_motion(solution, pair) for pair in solution.state.pairs)
    quality, notes = _quality(solution, distortion), _notes(solution, distortion)
    return EstimateRevision(_drift(solution, revision), distortion, motions, solution.noise_floor_px, notes, calibration=quality)


def consistency_notes(solution: SuttonSolution) -> tuple[Note, ...]:
    """The published procedure has no checks of its own."""
    del solution
    return ()


def correction(solution: SuttonSolution, dmap: DisparityMap) -> Correction:
    """Drift and distortion in a map from frame 0, to be subtracted to get displacement.

    Raises:
        IllPosed: the map's frame is not part of the estimate.
    """
    if dmap.reference != 0:
        raise ValueError(f"corrections are for maps from frame 0, not from frame {dmap.reference}")
    here = np.stack(dmap.grid.mesh(), axis=-1).reshape(-1, 2)
    there = here + np.stack((dmap.u_px.ravel(), dmap.v_px.ravel()), axis=1)
    state = solution.state
    both = solution.correction_px(there, state.frame_time(dmap.current)) - solution.correction_px(here, state.frame_time(0))
    both[~dmap.valid.ravel()] = 0.0
    u, v = (np.ascontiguousarray(value.reshape(dmap.grid.shape)) for value in both.T)
    u.setflags(write=False)
    v.setflags(write=False)
    return Correction(dmap.current, u, v)


def correction_strain_sigma(solution: SuttonSolution, dmap: DisparityMap) -> Tensor2:
    """Standard uncertainty that the correction gives to the mean strain of a map from frame 0.

    The local drift's error is taken as independent between patches as large as its smoothing kernel, which is what white
    noise of the disparities makes of it; the distortion's error is left out, and the paper's procedure offers no more.
    """
    valid, grid = dmap.valid, dmap.grid
    if valid.sum() < 3:
        return Tensor2(np.inf, np.inf, np.inf)
    patch_px = max(np.sqrt(4.0 * np.pi) * solution.state.settings.sutton_smoothing_px, float(grid.subset_px))
    shared = max(patch_px / grid.step_px, 1.0)
    x, y = (coordinates[valid] for coordinates in grid.mesh())
    sigma = _drift_sigma_px(solution, solution.state.frame_time(dmap.current)) * shared
    along_x, along_y = (sigma / (np.std(value) * np.sqrt(value.size) + 1e-12) for value in (x, y))
    late = _by_start_times(solution, dmap.current // 2)
    return Tensor2(
        float(np.hypot(along_x, late.exx)), float(np.hypot(along_y, late.eyy)), float(np.hypot(0.5 * np.hypot(along_x, along_y), late.exy))
    )


def _by_start_times(solution: SuttonSolution, pair: int) -> Tensor2:
    """What the uncertain starts of a pair's scans do to the strain of its frames."""
    own = next(pair_maps for pair_maps in solution.state.pairs if pair_maps.pair == pair)
    if own.within is None or not own.within.valid.any():
        return Tensor2(0.0, 0.0, 0.0)
    return start_time_strain(own.times, [float(component[own.within.valid].mean()) for component in (own.within.u_px, own.within.v_px)])


def correction_sigmas(solution: SuttonSolution, maps: Iterable[DisparityMap]) -> tuple[None, ...]:
    """None for each map: the procedure gives the uncertainty of the mean strain only, not of points."""
    del solution
    return tuple(None for _ in maps)


def correction_strains(solution: SuttonSolution, maps: Iterable[DisparityMap]) -> tuple[CorrectionStrain, ...]:
    """What the correction of maps from frame 0 gives to their mean strain, and how uncertain that is."""
    return tuple(CorrectionStrain(dmap, _strain_of(solution, dmap), correction_strain_sigma(solution, dmap)) for dmap in maps)


def strain_change(solution: SuttonSolution, previous: CorrectionStrain) -> Tensor2:
    """How far the mean strain of a corrected map would move if it were corrected with another solution."""
    now = _strain_of(solution, previous.dmap)
    return Tensor2(previous.value.exx - now.exx, previous.value.eyy - now.eyy, previous.value.exy - now.exy)


def _strain_of(solution: SuttonSolution, dmap: DisparityMap) -> Tensor2:
    found, valid = correction(solution, dmap), dmap.valid
    if valid.sum() < 3:
        return Tensor2(0.0, 0.0, 0.0)
    position = np.column_stack((np.ones(int(valid.sum())), *(coordinates[valid] for coordinates in dmap.grid.mesh())))
    moved = np.stack((found.u_px[valid], found.v_px[valid]), axis=1)
    slope = np.asarray(np.linalg.lstsq(position, moved, rcond=None)[0], dtype=np.float64)[1:]
    return Tensor2(float(slope[0, 0]), float(slope[1, 1]), 0.5 * float(slope[0, 1] + slope[1, 0]))


def mean_strain_covariance(solution: SuttonSolution, frames: Sequence[int], of: Array | None = None) -> Array:
    """(2 n, 2 n) covariance of the mean strains of n frames, first all exx, then all eyy; or (k, k) of functions (k, 2 n) `of` them.

    Frames are taken as independent.
    """
    sigma = [correction_strain_sigma(solution, dmap) for frame in frames for dmap in [_from_reference(solution, frame)]]
    noise = [_mean_noise(solution, frame) for frame in frames]
    along_x = [np.hypot(value.exx, two[0]) for value, two in zip(sigma, noise, strict=True)]
    along_y = [np.hypot(value.eyy, two[1]) for value, two in zip(sigma, noise, strict=True)]
    variance = np.array([*along_x, *along_y], dtype=np.float64) ** 2
    return np.diag(variance) if of is None else (of * variance) @ of.T


def _from_reference(solution: SuttonSolution, frame: int) -> DisparityMap:
    maps = (dmap for pair in solution.state.pairs for dmap in pair.maps)
    return next(dmap for dmap in maps if dmap.reference == 0 and dmap.current == frame)


def _mean_noise(solution: SuttonSolution, frame: int) -> tuple[float, float]:
    """Standard uncertainty along x and y that the DIC noise of a map gives to its mean strain."""
    dmap = _from_reference(solution, frame)
    grid = dmap.grid
    x, y = (coordinates[dmap.valid] for coordinates in grid.mesh())
    each = solution.noise_floor_px * max(grid.subset_px, grid.step_px) / grid.step_px
    along_x, along_y = (float(each / (np.std(value) * np.sqrt(value.size) + 1e-12)) for value in (x, y))
    return along_x, along_y


def _drift_sigma_px(solution: SuttonSolution, when: FrameTime) -> float:
    drift = solution.drift_of(when.frame)
    middles = [
        0.5 * (pair.times[0].start_s + pair.times[1].start_s)
        for pair in solution.state.pairs
        if pair.within is not None and solution.drift_of(pair.times[0].frame) is drift
    ]
    return drift.sigma_px(when, np.array(middles))


def _drift(solution: SuttonSolution, revision: int) -> DriftEstimate:
    """Drift in the middle column of the grid, at several rows; Fig. 5 of the paper shows the middle of the grid."""
    state = solution.state
    grid = state.grid
    frames = sorted(state.frames, key=_start)
    rows = np.linspace(0.0, state.height_px - 1.0, SAMPLES_PER_FRAME)
    column = np.stack((np.full(SAMPLES_PER_FRAME, float(np.mean(grid.x_px))), rows), axis=1)
    time_s = [when.start_s + when.timing.time_in_frame_s(column[:, 0], column[:, 1]) for when in frames]
    drift = [solution.drift_of(when.frame).at(column, when) for when in frames]
    rate = [solution.drift_of(when.frame).rate_at(column, when) for when in frames]
    sigma = [np.full((SAMPLES_PER_FRAME, 2), _drift_sigma_px(solution, when)) for when in frames]
    return DriftEstimate(
        np.concatenate(time_s),
        np.repeat([when.frame for when in frames], SAMPLES_PER_FRAME).astype(np.int64),
        np.concatenate(drift),
        np.concatenate(sigma),
        np.concatenate(rate),
        revision,
    )


def _distortion(solution: SuttonSolution) -> DistortionField:
    grid = solution.state.grid
    here = np.stack(grid.mesh(), axis=-1).reshape(-1, 2)
    bundle = solution.bundle
    if bundle is None:
        nothing = np.zeros(grid.shape)
        return DistortionField(grid, nothing, nothing, np.full(grid.shape, UNKNOWN_PX), np.zeros(grid.shape, dtype=np.bool_))
    ex, ey = (np.ascontiguousarray(value.reshape(grid.shape)) for value in bundle.surface.at(here).T)
    rows = bundle.surface.rows(here)
    variance = np.asarray((rows @ bundle.covariance * rows.toarray()).sum(axis=1)).reshape(grid.shape)
    shared = _shared_points(solution)
    drift = np.mean([_drift_sigma_px(solution, pair.times[0]) for pair in solution.state.pairs if pair.calibrates])
    each = np.hypot(bundle.residual_px * shared, drift * shared)
    sigma = np.sqrt(np.clip(variance, 0.0, None)) * each
    shifts = np.array(list(bundle.shifts_px.values()))
    both = len(shifts) >= 2 and bool(np.all(np.ptp(np.concatenate((shifts, np.zeros((1, 2)))), axis=0) >= MIN_SPAN_PX))
    return DistortionField(grid, ex, ey, sigma, np.full(grid.shape, both))


def _quality(solution: SuttonSolution, distortion: DistortionField) -> CalibrationQuality:
    """By how far the translations went along each axis alone."""
    bundle = solution.bundle
    shifts = (
        np.zeros((1, 2)) if bundle is None else np.concatenate((np.array(list(bundle.shifts_px.values())).reshape(-1, 2), np.zeros((1, 2))))
    )
    x_px, y_px = (float(value) for value in np.ptp(shifts, axis=0))
    refused = (
        f"distortion not determined yet: needs translations in both directions; the pairs so far moved {x_px:.3g} px along x and "
        f"{y_px:.3g} px along y, and at least {MIN_SPAN_PX:g} px along both are needed"
    )
    covered = float(distortion.valid.mean())
    return CalibrationQuality(covered, (x_px, y_px), None, "" if covered == 1.0 else refused)


def _shared_points(solution: SuttonSolution) -> float:
    """Root of how many POI together are worth one independent one, where errors are those of smoothed drift."""
    grid = solution.state.grid
    patch_px = max(np.sqrt(4.0 * np.pi) * solution.state.settings.sutton_smoothing_px, float(grid.subset_px), float(grid.step_px))
    return float(patch_px / grid.step_px)


def _motion(solution: SuttonSolution, pair_maps: PairMaps) -> PairMotion:
    """Motion from the bundle in calibration; otherwise the best affine map of the residual after correction."""
    if pair_maps.pair == 0:
        return PairMotion(0, np.zeros(2), np.zeros(2), np.zeros((2, 2)), np.zeros((2, 2)))
    bundle = solution.bundle
    if pair_maps.calibrates and bundle is not None and pair_maps.pair in bundle.shifts_px:
        sigma = bundle.shift_sigma[pair_maps.pair] * bundle.residual_px * _shared_points(solution)
        sigma = np.hypot(sigma, _drift_sigma_px(solution, pair_maps.times[0]))
        return PairMotion(pair_maps.pair, bundle.shifts_px[pair_maps.pair].copy(), np.full(2, sigma), np.zeros((2, 2)), np.zeros((2, 2)))
    found = [_affine(solution, dmap) for dmap in pair_maps.maps if dmap.reference == 0 and dmap.valid.sum() >= 3]
    if not found:
        return PairMotion(pair_maps.pair, np.zeros(2), np.full(2, UNKNOWN_PX), np.zeros((2, 2)), np.full((2, 2), 1.0))
    shift, gradient = np.mean([a for a, _ in found], axis=0), np.mean([b for _, b in found], axis=0)
    frame = next(dmap.current for dmap in pair_maps.maps if dmap.reference == 0)
    systematic, noise = correction_strain_sigma(solution, _from_reference(solution, frame)), _mean_noise(solution, frame)
    along = np.hypot([systematic.exx, systematic.eyy], noise)
    sigma = np.hypot(solution.noise_floor_px, _drift_sigma_px(solution, pair_maps.times[0]))
    return PairMotion(pair_maps.pair, shift, np.full(2, sigma), gradient, np.stack((along, along)))


def _affine(solution: SuttonSolution, dmap: DisparityMap) -> tuple[Array, Array]:
    """(2,) shift of the image's centre and (2, 2) gradient that fit a corrected map best."""
    found, state = correction(solution, dmap), solution.state
    x, y = (coordinates[dmap.valid] for coordinates in dmap.grid.mesh())
    centred = np.column_stack((np.ones(x.size), x - 0.5 * (state.width_px - 1), y - 0.5 * (state.height_px - 1)))
    moved = np.stack(((dmap.u_px - found.u_px)[dmap.valid], (dmap.v_px - found.v_px)[dmap.valid]), axis=1)
    fit = np.asarray(np.linalg.lstsq(centred, moved, rcond=None)[0], dtype=np.float64)
    return fit[0], fit[1:].T


def _notes(solution: SuttonSolution, distortion: DistortionField) -> tuple[Note, ...]:
    smoothing_px = solution.state.settings.sutton_smoothing_px
    text = f"the published procedure of 2007, with local drift smoothed over {smoothing_px:g} px: for comparison, not for results"
    notes = [information(NoteCode.METHOD, text)]
    if not bool(distortion.valid.all()):
        notes.append(information(NoteCode.CALIBRATION, "distortion not determined yet: needs translations in both directions"))
    else:
        text = (
            "the affine part of the distortion is not determined by unknown translations and set to zero: it scales strain, it makes none"
        )
        notes.append(information(NoteCode.CALIBRATION, text))
    if len(solution.drifts) > 1:
        notes.append(information(NoteCode.METHOD, "drift of calibration and measurement is estimated apart: each begins at zero"))
    return tuple(notes)


def _start(when: FrameTime) -> float:
    return when.start_s
