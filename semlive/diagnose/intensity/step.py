"""Gain, gamma and offset of a change of the intensity curve, from its change of mean, gain and curvature."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from semlive.data.diagnosis.effects import ParameterEstimate

Array = NDArray[np.float64]
PRIOR_MEAN = np.array([1.0, 1.0, 0.0])
PRIOR_SD = np.array([1.0, 1.0, 100.0])
"""Prior standard deviations of gain, gamma and offset: a pattern of two grey levels does not determine three parameters."""


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
