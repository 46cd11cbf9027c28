"""Noise that differs between frames, components and places, or is shared by the two frames of a pair.

Maps to the second frame of a pair that were composed of two maps share the noise of the first. A noisy frame, or a poor texture in a part
of the field, has noise of its own size. With one size for all, such a run contains significant patterns without any effect.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.noise_scale import CLIP, modes, rough_modes
from semlive.diagnose.baseline.whitening import Whitener, rough_cholesky

Array = NDArray[np.float64]
SIGNIFICANT_DEVIATION = 5.0  # standard deviations of the statistics under equal and independent noise
MAX_CORRELATION = 0.9  # between the frames of a pair
FIELD_ORDER = 2  # of the polynomial of the logarithm of the noise over the field


@dataclass(frozen=True, slots=True, eq=False)
class UnequalNoise:
    """Noise with sizes of its own for frames, components and blocks.

    Attributes:
        whiten: whitening with this noise.
        parameter_penalty: log evidence lost to the additional parameters.
    """

    whiten: Whitener
    parameter_penalty: float


def unequal_noise(baseline: HyperparameterGrid) -> UnequalNoise | None:
    """Noise of the rough residual of a baseline; None if it is consistent with equal, independent noise of all frames."""
    whiten, rough = baseline.design.whiten, rough_modes(baseline.design.observation)
    residual = baseline.residual()
    over_field = _over_field(baseline, whiten, residual)
    to_rough = solve_triangular(rough_cholesky(whiten.factor, rough), rough.T @ whiten.factor, lower=True, check_finite=False)
    white = np.einsum("kb,fbc->fkc", to_rough, residual)
    limit = CLIP * 1.4826 * float(np.median(np.abs(white)))
    white = np.clip(white, -limit, limit)
    power = np.mean(white**2, axis=1)
    ratio, freedom = power / power.mean(), white.shape[1]
    excess = float(np.sum(ratio - 1.0 - np.log(ratio))) * freedom - ratio.size
    frames_differ = excess > SIGNIFICANT_DEVIATION * np.sqrt(2.0 * ratio.size)
    shared = _shared_by_pairs(white)
    if over_field is None and not frames_differ and not shared:
        return None
    scale = np.sqrt(ratio) if frames_differ else np.ones_like(ratio)
    count = (scale.size if frames_differ else 0) + (1 if shared else 0) + (0 if over_field is None else 5)
    changed = whiten
    if over_field is not None:
        changed = replace(whiten, factor=over_field[:, None] * whiten.factor, inverse=whiten.inverse / over_field)
    if frames_differ or shared:
        changed = replace(changed, over_frames=(_inverse_factor(scale[:, 0], shared), _inverse_factor(scale[:, 1], shared)))
    return UnequalNoise(changed, 0.5 * count * float(np.log(0.5 * freedom)))


def _shared_by_pairs(white: Array) -> float:
    """Correlation between the frames of a pair, without pair 0; 0 if it is not significant."""
    first, second = white[2::2], white[3::2]
    common = 1.0 / (len(white) - 1.0)  # removal of the noise of frame 0 anticorrelates all frames
    value = float(np.sum(first * second) / np.sqrt(np.sum(first**2) * np.sum(second**2))) + common
    return min(value, MAX_CORRELATION) if value > SIGNIFICANT_DEVIATION / np.sqrt(first.size) else 0.0


def _over_field(baseline: HyperparameterGrid, whiten: Whitener, residual: Array) -> Array | None:
    """(b,) standard deviation of each block relative to the mean, a smooth function of place; None if it does not differ significantly."""
    field = np.einsum("ab,fbc->fac", whiten.factor, residual)
    power = np.log(np.mean(field**2, axis=(0, 2)))
    columns = np.linalg.qr(modes(baseline.design.observation.geometry, FIELD_ORDER).mean(axis=0))[0]
    mean = columns[:, :1] @ (columns[:, :1].T @ power)
    smooth = columns @ (columns.T @ power)
    explained, scatter = float(np.sum((smooth - mean) ** 2)), float(np.sum((power - smooth) ** 2))
    terms, spare = columns.shape[1] - 1, len(power) - columns.shape[1]
    statistic = (explained / terms) / (scatter / spare)
    return np.exp(0.5 * (smooth - mean)) if statistic > 1.0 + SIGNIFICANT_DEVIATION * np.sqrt(2.0 / terms) else None


def _inverse_factor(scale: Array, shared: float) -> Array:
    """(f, f) inverse of the lower factor of the covariance of frames of given scales, correlated within all pairs but the first."""
    covariance = np.diag(scale**2)
    if shared:
        first = np.arange(2, len(scale), 2)
        covariance[first, first + 1] = covariance[first + 1, first] = shared * scale[first] * scale[first + 1]
    factor = np.linalg.cholesky(covariance)
    return np.asarray(solve_triangular(factor, np.eye(len(scale)), lower=True, check_finite=False))
