"""Scores of runs on a simulator: recovered against true values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn
from scipy.special import gammaincinv

from semlive.data.experiment import Phase
from semlive.data.results import RunResult
from semlive.report.noise_propagation import effective_sample_size, noise_scatter
from semlive.report.scoring.errors import COMPONENTS, DistortionError, FrameErrors, RunErrors, compare_with_truth
from semlive.report.scoring.truth import Truth, load_truth

__all__ = ["Score", "load_truth", "score", "scores_of"]

Field = NDArray[np.float64]
LEVELS = {68: 0.6827, 95: 0.95}


@dataclass(frozen=True, slots=True)
class Score:
    """One recovered quantity and its true value.

    Attributes:
        name: name of the quantity.
        truth: true value.
        value: recovered value.
        sigma: stated standard uncertainty; for an rms error the rms of the stated uncertainties.
        unit: unit of truth, value and sigma.
        freedom: number of independent values in an rms error, which reduces its scatter.
        candidates: number of independent values from which the largest was selected.
        detail: whether the score is listed in JSON output only, not in the short table.
    """

    name: str
    truth: float
    value: float
    sigma: float
    unit: str
    freedom: float = 1.0
    candidates: float = 1.0
    detail: bool = False

    @property
    def error(self) -> float:
        """Recovered minus true."""
        return self.value - self.truth

    def covers(self, level: float) -> bool:
        """Whether the error is within the stated uncertainty at a probability level (chi distribution; normal for one value)."""
        limit = np.sqrt(_chi_square(level ** (1.0 / self.candidates), self.freedom) / self.freedom)
        return abs(self.error) <= float(limit) * self.sigma

    def to_json(self) -> dict[str, object]:
        """JSON object of the score."""
        numbers = {"truth": self.truth, "value": self.value, "sigma": self.sigma, "error": self.error, "unit": self.unit}
        return {**numbers, **{f"inside{percent}": self.covers(level) for percent, level in LEVELS.items()}}


def score(result: RunResult, truth: Mapping[str, Any]) -> tuple[Score, ...]:
    """Scores of every recovered quantity.

    Drift is compared by its change from the middle of each frame (between frames it is not separable from motion),
    distortion after removal of its best affine map, displacement after removal of each frame's mean, strain relative to frame 0.

    Args:
        result: the run.
        truth: content of the simulator's truth file, from `load_truth`.

    Raises:
        BadInput: the truth lacks a frame of the run, or something else.
    """
    true = Truth.of(truth)
    scores = list(scores_of(compare_with_truth(result, true)))
    if result.elastic is not None:
        modulus, ratio = result.elastic.youngs_modulus_gpa, result.elastic.poissons_ratio
        scores.append(Score("Young's modulus", true.youngs_modulus_gpa, modulus.value, modulus.sigma, "GPa"))
        scores.append(Score("Poisson's ratio", true.poissons_ratio, ratio.value, ratio.sigma, ""))
    if result.gage is not None:
        gage = result.gage
        modulus, ratio, agreement = gage.youngs_modulus_gpa, gage.poissons_ratio, gage.dic_over_gage
        scores.append(Score("Young's modulus, strain gage", true.youngs_modulus_gpa, modulus.value, modulus.sigma, "GPa"))
        scores.append(Score("Poisson's ratio, strain gage", true.poissons_ratio, ratio.value, ratio.sigma, ""))
        scores.append(Score("axial strain, DIC over gage", 1.0, agreement.value, agreement.sigma, ""))
    return tuple(scores)


def scores_of(errors: RunErrors) -> Iterator[Score]:
    """Scores of all quantities except the elastic constants."""
    yield from _drift(errors)
    yield from _distortion(errors.distortion)
    yield from _shifts(errors)
    yield from _displacement(errors)
    yield from _strain(errors)


def independent_samples(z: Field) -> float:
    """Effective number of independent values of an array of errors, from its cosine spectrum (participation ratio).

    k modes of equal variance give k on average, a single one gives 1: ``3 (sum P)^2 / sum P^2 - 2``.
    """
    power = np.asarray(dctn(z, norm="ortho")) ** 2
    total = float((power**2).sum())
    return float(np.clip(3.0 * power.sum() ** 2 / total - 2.0, 1.0, z.size)) if total > 0 else float(z.size)


def _coverage(name: str, z: Field, values: float) -> Iterator[Score]:
    """Fraction of errors within the stated 68 % and 95 % intervals, which shows too small and too large uncertainties."""
    for percent, level in LEVELS.items():
        limit = float(np.sqrt(_chi_square(level, 1)))
        chance = float(np.sqrt(level * (1 - level) / values))
        yield Score(f"coverage at {percent} %, {name}", level, float(np.mean(np.abs(z) <= limit)), chance, "")


def _rms(values: Field) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _drift(errors: RunErrors) -> Iterator[Score]:
    drift = errors.drift
    change = np.array([drift_error.true_px[-1] - drift_error.true_px[0] for drift_error in drift])
    widest = np.unravel_index(int(np.argmax(np.abs(change))), change.shape)
    for at, drift_error in enumerate(drift):
        for axis in (0, 1):
            # The ends are on both sides of the middle, and the error within a frame is mostly one of the rate: their sigmas add.
            sigma = float(drift_error.sigma_px[0, axis] + drift_error.sigma_px[-1, axis])
            value = float(drift_error.measured_px[-1, axis] - drift_error.measured_px[0, axis])
            largest = (at, axis) == widest
            name = f"drift {'xy'[axis]} across frame {drift_error.frame}"
            yield Score(name, float(change[at, axis]), value, sigma, "px", detail=not largest)
    error, sigma = (
        np.stack(values) for values in ([drift_error.error_px for drift_error in drift], [drift_error.sigma_px for drift_error in drift])
    )
    z = error / np.maximum(sigma, 1e-12)
    z_across = z[:, -1] - z[:, 0]
    values = sum(independent_samples(z_across[:, axis]) for axis in (0, 1))
    yield Score("drift within frames, rms error", 0.0, _rms(error), _rms(sigma), "px", values)
    worst = int(np.argmax((error**2).mean(axis=(1, 2))))
    yield Score("drift within the worst frame, rms error", 0.0, _rms(error[worst]), _rms(sigma[worst]), "px", 2.0, len(drift))
    yield from _coverage("drift within frames", z, values)


def _distortion(distortion: DistortionError) -> Iterator[Score]:
    if not distortion.valid.any():
        return
    z = np.where(distortion.valid[..., None], distortion.error_px / np.maximum(distortion.sigma_px, 1e-12)[..., None], 0.0)
    values = [independent_samples(z[..., axis]) for axis in (0, 1)]
    error, sigma = distortion.error_px[distortion.valid], distortion.sigma_px[distortion.valid]
    for axis in (0, 1):
        yield Score(f"distortion {'xy'[axis]}, rms error", 0.0, _rms(error[:, axis]), _rms(sigma), "px", values[axis])
    yield Score("distortion, rms error", 0.0, _rms(error), _rms(sigma), "px", sum(values))
    at = np.unravel_index(int(np.argmax(np.abs(error))), error.shape)
    yield Score("distortion, largest error", 0.0, float(np.abs(error[at])), float(sigma[at[0]]), "px", candidates=sum(values))
    yield from _coverage("distortion", z[distortion.valid], sum(values))


def _shifts(errors: RunErrors) -> Iterator[Score]:
    if not errors.shifts:
        return
    z = []
    for shift_error in errors.shifts:
        for axis in (0, 1):
            true, value, sigma = (float(part[axis]) for part in (shift_error.true_px, shift_error.measured_px, shift_error.sigma_px))
            yield Score(f"shift {'xy'[axis]} of pair {shift_error.pair}", true, value, sigma, "px", detail=True)
        z.append((shift_error.measured_px - shift_error.true_px) / np.maximum(shift_error.sigma_px, 1e-12))
    error = np.array([shift_error.measured_px - shift_error.true_px for shift_error in errors.shifts])
    values = sum(independent_samples(np.array(z)[:, axis]) for axis in (0, 1))
    yield Score("shift, rms error", 0.0, _rms(error), _rms(np.array([shift_error.sigma_px for shift_error in errors.shifts])), "px", values)
    yield from _coverage("shift", np.array(z), values)


def _displacement(errors: RunErrors) -> Iterator[Score]:
    valid = np.array([frame.valid for frame in errors.frames])
    if not valid.any():
        return
    error, sigma = (np.stack(part) for part in zip(*((frame.displacement_px, frame.sigma_px) for frame in errors.frames), strict=True))
    z = np.where(valid[..., None], error / np.maximum(sigma, 1e-12), 0.0)
    values = sum(independent_samples(z[..., axis]) for axis in (0, 1))
    recovered, stated = _rms(error[valid]), _rms(sigma[valid])
    yield Score("displacement, rms error", 0.0, recovered, stated, "px", values)
    yield from _coverage("displacement of points", z[valid], values)
    yield Score("noise floor", recovered, errors.noise_floor_px, recovered / float(np.sqrt(2 * values)), "px")


def _strain(errors: RunErrors) -> Iterator[Score]:
    for frame in errors.frames:
        for c, name in enumerate(COMPONENTS):
            true, recovered, sigma = (float(part[c]) * 1e6 for part in (frame.true_strain, frame.mean_strain, frame.mean_sigma))
            second_of_tension = frame.phase is Phase.TENSION and frame.frame % 2 == 1
            shown = second_of_tension and name != "exy"
            yield Score(f"strain {name} of frame {frame.frame}", true, recovered, sigma, "1e-6", detail=not shown)
    for phase in Phase:
        chosen = [frame for frame in errors.frames if frame.phase is phase]
        if chosen:
            yield from _phase_strain(errors, phase, chosen)
    z = np.array([(frame.mean_strain - frame.true_strain) / np.maximum(frame.mean_sigma, 1e-12) for frame in errors.frames])
    yield from _coverage("mean strain of frames", z, sum(independent_samples(z[:, c]) for c in range(3)))


def _phase_strain(errors: RunErrors, phase: Phase, frames: list[FrameErrors]) -> Iterator[Score]:
    error, sigma = (
        np.array(part) * 1e6
        for part in ([frame.mean_strain - frame.true_strain for frame in frames], [frame.mean_sigma for frame in frames])
    )
    values = sum(independent_samples(component_errors) for component_errors in (error / np.maximum(sigma, 1e-6)).T)
    yield Score(f"mean strain, {phase.value}, rms error", 0.0, _rms(error), _rms(sigma), "1e-6", values)
    at = np.unravel_index(int(np.argmax(np.abs(error))), error.shape)
    name = f"mean strain, {phase.value}, the worst of {len(frames)} frames"
    yield Score(name, 0.0, float(error[at]), float(sigma[at]), "1e-6", candidates=float(error.size))
    stated = np.array([(frame.sigma_px[frame.valid] ** 2).mean(axis=0) for frame in frames]).mean(axis=0)
    points = frames[0].window_points
    expected = noise_scatter(errors.grid, points, *(float(np.sqrt(variance)) for variance in stated), full=False)
    # Every map contains the noise of frame 0, half of its variance: many frames count as at most four.
    gauges = effective_sample_size(errors.grid, points) * len(frames) / (1 + (len(frames) - 1) / 4)
    for c, component in enumerate(COMPONENTS):
        noise, recovered = (
            1e6 * value for value in (getattr(expected, component), _rms(np.array([frame.strain_sd[c] for frame in frames])))
        )
        label = f"scatter of {component}, {phase.value}, over {errors.grid.vsg_px(points)} px"
        yield Score(label, noise, recovered, noise / float(np.sqrt(2 * gauges)), "1e-6")


def _chi_square(level: float, freedom: float) -> float:
    """Quantile of chi-square without scipy.stats, whose import takes a second."""
    return 2.0 * float(gammaincinv(0.5 * freedom, level))
