"""Young's modulus and Poisson's ratio from the load steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from semlive.data.strain import ElasticConstants, MeasuredValue, StrainSummary
from semlive.errors import IllPosed

# Loads that differ by less are one load that was held twice: their difference is relaxation and noise of the load cell.
MIN_SPAN = 0.01
Field = NDArray[np.float64]
Covariance = Field | Callable[[Field], Field]
"""(2 n, 2 n) covariance of the strains of n steps, first all exx, then all eyy; or a function that returns the (k, k) covariance of linear
functions (k, 2 n) of them.

For a thousand steps the full matrix costs a hundred times as much as the two slopes require.
"""


def elastic_constants(
    points: Sequence[tuple[float, StrainSummary]],
    area_mm2: float,
    loading_axis: str = "y",
    load_sigma_n: float = 0.0,
    covariance: Covariance | None = None,
) -> ElasticConstants:
    """Fit the slopes of axial and transverse strain over stress, with free intercepts.

    Strain is fitted over stress because the load cell is the more precise of the two; noise in the regressor would reduce the slope. The
    remaining load uncertainty `load_sigma_n` enters the weights (effective variance). The intercepts absorb the strain of frame 0 and
    everything common to all load steps. The uncertainty of the cross-section is not included.

    Args:
        points: (mean load in N, strain of the frame), one for each frame under load, tension positive.
        area_mm2: cross-section, mm^2.
        loading_axis: image axis of the load, ``x`` or ``y``.
        load_sigma_n: standard uncertainty of one mean load, N, independent from frame to frame.
        covariance: covariance of the mean strains; None treats the standard uncertainties of the frames as independent.

    Raises:
        IllPosed: fewer than two distinct loads, or strain does not follow stress.
    """
    stress_mpa = np.array([load for load, _ in points], dtype=np.float64) / area_mm2
    if len(points) < 2 or np.ptp(stress_mpa) <= MIN_SPAN * float(np.max(np.abs(stress_mpa))):
        raise IllPosed("elastic constants need frames at two or more different loads: add a load step")
    strain = np.array([(value.mean.exx, value.mean.eyy) for _, value in points]).T
    sigma = np.maximum(np.array([(value.mean_sigma.exx, value.mean_sigma.eyy) for _, value in points]).T, 1e-9)
    if covariance is None:
        covariance = np.diag(sigma.ravel() ** 2)
    axial, transverse = (0, 1) if loading_axis == "x" else (1, 0)
    contrast = np.zeros((2, 2, len(points)))  # slope of each component as a linear function of both components' strains
    slope, load_variance = np.zeros(2), np.zeros(2)
    for row, component in enumerate((axial, transverse)):
        weights = _slope_weights(stress_mpa, strain[component], sigma[component], load_sigma_n / area_mm2)
        contrast[row, component] = weights
        slope[row] = weights @ strain[component]
        load_variance[row] = float(weights @ weights) * (slope[row] * load_sigma_n / area_mm2) ** 2
    flat = contrast.reshape(2, -1)
    joint = covariance_of(covariance, flat)
    if slope[0] <= 0.0:
        raise IllPosed("axial strain does not grow with stress: check the loading axis and the sign of the load")
    ratio = -slope[1] / slope[0]
    towards_ratio = np.array([-ratio, -1.0]) / slope[0]  # errors of the load act on both slopes alike and cancel in the ratio
    return ElasticConstants(
        MeasuredValue(float(1e-3 / slope[0]), float(1e-3 * np.sqrt(joint[0, 0] + load_variance[0]) / slope[0] ** 2)),
        MeasuredValue(float(ratio), float(np.sqrt(towards_ratio @ joint @ towards_ratio))),
    )


def covariance_of(covariance: Covariance, functions: Field) -> Field:
    """(k, k) covariance of linear functions (k, 2 n)."""
    return covariance(functions) if callable(covariance) else functions @ covariance @ functions.T


def _slope_weights(
    stress: NDArray[np.float64], strain: NDArray[np.float64], strain_sigma: NDArray[np.float64], stress_sigma: float
) -> NDArray[np.float64]:
    """(n,) weights whose product with the strains is the weighted slope with free intercept (effective variance)."""
    slope = float(np.polyfit(stress, strain, 1)[0])
    weight = 1.0 / (strain_sigma**2 + (slope * stress_sigma) ** 2)
    centred = stress - np.average(stress, weights=weight)
    return weight * centred / float(weight @ centred**2)
