"""Comparison of DIC with a strain gage on the same specimen (Sutton et al. 2007, part II, Fig. 14)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from semlive.data.loading import FrameLoad
from semlive.data.notes import Note, NoteCode, information
from semlive.data.strain import GageStep, MeasuredValue, StrainGageComparison, StrainSummary
from semlive.errors import IllPosed
from semlive.mechanics.elastic import MIN_SPAN, Covariance, covariance_of

MAX_DISAGREEMENT_SIGMAS = 3.0
"""Difference of DIC and gage, in standard uncertainties, above which a warning is given."""


def compare_with_gage(
    points: Sequence[tuple[int, float, MeasuredValue, StrainSummary]],
    area_mm2: float,
    loading_axis: str = "y",
    factor_sigma: float = 0.0,
    covariance: Covariance | None = None,
) -> StrainGageComparison:
    """Fit three slopes with free intercepts: stress and both DIC strains, each over the gage strain.

    Gage readings have so little noise (1e-7 in the mean of a scan, against 1e-5 of DIC) that noise in the regressor does not
    reduce the slope.
    The uncertainty common to all three slopes is that of the gage factor.

    Args:
        points: (pair, mean load in N, mean of the gage, mean strain by DIC), one for each load step.
        area_mm2: cross-section, mm^2; its uncertainty is not included.
        loading_axis: image axis of the load and of the gage, ``x`` or ``y``.
        factor_sigma: relative standard uncertainty of the gage factor.
        covariance: covariance of the mean strains by DIC; None treats the standard uncertainties of the frames as independent.

    Raises:
        IllPosed: fewer than two distinct loads, or the gage does not follow them.
    """
    load_n = np.array([load for _, load, _, _ in points], dtype=np.float64)
    if len(points) < 2 or np.ptp(load_n) <= MIN_SPAN * float(np.max(np.abs(load_n))):
        raise IllPosed("a comparison with the strain gage needs frames at two or more different loads: add a load step")
    stress_mpa, gage = load_n / area_mm2, np.array([value.value for _, _, value, _ in points])
    gage_sigma = np.array([value.sigma for _, _, value, _ in points])
    strain = np.array([(value.mean.exx, value.mean.eyy) for *_, value in points]).T
    sigma = np.maximum(np.array([(value.mean_sigma.exx, value.mean_sigma.eyy) for *_, value in points]).T, 1e-9)
    axial, transverse = (0, 1) if loading_axis == "x" else (1, 0)
    if covariance is None:
        covariance = np.diag(sigma.ravel() ** 2)
    compliance, compliance_sigma = _gage_over_stress(stress_mpa, gage, gage_sigma)
    if compliance <= 0.0:
        raise IllPosed("the strain gage does not follow the load: check its wiring, its sign and its factor")
    n = len(points)
    slopes: list[MeasuredValue] = []
    for component in (axial, transverse):
        weights = _weights(gage, sigma[component])
        function = np.zeros((1, 2 * n))
        function[0, component * n : (component + 1) * n] = weights
        slope = float(weights @ strain[component])
        random = float(covariance_of(covariance, function)[0, 0]) + slope**2 * float(weights**2 @ gage_sigma**2)
        slopes.append(MeasuredValue(slope, float(np.sqrt(random + (slope * factor_sigma) ** 2))))
    modulus = 1e-3 / compliance
    steps = tuple(
        GageStep(pair, load, value.value, value.sigma, float(strain[axial, at]), float(sigma[axial, at]))
        for at, (pair, load, value, _) in enumerate(points)
    )
    return StrainGageComparison(
        steps,
        MeasuredValue(modulus, modulus * float(np.hypot(compliance_sigma / compliance, factor_sigma))),
        MeasuredValue(-slopes[1].value, slopes[1].sigma),
        slopes[0],
    )


def mean_gage_strain(first: FrameLoad, second: FrameLoad) -> MeasuredValue | None:
    """Mean gage strain during both frames of a pair; None if one has no readings."""
    reported = (first.gage_strain, second.gage_strain, first.gage_strain_sigma, second.gage_strain_sigma)
    if None in reported:
        return None
    first_strain, second_strain, first_sigma, second_sigma = (float(value or 0.0) for value in reported)
    return MeasuredValue(0.5 * (first_strain + second_strain), 0.5 * float(np.hypot(first_sigma, second_sigma)))


def gage_notes(comparison: StrainGageComparison | None) -> tuple[Note, ...]:
    """Note for the operator if DIC and gage disagree; empty otherwise."""
    if comparison is None:
        return ()
    ratio = comparison.dic_over_gage
    if abs(ratio.value - 1.0) <= MAX_DISAGREEMENT_SIGMAS * ratio.sigma:
        return ()
    text = (
        f"DIC gives {ratio.value:.3f} ± {ratio.sigma:.3f} times the strain of the strain gage: check the gage's factor, bending of the "
        "specimen (the gage is on its back) and whether focus or magnification was changed under load"
    )
    return (information(NoteCode.STRAIN_GAGE, text),)


def _gage_over_stress(stress: NDArray[np.float64], gage: NDArray[np.float64], sigma: NDArray[np.float64]) -> tuple[float, float]:
    """Slope of the gage strain over stress; its uncertainty is the larger of that from the readings and that from the fit residual."""
    sigma = np.maximum(sigma, 1e-9)
    weights = _weights(stress, sigma)
    slope = float(weights @ gage)
    off = gage - slope * stress
    off = (off - np.average(off, weights=sigma**-2)) / sigma
    freedom = len(gage) - 2
    scale = max(1.0, float(np.sqrt(off @ off / freedom))) if freedom > 0 else 1.0
    return slope, scale * float(np.sqrt(weights**2 @ sigma**2))


def _weights(regressor: NDArray[np.float64], sigma: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) weights whose product with values is their weighted slope over the regressor, intercept free."""
    weight = sigma**-2
    centred = regressor - np.average(regressor, weights=weight)
    return weight * centred / float(weight @ centred**2)
