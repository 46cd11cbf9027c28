"""The posterior in the words of `semlive.data`: drift samples, distortion field, motions, corrections."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap
from semlive.data.drift import Correction, DistortionField, DriftEstimate, Estimate, FrameTime, Motion, RasterWander
from semlive.data.experiment import Phase
from semlive.estimate.consistency import consistency
from semlive.estimate.outlook import forecast
from semlive.estimate.posterior import Solution
from semlive.estimate.smooth import LATELY, Spread, border_covariance, spreads
from semlive.estimate.support import Calibration, calibration, outside_notes, pointwise, support
from semlive.estimate.told_strain import sightings
from semlive.model import MotionKind, offsets

SAMPLES_PER_FRAME = 12
UNEXPLAINED = 2.0  # times the stated noise; rendered frames and the numerical experiment stay within 1.1


def estimate(solution: Solution, revision: int, lately: bool = False) -> Estimate:
    """Everything known, as one revision; `lately` leaves out what belongs to pairs older than the `LATELY` newest."""
    state = solution.state
    known = calibration(solution)
    distortion = _distortion(solution, known)
    wide = {one.pair: one for one in spreads(solution.ending, LATELY if lately else None)}
    motions = tuple(_motion(solution, pair, wide) for pair in (0, *state.motions.pairs) if pair in wide)
    notes, drift, wander = _notes(solution, known, wide), _drift(solution, revision, wide), _wander(solution, wide)
    return Estimate(drift, distortion, motions, solution.noise_floor_px, notes, solution.terms, wander)


def checks(solution: Solution) -> tuple[str, ...]:
    """Whether halves of the data agree, one sentence each; a warning where they do not."""
    said = [one.told() for one in consistency(solution)]
    if solution.hyper.noise_scale > UNEXPLAINED:
        said.append(
            f"WARNING: the model leaves {solution.noise_floor_px:.2g} px unexplained, {solution.hyper.noise_scale:.1f} times what the "
            "correlation says of its noise: something moved or changed that the model does not have"
        )
    return tuple(said)


def live_rate(solution: Solution) -> NDArray[np.float64]:
    """(2,) drift rate in px/s at the end of the newest frame."""
    drift = solution.state.drift
    assert drift is not None  # a solution has data
    newest = solution.state.frames[-1]
    rate = drift.rate_rows([newest.start_s + newest.timing.duration_s]) @ solution.part("drift").reshape(-1, 2)
    return rate[0]


def correction(solution: Solution, dmap: DisparityMap) -> Correction:
    """Drift and distortion in a map from frame 0, to be subtracted to get displacement.

    Raises:
        IllPosed: the map's frame is not part of the estimate.

    Points that a frame shows beyond the addresses seen in calibration are marked: the distortion there would be extrapolated.
    """
    reference, current = sightings(solution, dmap)
    model = tuple(effect for effect in solution.state.model if not effect.needs_ideal)
    parameters = np.concatenate([solution.part(effect.name) for effect in model])
    both = offsets(model, parameters, current) - offsets(model, parameters, reference)
    both[~dmap.valid.ravel()] = 0.0
    u, v = (np.ascontiguousarray(one.reshape(dmap.grid.shape)) for one in both.T)
    u.setflags(write=False)
    v.setflags(write=False)
    area, valid = support(solution.state), None
    if area is not None and dmap.current > 1:
        valid = area.holds(current.x_px, current.y_px).reshape(dmap.grid.shape)
        valid.setflags(write=False)
    return Correction(dmap.current, u, v, valid)


def mean_strain_covariance(solution: Solution, frames: Sequence[int]) -> NDArray[np.float64]:
    """(2 n, 2 n) joint covariance of the mean strains of n frames, first all exx, then all eyy.

    Errors of distortion and drift are common to the frames and may grow with load, because the specimen travels under
    load: taken as independent they make Young's modulus look better known than it is. The gradients of the pairs hold
    them together with the DIC's noise. Frames of one pair share theirs; frames without a free gradient have zeros.
    """
    motions, start = solution.state.motions, solution.state.layout.part("motion").start
    rows = np.zeros((2, len(frames), len(solution.mean)))
    for at, frame in enumerate(frames):
        if frame // 2 in motions.pairs:
            part, kind = motions.part(frame // 2)
            if kind is MotionKind.GRADIENT:
                rows[0, at, start + part.start + 1] = rows[1, at, start + part.start + 5] = 1.0
    return solution.covariance_of(rows.reshape(2 * len(frames), -1))


Spreads = dict[int, Spread]
"""Uncertainty of what concerns each pair."""


def _wander(solution: Solution, wide: Spreads) -> RasterWander:
    frames = _frames(solution, wide)
    values = []
    for change in solution.state.raster:
        start = solution.state.layout.part(change.name).start
        found, variance = [], []
        for when in frames:
            index, value = change.spline.local([when.start_s + 0.5 * when.timing.duration_s])
            at, row = start + index[0], value[0] / change.radius_px
            found.append(float(row @ solution.mean[at]))
            variance.append(float(row @ wide[when.frame // 2].of(at) @ row))
        values += [np.array(found), np.sqrt(np.clip(variance, 0.0, None))]
    return RasterWander(np.array([when.frame for when in frames], dtype=np.int64), *values)


def _drift(solution: Solution, revision: int, wide: Spreads) -> DriftEstimate:
    drift, layout = solution.state.drift, solution.state.layout
    assert drift is not None  # a solution has data
    spline, start = drift.spline, layout.part("drift").start
    parameters = solution.part("drift").reshape(-1, 2)
    frames = _frames(solution, wide)
    fraction = np.append(np.linspace(0.0, 1.0, SAMPLES_PER_FRAME), 0.5)
    times, values, rates, variances = [], [], [], []
    for when in frames:
        time_s = when.start_s + fraction * when.timing.duration_s
        (index, value), (_, rate) = spline.local(time_s), spline.local_rate(time_s)
        first = int(index.min())
        rows = np.zeros((len(time_s), int(index.max()) + 1 - first))
        np.put_along_axis(rows, index - first, value, axis=1)
        change = rows[:-1] - rows[-1]
        knots = start + 2 * np.arange(first, first + rows.shape[1])
        one = wide[when.frame // 2]
        variances.append(np.stack([np.einsum("ni,ij,nj->n", change, one.of(knots + axis), change) for axis in (0, 1)], axis=1))
        times.append(time_s[:-1])
        values.append(np.einsum("nk,nkc->nc", value, parameters[index])[:-1])
        rates.append(np.einsum("nk,nkc->nc", rate, parameters[index])[:-1])
    return DriftEstimate(
        np.concatenate(times),
        np.repeat([when.frame for when in frames], SAMPLES_PER_FRAME).astype(np.int64),
        np.concatenate(values),
        np.sqrt(np.clip(np.concatenate(variances), 0.0, None)),
        np.concatenate(rates),
        revision,
        forecast(solution),
    )


def _distortion(solution: Solution, known: Calibration) -> DistortionField:
    state, grid = solution.state, solution.state.grid
    part = state.layout.part("distortion")
    x, y = grid.mesh()
    ex, ey = (one.reshape(grid.shape) for one in state.distortion.field(solution.mean[part], x, y).T)
    covariance = border_covariance(solution.ending)
    variance = 0.5 * (pointwise(state, covariance[0::2, 0::2]) + pointwise(state, covariance[1::2, 1::2]))
    return DistortionField(grid, ex, ey, np.sqrt(variance), known.covered)


def _motion(solution: Solution, pair: int, wide: Spreads) -> Motion:
    motions = solution.state.motions
    shift, gradient = motions.shift_and_gradient(pair, solution.part("motion"))
    shift_sigma, gradient_sigma = np.zeros(2), np.zeros((2, 2))
    if pair in motions.pairs:
        part, kind = motions.part(pair)
        start = solution.state.layout.part("motion").start
        sigma = np.sqrt(np.diag(wide[pair].of(start + np.arange(part.start, part.stop))))
        if kind is MotionKind.RIGID:
            shift_sigma, gradient_sigma = sigma[:2], np.array([[0.0, sigma[2]], [sigma[2], 0.0]])
        else:
            shift_sigma, gradient_sigma = sigma[[0, 3]], sigma[[1, 2, 4, 5]].reshape(2, 2)
    return Motion(pair, shift, shift_sigma, gradient, gradient_sigma)


def _notes(solution: Solution, known: Calibration, wide: Spreads) -> tuple[str, ...]:
    notes = []
    if not known.enough:
        warned = "WARNING, the load steps are corrected with it all the same: " if Phase.TENSION in solution.state.phases else ""
        notes.append(warned + known.told())
    else:
        notes.append(
            "the affine part of the distortion is not determined by unknown translations and set to zero: it scales strain, it makes none"
        )
    notes += outside_notes(solution.state, wide)
    notes += _term_notes(solution)
    frames = sorted(solution.state.frames, key=_start)
    gap_s = max((after.start_s - before.start_s - before.timing.duration_s for before, after in itertools.pairwise(frames)), default=0.0)
    if gap_s > 0:
        notes.append(f"drift between pairs is interpolated over gaps of up to {gap_s:.0f} s: it cannot be told from motion of the specimen")
    return tuple(notes)


def _term_notes(solution: Solution) -> list[str]:
    tests, notes = {one.name: one for one in solution.terms}, []
    gamma = tests.get("coupling")
    if gamma is not None and gamma.used:
        notes.append(
            f"the drift carries the distortion along (gamma {gamma.value:.2f} +- {gamma.sigma:.2f} before, 1 taken): E is at R - d"
        )
    strained = Phase.TENSION in solution.state.phases
    for name, what in (("magnification", "strain"), ("raster_rotation", "rotation of the specimen")):
        if name in tests and tests[name].used:
            said = f"the {name.replace('_', ' ')} drifts (evidence {tests[name].evidence:.0f}) and is corrected"
            end = f", under load only as it goes on smoothly: a step of it cannot be told from {what}" if strained else ""
            notes.append(said + end)
    return notes


def _frames(solution: Solution, wide: Spreads) -> list[FrameTime]:
    return sorted((when for when in solution.state.frames if when.frame // 2 in wide), key=_start)


def _start(when: FrameTime) -> float:
    return when.start_s
