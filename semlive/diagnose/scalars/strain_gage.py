"""The gage's channel: what a strain gage said, beside the strain that maps show; a specimen that is lifted is strain to maps alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.stats import chi2
from scipy.stats import f as fisher

from semlive.data.diagnosis.effects import DomainTest, HeldOutMisfit, IdentifiedEffect, ModelEffect, ParameterEstimate
from semlive.data.diagnosis.verdict import Diagnosis
from semlive.diagnose.baseline.observation import StepConditions
from semlive.diagnose.maps.effect_selection import SIGNIFICANCE_LEVEL, SIGNIFICANT_LOG_FACTOR
from semlive.diagnose.scalars.load_cell import MIN_RELATIVE_LOAD, LoadReadings, limit_precision, merge_effects, score_prediction
from semlive.diagnose.scalars.regression import MIN_DEGREES_OF_FREEDOM, RegressionTerm, leave_one_out, orthonormal_basis, term
from semlive.model.effects.load_cell import OUT_OF_PLANE

Array = NDArray[np.float64]
STRAIN_LIKE_EFFECTS = (
    *OUT_OF_PLANE.rivals, "inhomogeneous_strain", "magnification_drift", "magnification_frame_instability", "refocus_magnification_step",
    "aspect_drift", "distortion_scale_drift", "tilt_with_load", "wrong_row_time",
)  # fmt: skip
"""Names of maps that set their mean strain apart from a gage's as well: loads grow with time.

At eight times what can be detected none of them was loud by itself; a wrong row time came to 6.8, a tilt to 5.1.
"""
MIN_UNLOADED_PAIRS = 4  # unloaded pairs from which on the gage's own drift is known
_MIN_STRAIN_SIGMA = 1e-9  # no strain is known better


@dataclass(frozen=True, slots=True, eq=False)
class GageReadings:
    """What a gage said of each pair, beside what is known of it otherwise.

    Attributes:
        load_readings: (n,) time, load and strain by maps of each pair.
        gage: (n,) its mean reading, tension positive; NaN where it was silent.
        gage_sigma: (n,) standard uncertainty by the scatter of the readings.
        factor_sigma: relative standard uncertainty of its factor, which all readings share.
    """

    load_readings: LoadReadings
    gage: Array
    gage_sigma: Array
    factor_sigma: float


def gage_readings(readings: LoadReadings, steps: Sequence[StepConditions], factor_sigma: float) -> GageReadings | None:
    """Of the pairs of a run; None without a gage."""
    if all(step.gage is None for step in steps):
        return None
    gage = np.array([math.nan if step.gage is None else step.gage.value for step in steps])
    sigma = np.array([0.0 if step.gage is None else step.gage.sigma for step in steps])
    return GageReadings(readings, gage, sigma, factor_sigma)


def add_gage_evidence(verdict: Diagnosis, readings: GageReadings | None) -> Diagnosis:
    """The verdict with what a gage says beside it; the same where there is none, or it was read at too few loads.

    A lift is what the maps' strain is ahead of the gage's in proportion to the load. What is ahead of it alike at all loads (the gage's
    zero, grips that seat) is free; what differs from load to load without a law is told as a domain and has no name.
    """
    test = None if readings is None else _test(readings)
    if test is None:
        return verdict
    p_value = min(1.0, 2.0 * min(test.p_value, test.scatter_p))
    where = (*verdict.where, DomainTest("gage_readings", p_value, test.rms_px))
    merged = replace(verdict, where=where, evidence=(*verdict.evidence, (OUT_OF_PLANE.name, test.log_factor)))
    other_names = {model_effect.name for model_effect in (*verdict.model_effects, *verdict.effects)}
    if (
        OUT_OF_PLANE.name in other_names
        or test.log_factor < SIGNIFICANT_LOG_FACTOR
        or test.p_value > SIGNIFICANCE_LEVEL
        or not test.matters
    ):
        return merged
    merged = replace(merged, gap=merged.gap or test.gap)
    return merge_effects(merged, [test.effect()], [tuple(name for name in STRAIN_LIKE_EFFECTS if name in other_names)], [OUT_OF_PLANE])


@dataclass(frozen=True, slots=True, eq=False)
class _LoadedPairs:
    """Loaded pairs at which the gage spoke.

    Attributes:
        load_n: (n,) mean reading of the load cell.
        maps: (n,) strain by maps.
        gage: (n,) by the gage, its own drift taken off.
        covariance: (n, n) of the difference, without the gage's factor.
    """

    load_n: Array
    maps: Array
    gage: Array
    covariance: Array


@dataclass(frozen=True, slots=True, eq=False)
class _Test:
    """A difference in proportion to the load, how much it explains, and what it amounts to.

    Attributes:
        per_n: what maps are ahead of the gage, strain per N.
        sigma: its standard uncertainty, the gage's factor in it.
        maps_per_n: what maps show, strain per N.
        largest_n: the largest load.
        half_px: half of the frame's extent along the load.
        p_value: of per_n.
        log_factor: logarithm of the Bayes factor.
        scatter_p: of what is left beside it, by the uncertainties alone.
        rms_px: the whole difference but for its mean, at the edge of the frame.
        gap: on readings that are foretold from all others.
    """

    per_n: float
    sigma: float
    maps_per_n: float
    largest_n: float
    half_px: float
    p_value: float
    log_factor: float
    scatter_p: float
    rms_px: float
    gap: HeldOutMisfit

    @property
    def matters(self) -> bool:
        """No gage is so right that a thousandth of the strain would be more than a gage."""
        return abs(self.per_n) > MIN_RELATIVE_LOAD * abs(self.maps_per_n)

    def effect(self) -> IdentifiedEffect:
        """A correction for it would give maps the gage's slope: it takes all strain that only maps show."""
        per_px = self.largest_n * self.half_px
        size = ParameterEstimate("size_px", abs(self.per_n) * per_px, self.sigma * per_px, "px")
        parameters = (ParameterEstimate("strain_per_n", self.per_n, self.sigma, "1/N"), size, *self._modulus())
        model_effect = ModelEffect(OUT_OF_PLANE.name, (), size.value)
        return IdentifiedEffect(
            OUT_OF_PLANE.name, parameters, size.value, self.log_factor, self.p_value, True, model_effect, strain_attenuation=1.0
        )

    def _modulus(self) -> tuple[ParameterEstimate, ...]:
        """What a correction would change of Young's modulus, relative; nothing where no slope would be left."""
        residual = self.maps_per_n - self.per_n
        if residual * self.maps_per_n <= 0.0:
            return ()
        return (ParameterEstimate("modulus_change", self.per_n / residual, self.sigma * abs(self.maps_per_n) / residual**2, "1"),)


def _test(readings: GageReadings) -> _Test | None:
    """A slope over the load beside an offset; None where the loads are too few, or all alike."""
    observed = _loaded_pairs(readings)
    if len(observed.load_n) < 2 + MIN_DEGREES_OF_FREEDOM:
        return None
    columns = np.stack([np.ones_like(observed.load_n), observed.load_n, observed.maps, observed.gage], axis=-1)
    offset, load, maps, gage = solve_triangular(np.linalg.cholesky(observed.covariance), columns, lower=True).T
    base = orthonormal_basis(offset[:, None], 1e-12)
    slope, of_maps, of_gage = (term(load, value, base) for value in (maps - gage, maps, gage))
    limited = limit_precision(slope)
    if slope is None or limited is None or of_maps is None or of_gage is None or not slope.residual_ss > 0.0:
        return None
    sigma, p_value, log_factor = _combined_test(limited, readings.factor_sigma * abs(of_gage.value))
    half_px = readings.load_readings.half_px
    rms_px = half_px * float(np.std(observed.maps - observed.gage))
    scatter_p = float(chi2.sf(slope.residual_ss, slope.degrees_of_freedom))
    largest_n = float(np.abs(observed.load_n).max())
    gap = _gap(observed, half_px)
    return _Test(slope.value, sigma, of_maps.value, largest_n, half_px, p_value, log_factor, scatter_p, rms_px, gap)


def _loaded_pairs(readings: GageReadings) -> _LoadedPairs:
    """The gage's drift is that of the unloaded pairs, on a line, and as uncertain as their scatter makes it."""
    load_readings, has_reading = readings.load_readings, np.isfinite(readings.gage)
    unloaded, retained = has_reading & ~load_readings.loaded, np.flatnonzero(has_reading & load_readings.loaded)
    rate, rate_sigma = _drift(load_readings.time_s[unloaded], readings.gage[unloaded])
    late_s = load_readings.time_s[retained] - load_readings.time_s[retained].mean() if len(retained) else np.zeros(0)
    covariance = load_readings.strain_covariance[np.ix_(retained, retained)] + np.diag(
        readings.gage_sigma[retained] ** 2 + _MIN_STRAIN_SIGMA**2
    )
    covariance = covariance + rate_sigma**2 * np.outer(late_s, late_s)
    return _LoadedPairs(load_readings.load_n[retained], load_readings.strain[retained], readings.gage[retained] - rate * late_s, covariance)


def _drift(time_s: Array, gage: Array) -> tuple[float, float]:
    """Strain per s that a gage shows while nothing is loaded, and its standard uncertainty."""
    if len(time_s) < MIN_UNLOADED_PAIRS or np.ptp(time_s) <= 0.0:
        return 0.0, 0.0
    late_s = time_s - time_s.mean()
    power = float(late_s @ late_s)
    rate = float(late_s @ gage) / power
    residual = gage - gage.mean() - rate * late_s
    return rate, math.sqrt(float(residual @ residual) / (len(gage) - 2) / power)


def _combined_test(slope: RegressionTerm, factor: float) -> tuple[float, float, float]:
    """The uncertainty of a slope of which a part is known beforehand, its p-value by an F-test, and Schwarz's logarithm of the factor.

    What readings scatter by is known by the scatter, with few degrees of freedom, and the gage's factor is stated: those of both together
    are Satterthwaite's. With the factor among what scatters, none of 200 lifts of five times its uncertainty was named.

    Args:
        slope: of the difference, strain per N, with what the readings scatter by.
        factor: standard uncertainty that the gage's factor adds, strain per N.
    """
    sigma = math.hypot(slope.sigma, factor)
    freedom = slope.degrees_of_freedom * (sigma / slope.sigma) ** 4
    ratio = (slope.value / sigma) ** 2
    odds = 0.5 * (freedom + 1.0) * math.log1p(ratio / freedom) - 0.5 * math.log(slope.degrees_of_freedom + 1.0)
    return sigma, float(fisher.sf(ratio, 1, freedom)), odds


def _gap(observed: _LoadedPairs, half_px: float) -> HeldOutMisfit:
    """How well each pair's difference is foretold by all others, without and with the slope. What all loads share is in the offset."""
    n = len(observed.load_n)
    centring = np.eye(n) - 1.0 / n
    sigma = np.sqrt(np.diag(centring @ observed.covariance @ centring) * n / (n - 1.0))
    columns = np.stack([np.ones(n), observed.load_n], axis=-1) / sigma[:, None]
    white = (observed.maps - observed.gage) / sigma
    (before, _), (after, variance_ratio) = (leave_one_out(white, orthonormal_basis(value, 1e-12)) for value in (columns[:, :1], columns))
    return score_prediction(before, after, variance_ratio, half_px * sigma)
