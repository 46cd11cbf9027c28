"""Intensity models over time: a few columns each, linear in the amplitudes, with tests of physical plausibility."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from semlive.diagnose.intensity.frames import INTENSITY_TERMS
from semlive.diagnose.intensity.time_series import IntensityTimeSeries
from semlive.model.effects.intensity import CHARGING_JUMP, CONTAMINATION, DEFOCUS, GAMMA_CHANGE, IntensityEffectClass

Array = NDArray[np.float64]
DRIFT = "grey drift without a name"
BLACK_LEVEL_TOLERANCE = 0.25  # largest standard uncertainty of a black level, as a fraction of the mean grey level


@dataclass(frozen=True, slots=True, eq=False)
class IntensityModel:
    """One intensity model.

    Attributes:
        family: effect class; None for unnamed models.
        kind: variant of the model within the class.
        columns: (k, f, r, TERMS) columns; the last may be nuisance columns.
        at_s: instant of a step, s.
        sigma_s: half of the interval in which steps are equally likely, s.
        trial_count: number of tested steps.
        nuisance_columns: number of columns, the last ones, for a band that contains the step; they do not count as evidence.
    """

    family: IntensityEffectClass | None
    kind: str
    columns: Array
    at_s: float = 0.0
    sigma_s: float = 0.0
    trial_count: int = 1
    nuisance_columns: int = 0

    @property
    def name(self) -> str:
        """Canonical name, or the name of unnamed models."""
        return self.family.name if self.family else DRIFT


@dataclass(frozen=True, slots=True, eq=False)
class IntensityFit:
    """Fit of one model jointly with those of the baseline.

    Attributes:
        model: the fitted model.
        amplitudes: (k,) amplitudes of the model.
        covariance: (k, k) covariance of the amplitudes.
        explained_chi2: chi-squared explained by the model in addition to the baseline.
        odds: log Bayes factor by Schwarz's approximation.
        p_value: probability of this chi-squared by noise, over all tested instants.
    """

    model: IntensityModel
    amplitudes: Array
    covariance: Array
    explained_chi2: float
    odds: float
    p_value: float


def smooth_models(time_series: IntensityTimeSeries) -> tuple[IntensityModel, ...]:
    """Models of continuous changes. Contamination may have a black level or slow down; focus may pass its best value."""
    time_s = time_series.time_s[..., None]
    mean, gain, curve, blur = (time_s * value for value in np.eye(INTENSITY_TERMS))
    scale = float(time_series.time_s.max())
    loss = -(time_series.mean * mean + gain)
    later = time_series.time_s[..., None] / scale
    return (
        IntensityModel(CONTAMINATION, "linear", np.stack([loss])),
        IntensityModel(CONTAMINATION, "black level", np.stack([loss, mean])),
        IntensityModel(CONTAMINATION, "slowing", np.stack([loss, loss * later])),
        IntensityModel(DEFOCUS, "from the start", np.stack([blur * time_s])),
        IntensityModel(DEFOCUS, "through the best", np.stack([blur * time_s, blur])),
        IntensityModel(None, "drift", np.stack([mean, mean * later, gain, gain * later])),
        IntensityModel(None, "sharpness", np.stack([blur, blur * later, curve])),
    )


def steps(time_series: IntensityTimeSeries) -> tuple[IntensityModel, ...]:
    """Steps of the intensity curve between all frames and within each band, which then has separate amplitudes."""
    models = []
    for frame in range(1, time_series.frames):
        early, late = time_series.span_s[frame - 1, -1, 1], time_series.span_s[frame, 0, 0]
        models.append(step_at(time_series, 0.5 * float(early + late), 0.5 * float(late - early)))
        models += [step_at(time_series, float(span.mean()), 0.5 * float(np.ptp(span))) for span in time_series.span_s[frame]]
    return tuple(replace(effect, trial_count=len(models)) for effect in models)


def step_at(time_series: IntensityTimeSeries, at_s: float, sigma_s: float = 0.0) -> IntensityModel:
    """Step of the intensity curve at an instant; a band that contains it has separate amplitudes."""
    after = time_series.span_s[..., 0] >= at_s
    partial = ~after & (time_series.span_s[..., 1] > at_s)
    columns = [after[..., None] * value for value in np.eye(INTENSITY_TERMS)[:3]]
    partial_columns = [partial[..., None] * value for value in np.eye(INTENSITY_TERMS)[:3]] if partial.any() else []
    return IntensityModel(
        GAMMA_CHANGE,
        "step",
        np.stack([*columns, *partial_columns]).astype(np.float64),
        at_s,
        sigma_s,
        nuisance_columns=len(partial_columns),
    )


def flash_at(time_series: IntensityTimeSeries, at_s: float, length_s: float) -> IntensityModel | None:
    """Separate amplitudes for bands with a flash, which excludes them from other models; None if no band contains it."""
    partial = (time_series.span_s[..., 0] <= at_s + length_s) & (time_series.span_s[..., 1] >= at_s - length_s)
    if not partial.any():
        return None
    columns = [
        (np.arange(partial.size).reshape(partial.shape) == band)[..., None] * value
        for band in np.flatnonzero(partial)
        for value in np.eye(INTENSITY_TERMS)
    ]
    return IntensityModel(CHARGING_JUMP, "flash", np.array(columns, dtype=np.float64).reshape(-1, *time_series.value.shape), at_s)


class IntensityRegression:
    """Fits intensity models to time series, jointly with models already included."""

    __slots__ = ("_base", "_data", "_freedom", "time_series")

    def __init__(self, time_series: IntensityTimeSeries, included: tuple[IntensityModel, ...] = ()) -> None:
        """Prepare the fit; the amplitudes of the included models are free."""
        self.time_series = time_series
        columns = [column.ravel() for intensity_model in included for column in time_series.white(intensity_model.columns)]
        self._base = _orthonormal(np.stack(columns, axis=-1)) if columns else np.zeros((time_series.value.size, 0))
        self._data = self._orthogonal(time_series.white(time_series.value).ravel())
        self._freedom = time_series.freedom

    def fit(self, intensity_model: IntensityModel) -> IntensityFit:
        """Fit a model jointly with the included ones."""
        columns = np.stack([self._orthogonal(value.ravel()) for value in self.time_series.white(intensity_model.columns)], axis=-1)
        own = len(intensity_model.columns) - intensity_model.nuisance_columns
        data = self._data
        if intensity_model.nuisance_columns:
            other_basis = _orthonormal(columns[:, own:])
            columns, data = (value - other_basis @ (other_basis.T @ value) for value in (columns, data))
        columns = columns[:, :own]
        size = np.maximum(np.sqrt(np.sum(columns**2, axis=0)), 1e-12)
        normal = (columns / size).T @ (columns / size) + 1e-9 * np.eye(own)
        inverse = np.linalg.inv(normal)
        amplitudes = inverse @ ((columns / size).T @ data)
        explained = max(float(amplitudes @ normal @ amplitudes), 0.0)
        square = float(data @ data)
        odds = self._log_likelihood(square - explained) - self._log_likelihood(square) - 0.5 * own * np.log(self.time_series.frames)
        p_value = min(1.0, intensity_model.trial_count * float(fdtrc(own, self._freedom, explained / own)))
        return IntensityFit(
            intensity_model,
            amplitudes / size,
            inverse / np.outer(size, size),
            explained,
            float(odds - np.log(intensity_model.trial_count)),
            p_value,
        )

    def add_model(self) -> IntensityFit:
        """The most likely step, and the interval of steps that are equally likely within two standard deviations."""
        fits = [self.fit(intensity_model) for intensity_model in steps(self.time_series)]
        best = max(fits, key=lambda candidate: candidate.odds)
        equally_likely = [fit.model for fit in fits if fit.odds > best.odds - 2.0]
        first, last = (
            min(model.at_s - model.sigma_s for model in equally_likely),
            max(model.at_s + model.sigma_s for model in equally_likely),
        )
        return replace(best, model=replace(best.model, at_s=0.5 * (first + last), sigma_s=0.5 * (last - first)))

    def residual(self) -> Array:
        """(f, r, TERMS) whitened residual of the included models."""
        return self._data.reshape(self.time_series.value.shape)

    def all_fits(self) -> tuple[IntensityFit, ...]:
        """Fits of all physically plausible models."""
        fits = (*(self.fit(intensity_model) for intensity_model in smooth_models(self.time_series)), self.add_model())
        return tuple(fit for fit in fits if is_physical(self.time_series, fit))

    def _log_likelihood(self, square: float) -> float:
        """Log likelihood of a residual sum of squares by Student's distribution, because pairs determine the noise."""
        degrees_of_freedom, count = self._freedom * self.time_series.value.shape[1], self._data.size
        return -0.5 * (degrees_of_freedom + count) * float(np.log(degrees_of_freedom + max(square, 0.0)))

    def _orthogonal(self, values: Array) -> Array:
        return values - self._base @ (self._base.T @ values)


def is_physical(time_series: IntensityTimeSeries, fit: IntensityFit) -> bool:
    """Whether a fit is plausible: carbon darkens, no grey level is below its black level, and the blur is positive."""
    first = float(fit.amplitudes[0])
    if fit.model.family is CONTAMINATION:
        if fit.model.kind == "slowing":
            return first > 0.0 and first + fit.amplitudes[1] > 0.0
        level, sigma = black_level(fit)
        return (
            first > 0.0 and -2.0 * sigma <= level <= time_series.darkest + 2.0 * sigma and sigma < BLACK_LEVEL_TOLERANCE * time_series.mean
        )
    return first > 0.0 if fit.model.family is DEFOCUS else True


def black_level(fit: IntensityFit) -> tuple[float, float]:
    """Black level of contamination, grey levels, and its standard uncertainty; 0 for models without one."""
    if fit.model.kind != "black level":
        return 0.0, 0.0
    loss, brighter = fit.amplitudes
    level = float(brighter / loss)
    lever = np.array([-level, 1.0]) / loss
    return level, float(np.sqrt(lever @ fit.covariance @ lever))


def _orthonormal(columns: Array) -> Array:
    size = np.sqrt(np.sum(columns**2, axis=0))
    vectors, values, _ = np.linalg.svd(columns[:, size > 0.0] / size[size > 0.0], full_matrices=False)
    return vectors[:, values > 1e-9 * values[0]]
