"""Diagnosis with a strain gage: out-of-plane translation causes apparent strain in the maps and none in the gage."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.special import chdtrc, fdtrc

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
"""Map effects that also change the mean strain of the maps relative to a gage, because loads grow with time.

At eight times their detection limit none of them reached the threshold alone; the largest were a wrong row time (6.8) and a tilt (5.1).
"""
MIN_UNLOADED_PAIRS = 4  # minimum number of unloaded pairs for an estimate of the gage's drift
_MIN_STRAIN_SIGMA = 1e-9  # regularises the covariance


@dataclass(frozen=True, slots=True, eq=False)
class GageReadings:
    """Gage readings of each pair with the load and the strain of the maps.

    Attributes:
        load_readings: time, load and strain of the maps for each pair.
        gage: (n,) mean gage reading, tension positive; NaN without readings.
        gage_sigma: (n,) standard uncertainty by the scatter of the readings.
        factor_sigma: relative standard uncertainty of the gage factor, common to all readings.
    """

    load_readings: LoadReadings
    gage: Array
    gage_sigma: Array
    factor_sigma: float


def gage_readings(readings: LoadReadings, steps: Sequence[StepConditions], factor_sigma: float) -> GageReadings | None:
    """Gage readings of a run; None without a gage."""
    if all(step.gage is None for step in steps):
        return None
    gage = np.array([math.nan if step.gage is None else step.gage.value for step in steps])
    sigma = np.array([0.0 if step.gage is None else step.gage.sigma for step in steps])
    return GageReadings(readings, gage, sigma, factor_sigma)


def add_gage_evidence(verdict: Diagnosis, readings: GageReadings | None) -> Diagnosis:
    """Add the evidence of a gage to a verdict; the verdict is unchanged without a gage or with too few loads.

    Out-of-plane translation is a difference between the strain of maps and gage proportional to the load. A difference common to all loads
    (zero of the gage, seating of the grips) is a free parameter. Other differences are reported as a domain test only.
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
    """Loaded pairs with gage readings.

    Attributes:
        load_n: (n,) mean reading of the load cell.
        maps: (n,) strain of the maps.
        gage: (n,) strain of the gage, its drift subtracted.
        covariance: (n, n) covariance of the difference, without the gage factor.
    """

    load_n: Array
    maps: Array
    gage: Array
    covariance: Array


@dataclass(frozen=True, slots=True, eq=False)
class _Test:
    """Test of a strain difference proportional to the load.

    Attributes:
        per_n: strain of the maps minus that of the gage, per N.
        sigma: its standard uncertainty, including the gage factor.
        maps_per_n: strain of the maps, per N.
        largest_n: largest load, N.
        half_px: half of the frame size along the load, px.
        p_value: p-value of per_n.
        log_factor: logarithm of the Bayes factor.
        scatter_p: p-value of the residual scatter, by the uncertainties alone.
        rms_px: root mean square of the difference without its mean, as displacement at the edge of the frame.
        gap: misfit of readings predicted from all others.
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
        """Whether the difference exceeds the accuracy of gages, a thousandth of the strain."""
        return abs(self.per_n) > MIN_RELATIVE_LOAD * abs(self.maps_per_n)

    def effect(self) -> IdentifiedEffect:
        """The identified effect; a correction for it would force the slope of the gage on the maps, so its attenuation is 1."""
        per_px = self.largest_n * self.half_px
        size = ParameterEstimate("size_px", abs(self.per_n) * per_px, self.sigma * per_px, "px")
        parameters = (ParameterEstimate("strain_per_n", self.per_n, self.sigma, "1/N"), size, *self._modulus())
        model_effect = ModelEffect(OUT_OF_PLANE.name, (), size.value)
        return IdentifiedEffect(
            OUT_OF_PLANE.name, parameters, size.value, self.log_factor, self.p_value, True, model_effect, strain_attenuation=1.0
        )

    def _modulus(self) -> tuple[ParameterEstimate, ...]:
        """Relative change of Young's modulus by a correction; empty if the corrected slope has the wrong sign."""
        residual = self.maps_per_n - self.per_n
        if residual * self.maps_per_n <= 0.0:
            return ()
        return (ParameterEstimate("modulus_change", self.per_n / residual, self.sigma * abs(self.maps_per_n) / residual**2, "1"),)


def _test(readings: GageReadings) -> _Test | None:
    """Test of a slope over the load jointly with an offset; None with too few or equal loads."""
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
    scatter_p = float(chdtrc(slope.degrees_of_freedom, slope.residual_ss))
    largest_n = float(np.abs(observed.load_n).max())
    gap = _gap(observed, half_px)
    return _Test(slope.value, sigma, of_maps.value, largest_n, half_px, p_value, log_factor, scatter_p, rms_px, gap)


def _loaded_pairs(readings: GageReadings) -> _LoadedPairs:
    """Loaded pairs, corrected for a linear drift of the gage that the unloaded pairs determine."""
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
    """Drift rate of a gage without load, strain per s, and its standard uncertainty."""
    if len(time_s) < MIN_UNLOADED_PAIRS or np.ptp(time_s) <= 0.0:
        return 0.0, 0.0
    late_s = time_s - time_s.mean()
    power = float(late_s @ late_s)
    rate = float(late_s @ gage) / power
    residual = gage - gage.mean() - rate * late_s
    return rate, math.sqrt(float(residual @ residual) / (len(gage) - 2) / power)


def _combined_test(slope: RegressionTerm, factor: float) -> tuple[float, float, float]:
    """Combined uncertainty of a slope, its p-value by an F-test, and its log Bayes factor by Schwarz's approximation.

    The scatter of the readings has few degrees of freedom; the uncertainty of the gage factor is given. Their combination has the degrees
    of freedom by Satterthwaite. With the factor treated as scatter, none of 200 translations of five times its uncertainty was identified.

    Args:
        slope: slope of the difference, strain per N, with its uncertainty by scatter.
        factor: standard uncertainty by the gage factor, strain per N.
    """
    sigma = math.hypot(slope.sigma, factor)
    freedom = slope.degrees_of_freedom * (sigma / slope.sigma) ** 4
    ratio = (slope.value / sigma) ** 2
    odds = 0.5 * (freedom + 1.0) * math.log1p(ratio / freedom) - 0.5 * math.log(slope.degrees_of_freedom + 1.0)
    return sigma, float(fdtrc(1, freedom, ratio)), odds


def _gap(observed: _LoadedPairs, half_px: float) -> HeldOutMisfit:
    """Misfit of the difference of each pair predicted from all others, without and with the slope, each with an offset."""
    n = len(observed.load_n)
    centring = np.eye(n) - 1.0 / n
    sigma = np.sqrt(np.diag(centring @ observed.covariance @ centring) * n / (n - 1.0))
    columns = np.stack([np.ones(n), observed.load_n], axis=-1) / sigma[:, None]
    white = (observed.maps - observed.gage) / sigma
    (before, _), (after, variance_ratio) = (leave_one_out(white, orthonormal_basis(value, 1e-12)) for value in (columns[:, :1], columns))
    return score_prediction(before, after, variance_ratio, half_px * sigma)
