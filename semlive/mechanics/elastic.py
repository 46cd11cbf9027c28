"""Young's modulus and Poisson's ratio from the load steps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from semlive.data.strain import ElasticConstants, Measured, StrainSummary
from semlive.errors import IllPosed


def elastic_constants(
    points: Sequence[tuple[float, StrainSummary]], area_mm2: float, loading_axis: str = "y", load_sigma_n: float = 0.0
) -> ElasticConstants:
    """Slopes of axial and transverse strain over stress, intercepts free.

    Strain is fitted over stress, not the other way round: the load cell is by far the better of the two, and noise in
    the regressor would flatten the slope. What is left of it, `load_sigma_n`, enters the weights (effective variance).
    The intercepts take up strain of frame 0 and everything else that all load steps have in common.

    Args:
        points: (mean load in N, strain of the frame), one for each frame under load, tension positive.
        area_mm2: cross-section.
        loading_axis: ``x`` or ``y``, the image axis that is pulled.
        load_sigma_n: standard uncertainty of one mean load.

    Raises:
        IllPosed: fewer than two distinct loads, or strain does not follow stress.
    """
    stress_mpa = np.array([load for load, _ in points], dtype=np.float64) / area_mm2
    if len(points) < 2 or np.ptp(stress_mpa) <= 1e-6 * max(1.0, float(np.max(np.abs(stress_mpa)))):
        raise IllPosed("elastic constants need frames at two or more different loads: add a load step")
    axial_name, transverse_name = ("exx", "eyy") if loading_axis == "x" else ("eyy", "exx")
    axial, axial_sigma = _series(points, axial_name)
    transverse, transverse_sigma = _series(points, transverse_name)
    stress_sigma = load_sigma_n / area_mm2
    b, b_sigma = _slope(stress_mpa, axial, axial_sigma, stress_sigma)
    t, t_sigma = _slope(stress_mpa, transverse, transverse_sigma, stress_sigma)
    if b <= 0.0:
        raise IllPosed("axial strain does not grow with stress: check the loading axis and the sign of the load")
    ratio = -t / b
    # Load errors act on both slopes alike, so they cancel in the ratio but for what the separate sigmas already hold.
    return ElasticConstants(
        Measured(1e-3 / b, 1e-3 * b_sigma / b**2),
        Measured(ratio, float(np.hypot(t_sigma, ratio * b_sigma)) / b),
    )


def _series(points: Sequence[tuple[float, StrainSummary]], name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    value = np.array([getattr(one.mean, name) for _, one in points])
    sigma = np.array([getattr(one.mean_sigma, name) for _, one in points])
    return value, np.maximum(sigma, 1e-9)


def _slope(x: NDArray[np.float64], y: NDArray[np.float64], y_sigma: NDArray[np.float64], x_sigma: float) -> tuple[float, float]:
    """Weighted slope with free intercept, and its standard uncertainty; errors in x by effective variance."""
    slope = float(np.polyfit(x, y, 1)[0])
    sigma = 0.0
    for _ in range(3):
        weight = 1.0 / (y_sigma**2 + (slope * x_sigma) ** 2)
        centred = x - np.average(x, weights=weight)
        spread = float(weight @ centred**2)
        slope, sigma = float(weight @ (centred * y)) / spread, spread**-0.5
    return slope, sigma
