"""Coverage of stated intervals: errors over stated sigmas of many small experiments against the simulators' truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numexp.cases import CASES, Case, Setting
from numexp.experiment import Experiment, ObservedFrame, Taken, make_experiment
from numexp.noise import NoiseKind
from numexp.world import HEIGHT_PX, WIDTH_PX, Field
from scipy.special import erfinv

from semlive import estimate, mechanics
from semlive.data.drift import DistortionField, DriftEstimate, DriftForecast
from semlive.data.experiment import Phase
from semlive.data.grid import Grid
from semlive.data.settings import EstimateSettings
from semlive.data.strain import Displacement, StrainField, StrainSummary, Tensor2
from semlive.estimate.joint.solution.posterior import Solution
from semlive_simulators.effects.interfaces import Instants
from semlive_simulators.specimen.specimen import at_rest

GRID = Grid(101, 101, 25, 30, 24, 43)
CALIBRATION_PAIRS, LOAD_STEPS = 7, 3
WINDOW_POINTS = 5
AREA_MM2, MODULUS_GPA, RATIO = 10.0, 71.1, 0.33
LEVELS = {"68 %": 0.6827, "95 %": 0.95}
CLIP = 4.0  # for the rms, that one outlier does not stand for all

SMALL = {
    "white": Case(
        "white", "quadratic drift, white noise of 0.025 px", Setting(CASES["tension"].setting.effects, LOAD_STEPS), NoiseKind.WHITE
    ),
    "correlated": Case(
        "correlated",
        "quadratic drift, noise shared over subsets",
        Setting(CASES["tension"].setting.effects, LOAD_STEPS),
        NoiseKind.CORRELATED,
    ),
    "wander": Case(
        "wander", "0.3 px rms of wandering drift, shared noise", Setting(CASES["wander"].setting.effects, LOAD_STEPS), NoiseKind.CORRELATED
    ),
}

Normalised = dict[str, Field]
"""By quantity, errors over stated sigmas of one experiment, any shape."""


def normalised(case: Case, seed: int, grid: Grid = GRID) -> Normalised:
    """Errors over stated sigmas of one experiment."""
    experiment = make_experiment(case, seed, grid, CALIBRATION_PAIRS)
    state = estimate.init(EstimateSettings(window_points=WINDOW_POINTS), grid, WIDTH_PX, HEIGHT_PX)
    for taken in experiment.pairs:
        state = estimate.update(state, taken.pair, taken.phase, taken.times, taken.maps)
    solution = estimate.solve(state)
    found = estimate.to_estimate(solution, 0)
    return {
        "drift within frames": _drift(experiment, found.drift),
        "drift rate of scans to come": _forecast(experiment, found.drift.forecast),
        "distortion": _distortion(experiment, found.distortion),
        **_frames(experiment, solution),
    }


def _drift(experiment: Experiment, drift: DriftEstimate) -> Field:
    """(frames, 2, 2) change from the middle of each frame to its start and end; in the raster less its affine distortion."""
    scaled = np.eye(2) + affine_distortion(experiment)
    z = []
    for frame in np.unique(drift.frame):
        inside = np.flatnonzero(drift.frame == frame)
        time_s, sigma = drift.time_s[inside], drift.sigma_px[inside]
        middle_s = 0.5 * (time_s[0] + time_s[-1])
        true = (_drift_px(experiment, time_s) - _drift_px(experiment, np.array([middle_s]))) @ scaled.T
        middle = np.array([np.interp(middle_s, time_s, drift.drift_px[inside, axis]) for axis in (0, 1)])
        error = drift.drift_px[inside] - middle - true
        z.append(error[[0, -1]] / sigma[[0, -1]])
    return np.array(z)


def _forecast(experiment: Experiment, forecast: DriftForecast | None) -> Field:
    """(scans, 2) mean rate over scans that follow the last frame."""
    assert forecast is not None  # the joint method gives one
    true = _drift_px(experiment, forecast.time_s + forecast.duration_s) - _drift_px(experiment, forecast.time_s)
    return (forecast.rate_px_s - true @ (np.eye(2) + affine_distortion(experiment)).T / forecast.duration_s) / forecast.sigma_px_s


def _drift_px(experiment: Experiment, time_s: Field) -> Field:
    column = experiment.world.column
    more = column.effects.drift_px(Instants(time_s, 0.0, 0, column.scan, at_rest()))
    return column.drift.at(time_s) + (0.0 if more is None else more)


def affine_distortion(experiment: Experiment) -> Field:
    """(2, 2) gradient of the true distortion's best affine map over the grid, which unknown translations do not determine."""
    address = np.stack(experiment.grid.mesh(), axis=-1).reshape(-1, 2)
    columns = np.column_stack((np.ones(len(address)), address))
    return np.linalg.lstsq(columns, experiment.world.bend_px(address), rcond=None)[0][1:].T


def _distortion(experiment: Experiment, found: DistortionField) -> Field:
    """(n, 2) at the points where it is marked as known, best affine map of the difference removed."""
    address = np.stack(found.grid.mesh(), axis=-1)[found.valid]
    error = np.stack((found.ex_px, found.ey_px), axis=-1)[found.valid] - experiment.world.bend_px(address)
    columns = np.column_stack((np.ones(len(address)), address))
    error = error - columns @ np.linalg.lstsq(columns, error, rcond=None)[0]
    return error / found.sigma_px[found.valid][:, None]


def _frames(experiment: Experiment, solution: Solution) -> Normalised:
    points: list[Field] = []
    means: list[Field] = []
    gauges: list[Field] = []
    loaded: list[tuple[float, StrainSummary]] = []
    for taken in experiment.pairs:
        for frame in taken.observed:
            moved, field, summary = _measured(taken, frame, solution)
            true = np.array([frame.gradient[0, 0], frame.gradient[1, 1], 0.5 * (frame.gradient[0, 1] + frame.gradient[1, 0])])
            points.append(_points(frame, moved))
            means.append((_parts(summary.mean) - true) / _parts(summary.mean_sigma))
            gauges.append(_gauges(field, summary, true))
            if taken.phase is Phase.TENSION:
                loaded.append((float(true[1]) * MODULUS_GPA * 1e3 * AREA_MM2, summary))
    steps = [(loaded[at][0], mechanics.average_of_pair(loaded[at][1], loaded[at + 1][1])) for at in range(0, len(loaded), 2)]
    shared = estimate.mean_strain_covariance(solution, [one.frame for _, one in steps])
    elastic = mechanics.elastic_constants(steps, AREA_MM2, "y", covariance=shared)
    modulus, ratio = elastic.youngs_modulus_gpa, elastic.poissons_ratio
    return {
        "displacement of points": np.concatenate(points),
        "mean strain": np.array(means),
        "strain of a gauge": np.concatenate(gauges),
        "Young's modulus": np.array([(modulus.value - MODULUS_GPA) / modulus.sigma]),
        "Poisson's ratio": np.array([(ratio.value - RATIO) / ratio.sigma]),
    }


def _measured(taken: Taken, frame: ObservedFrame, solution: Solution) -> tuple[Displacement, StrainField, StrainSummary]:
    """What the pipeline makes of a frame."""
    dmap = next(one for one in taken.maps if one.reference == 0 and one.current == frame.exact.current)
    moved = mechanics.displacement(dmap, estimate.correction(solution, dmap))
    field = mechanics.strain(moved, WINDOW_POINTS)
    return moved, field, mechanics.summary(moved, field, solution.noise_floor_px, estimate.correction_strain_sigma(solution, dmap))


def _points(frame: ObservedFrame, moved: Displacement) -> Field:
    """(n, 2) at valid points; the frame's mean removed, which is one number with drift across the motion."""
    error = (np.stack((moved.u_px, moved.v_px), axis=-1) - frame.displacement_px)[moved.valid]
    sigma = np.stack((moved.sigma_u_px, moved.sigma_v_px), axis=-1)[moved.valid]
    return (error - error.mean(axis=0)) / sigma


def _gauges(field: StrainField, summary: StrainSummary, true: Field) -> Field:
    """(n, 3) of the gauges that the edge does not cut."""
    assert summary.gauge_sigma is not None  # measured, and not filtered
    half = field.window_points // 2
    whole = np.zeros_like(field.valid)
    whole[half:-half, half:-half] = field.valid[half:-half, half:-half]
    return (np.stack((field.exx, field.eyy, field.exy), axis=-1)[whole] - true) / _parts(summary.gauge_sigma)


def _parts(one: Tensor2) -> Field:
    return np.array([one.exx, one.eyy, one.exy])


@dataclass(frozen=True, slots=True)
class Coverage:
    """How often errors of one quantity lie within what was stated, over experiments.

    Attributes:
        quantity: its name.
        inside: fraction within the stated 68 % and 95 %.
        standard_error: of both, from the scatter between experiments, whose own errors hang together.
        rms: of the error over the stated sigma, clipped at 4.
        bias: mean error over the stated sigma, of the component that is farthest off.
        bias_error: its standard error.
    """

    quantity: str
    inside: tuple[float, float]
    standard_error: tuple[float, float]
    rms: float
    bias: float
    bias_error: float


def coverages(experiments: Sequence[Normalised]) -> list[Coverage]:
    """Every quantity over all experiments."""
    found = []
    for quantity in experiments[0]:
        of_each = [one[quantity] for one in experiments if one[quantity].size]  # a distortion may be marked as unknown everywhere
        limits = [float(np.sqrt(2.0) * erfinv(level)) for level in LEVELS.values()]
        inside = np.array([[np.mean(np.abs(z) <= limit) for limit in limits] for z in of_each])
        mean, error = inside.mean(axis=0), inside.std(axis=0, ddof=1) / np.sqrt(len(inside))
        rms = float(np.sqrt(np.mean([np.mean(np.clip(z, -CLIP, CLIP) ** 2) for z in of_each])))
        by_component = np.array([z.reshape(-1, z.shape[-1]).mean(axis=0) for z in of_each])
        worst = int(np.argmax(np.abs(by_component.mean(axis=0))))
        one = by_component[:, worst]
        bias_error = float(one.std(ddof=1) / np.sqrt(len(one)))
        found.append(Coverage(quantity, (mean[0], mean[1]), (error[0], error[1]), rms, float(one.mean()), bias_error))
    return found


def table(found: Sequence[Coverage]) -> list[str]:
    """Markdown lines."""
    lines = ["| quantity | within 68 % | within 95 % | rms of error / sigma | mean of error / sigma |", "|---|---|---|---|---|"]
    for one in found:
        inside = " | ".join(f"{100 * part:.1f} ± {100 * error:.1f}" for part, error in zip(one.inside, one.standard_error, strict=True))
        lines.append(f"| {one.quantity} | {inside} | {one.rms:.2f} | {one.bias:+.2f} ± {one.bias_error:.2f} |")
    return lines
