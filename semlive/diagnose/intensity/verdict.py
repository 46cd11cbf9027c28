"""Verdict on the intensity: contamination, defocus or a changed intensity curve by their time series, and flashes by rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import ndtr

from semlive.data.diagnosis.channels import IntensityDiagnosis, IntensityHistory
from semlive.data.diagnosis.effects import DomainTest, IdentifiedEffect, ModelEffect, Outcome, ParameterEstimate
from semlive.diagnose.intensity.flashes import Flash, flashes
from semlive.diagnose.intensity.frames import IntensityFrames
from semlive.diagnose.intensity.models import (
    IntensityFit,
    IntensityModel,
    IntensityRegression,
    black_level,
    flash_at,
    smooth_models,
    step_at,
)
from semlive.diagnose.intensity.residual_tests import ResidualTest, residual_tests
from semlive.diagnose.intensity.time_series import IntensityTimeSeries, intensity_time_series
from semlive.diagnose.maps.effect_selection import MIN_LOG_ODDS, SIGNIFICANCE_LEVEL, SIGNIFICANT_LOG_FACTOR
from semlive.model.effects.intensity import CHARGING_JUMP, CONTAMINATION, DEFOCUS, GAMMA_CHANGE

Array = NDArray[np.float64]
MAX_EFFECTS = 3
TESTS = 4
"""Number of simultaneous tests: three effect classes and unnamed changes."""
MIN_LEVELS = 0.3
"""Smallest significant residual, grey levels: real brightness varies by this much, which does not affect ZNSSD correlation."""
PRIOR_MEAN = np.array([1.0, 1.0, 0.0])
PRIOR_SD = np.array([1.0, 1.0, 100.0])
"""Prior standard deviations of gain, gamma and offset: a pattern of two grey levels does not determine three parameters."""


@dataclass(frozen=True, slots=True, eq=False)
class _SelectedModel:
    """A selected model with its statistics at the time of selection."""

    fit: IntensityFit
    rivals: tuple[str, ...]


def diagnose_intensity(series: IntensityFrames, model_effects: Sequence[ModelEffect] = ()) -> IntensityDiagnosis:
    """Identify effects on the grey levels.

    Args:
        series: intensity data of all frames.
        model_effects: intensity effects already in the model.

    Raises:
        IllPosed: there are too few pairs or blocks.
    """
    time_series = intensity_time_series(series)
    flashes_found = flashes(series.frames)
    included = (
        *_given_models(time_series, model_effects),
        *(intensity_model for entry in flashes_found if (intensity_model := flash_at(time_series, entry.at_s, entry.length_s)) is not None),
    )
    before = residual_tests(time_series, included)
    intensity_models, effects = list(included), list[_SelectedModel]()
    evidence: dict[str, float] = {}
    while True:
        fits = IntensityRegression(time_series, tuple(intensity_models)).all_fits()
        fits_by_name = _most_likely_by_name(fits)
        evidence = evidence or {name: candidate.odds for name, candidate in fits_by_name.items()}
        best = max(fits_by_name.values(), key=lambda candidate: candidate.odds)
        nameable = [
            candidate
            for candidate in fits_by_name.values()
            if candidate.model.family is not None
            and candidate.model.name not in {intensity_model.name for intensity_model in intensity_models}
        ]
        most_significant = max(nameable, key=lambda candidate: candidate.odds, default=None)
        if (
            most_significant is None
            or len(effects) == MAX_EFFECTS
            or most_significant.odds < max(SIGNIFICANT_LOG_FACTOR, best.odds - MIN_LOG_ODDS)
            or TESTS * most_significant.p_value > SIGNIFICANCE_LEVEL
        ):
            break
        rivals = tuple(
            fit.model.name for fit in nameable if fit is not most_significant and fit.odds > most_significant.odds - MIN_LOG_ODDS
        )
        effects.append(_SelectedModel(most_significant, rivals))
        intensity_models.append(most_significant.model)
    new = () if CHARGING_JUMP.name in {model_effect.name for model_effect in model_effects} else flashes_found
    return _verdict(series, time_series, intensity_models, effects, before, evidence, new)


def _given_models(time_series: IntensityTimeSeries, model_effects: Sequence[ModelEffect]) -> tuple[IntensityModel, ...]:
    """Intensity models of given effects; their amplitudes are fitted again."""
    models: list[IntensityModel] = []
    for model_effect in model_effects:
        if model_effect.name == GAMMA_CHANGE.name:
            at_s = dict(model_effect.values).get("at_s")
            models.append(IntensityRegression(time_series).add_model().model if at_s is None else step_at(time_series, at_s))
        models += [intensity_model for intensity_model in smooth_models(time_series) if intensity_model.name == model_effect.name]
    return tuple(models)


def _most_likely_by_name(fits: Sequence[IntensityFit]) -> dict[str, IntensityFit]:
    """For each name, the simplest model that is not much less likely than later, more complex ones."""
    best_fits: dict[str, IntensityFit] = {}
    for fit in fits:
        previous = best_fits.get(fit.model.name)
        if previous is None or fit.odds > previous.odds + MIN_LOG_ODDS:
            best_fits[fit.model.name] = fit
    return best_fits


def _verdict(
    series: IntensityFrames, time_series: IntensityTimeSeries,
    intensity_models: Sequence[IntensityModel], selected: Sequence[_SelectedModel],
    before: Sequence[ResidualTest],
    evidence: dict[str, float], flashes_found: Sequence[Flash],
) -> IntensityDiagnosis:  # fmt: skip
    effects = [_effect(time_series, series, intensity_models, effect.fit) for effect in selected]
    if flashes_found:
        effects.append(_flash_effect(flashes_found, sum(len(frame.row_levels) for frame in series.frames)))
    significant_tests = [
        residual_test
        for residual_test in residual_tests(time_series, intensity_models)
        if 3.0 * residual_test.p_value <= SIGNIFICANCE_LEVEL and residual_test.levels >= MIN_LEVELS
    ]
    undecided = next((effect for effect in selected if effect.rivals), None)
    if significant_tests:
        outcome = Outcome.UNKNOWN
    elif not effects:
        outcome = Outcome.NONE
    else:
        outcome = Outcome.AMBIGUOUS if undecided else Outcome.IDENTIFIED
    names = (undecided.fit.model.name, *undecided.rivals) if undecided is not None and outcome is Outcome.AMBIGUOUS else ()
    residual = "; ".join(f"{remain.what} differ by {remain.levels:.2g} grey levels" for remain in significant_tests)
    p_value = min(1.0, 3.0 * min(test.p_value for test in before))
    reference = series.reference
    return IntensityDiagnosis(
        outcome, tuple(effects), names, (DomainTest("intensity", p_value, 0.0),), tuple(evidence.items()), time_series.frames,
        time_series.local.shape[1], _noise(series.noise), reference.mean, reference.contrast, max(frame.clipped for frame in series.frames),
        tuple(float(value) for value in time_series.time_s.mean(axis=1)), _histories(time_series, intensity_models), residual,
    )  # fmt: skip


def _effect(
    time_series: IntensityTimeSeries, series: IntensityFrames, intensity_models: Sequence[IntensityModel], fit: IntensityFit
) -> IdentifiedEffect:
    """Identified effect with its parameters from a joint fit with all other models."""
    other_models = tuple(intensity_model for intensity_model in intensity_models if intensity_model is not fit.model)
    last = IntensityRegression(time_series, other_models).fit(fit.model)
    size, sigma = last.amplitudes, np.sqrt(np.diag(last.covariance))
    values: tuple[tuple[str, float], ...] = ()
    if fit.model.family is CONTAMINATION:
        parameters = _contamination_parameters(time_series, last)
    elif fit.model.family is DEFOCUS:
        rate = float(np.sqrt(max(size[0], 0.0)))
        parameters = [ParameterEstimate("blur_px_per_s", rate, float(0.5 * sigma[0] / max(rate, 1e-12)), "px/s")]
        if fit.model.kind == "through the best":
            best_s = float(-0.5 * size[1] / size[0])
            lever = np.array([-best_s, -0.5]) / size[0]
            parameters.append(ParameterEstimate("sharpest_s", best_s, float(np.sqrt(lever @ last.covariance @ lever)), "s"))
    else:
        grey = series.reference.smooth[series.reference.measured].ravel()[::7].astype(np.float64)
        parameters = [
            *curve_parameters(size, last.covariance, grey),
            ParameterEstimate("at_s", fit.model.at_s, fit.model.sigma_s, "s"),
        ]
        values = (("at_s", fit.model.at_s),)
    model_effect = ModelEffect(fit.model.name, values, 0.0)
    return IdentifiedEffect(fit.model.name, tuple(parameters), 0.0, fit.odds, min(1.0, TESTS * fit.p_value), False, model_effect)


def _contamination_parameters(time_series: IntensityTimeSeries, fit: IntensityFit) -> list[ParameterEstimate]:
    """Parameters of contamination relative to the grey level at the start of frame 0; the fit is relative to frame 1."""
    lever = np.zeros(len(fit.amplitudes))
    lever[0] = 1.0
    if fit.model.kind == "slowing":
        lever[1] = 1.0  # mean over the run
    rate = float(lever @ fit.amplitudes)
    sigma = float(np.sqrt(lever @ fit.covariance @ lever))
    rate /= 1.0 + rate * float(time_series.time_s[0].mean())
    parameters = [ParameterEstimate("loss_per_s", rate, sigma, "1/s")]
    level, undecided = black_level(fit)
    return [*parameters, ParameterEstimate("black_level", level, undecided, "levels")] if fit.model.kind == "black level" else parameters


def _flash_effect(flashes_found: Sequence[Flash], rows: int) -> IdentifiedEffect:
    """Identified effect from all flashes, among the given number of rows."""
    levels = np.array([entry.levels for entry in flashes_found])
    weight = np.array([entry.sigma_levels for entry in flashes_found]) ** -2.0
    height = float(np.sum(weight * levels) / np.sum(weight))
    parameters = [ParameterEstimate("flash_levels", height, float(np.sum(weight) ** -0.5), "levels")]
    for number, entry in enumerate(flashes_found, start=1):
        more = "" if number == 1 else f"_{number}"
        parameters.append(ParameterEstimate(f"flash{more}_at_s", entry.at_s, 0.5 * entry.length_s, "s"))
    parameters.append(ParameterEstimate("flash_s", float(np.median([entry.length_s for entry in flashes_found])), 0.0, "s"))
    squares = levels**2 * weight
    odds = float(np.sum(0.5 * squares - np.log(rows)))
    p_value = min(1.0, rows * float(ndtr(-np.sqrt(squares.max()))))
    return IdentifiedEffect(CHARGING_JUMP.name, tuple(parameters), 0.0, odds, p_value, False, ModelEffect(CHARGING_JUMP.name, (), 0.0))


def _noise(pairs: Array) -> tuple[ParameterEstimate, ParameterEstimate]:
    """Noise parameters: mean over pairs, with standard uncertainty from their scatter."""
    count = len(pairs)
    mean = pairs.mean(axis=0) if count else np.full(2, np.nan)
    sigma = pairs.std(axis=0, ddof=1) / np.sqrt(count) if count > 1 else np.full(2, np.nan)
    return (
        ParameterEstimate("dark_variance_levels2", float(mean[0]), float(sigma[0]), "levels^2"),
        ParameterEstimate("variance_per_level", float(mean[1]), float(sigma[1]), "levels"),
    )


def _histories(time_series: IntensityTimeSeries, intensity_models: Sequence[IntensityModel]) -> tuple[IntensityHistory, ...]:
    """Quantities of each frame with their joint fit, which includes the offset by the noise of frame 1."""
    value = time_series.value.mean(axis=1)
    fitted = np.zeros_like(value)
    if intensity_models:
        columns = np.concatenate([intensity_model.columns for intensity_model in intensity_models])
        white = time_series.white(columns).reshape(len(columns), -1)
        amplitudes = np.linalg.lstsq(white.T, time_series.white(time_series.value).ravel(), rcond=None)[0]
        fitted = np.einsum("k,kfrp->fp", amplitudes, columns) / columns.shape[2]
    fitted = fitted + (value - fitted).mean(axis=0)
    sigma = time_series.frame_sigma()
    names = (("mean", "levels"), ("gain", "1"), ("curvature", "levels"), ("blur", "px^2"))
    return tuple(
        IntensityHistory(name, unit, tuple(value[:, at].tolist()), float(sigma[at]), tuple(fitted[:, at].tolist()))
        for at, (name, unit) in enumerate(names)
    )


def curve_parameters(change: Array, covariance: Array, grey: Array) -> tuple[ParameterEstimate, ...]:
    """Parameters a, g and b of I -> 255 a (I / 255)^g + b.

    Args:
        change: (3,) change of the mean, grey levels, of the gain, and of the curvature, grey levels at unit contrast.
        covariance: (3, 3) covariance of the change.
        grey: (n,) grey levels of the pattern, without noise.
    """
    grey = np.clip(grey, 1.0, 254.0)
    mean, contrast = float(grey.mean()), float(grey.std())
    own = (grey - mean) / contrast
    shapes = np.stack([np.ones_like(own), own, own**2 - 1.0], axis=-1)
    project = np.linalg.pinv(shapes)

    def changed(parameters: Array) -> Array:
        gain, gamma, offset = parameters
        misfit = project @ (255.0 * gain * (grey / 255.0) ** gamma + offset - grey)
        return np.array([misfit[0], misfit[1] / contrast, misfit[2]])

    weigh = np.linalg.inv(np.linalg.cholesky(covariance + 1e-12 * np.eye(3)))

    def misfit(parameters: Array) -> Array:
        return np.concatenate([weigh @ (changed(parameters) - change), (parameters - PRIOR_MEAN) / PRIOR_SD])

    fit = least_squares(misfit, PRIOR_MEAN, x_scale=np.array([0.1, 0.1, 10.0]))
    sigma = np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac)))
    labels = (("gain", "1"), ("gamma", "1"), ("offset_levels", "levels"))
    return tuple(ParameterEstimate(name, float(value), float(s), unit) for (name, unit), value, s in zip(labels, fit.x, sigma, strict=True))
