"""Noise estimate from the residual components too rough for any effect, and smooth fields in every frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.diagnose.baseline.baseline import HyperparameterGrid, best_point, build_grid
from semlive.diagnose.baseline.design_matrix import DesignMatrix, design
from semlive.diagnose.baseline.observation import Observation
from semlive.diagnose.baseline.whitening import Whitener, make_whitener, most_likely_window, rough_cholesky, window_of_points
from semlive.kernels.linear_algebra import forward_substitution
from semlive.model.effects import RunGeometry

Array = NDArray[np.float64]
ORDER = 4  # of the polynomials that count as smooth: 15 in each frame
PASSES = 2
CLIP = 4.0


def modes(scene: RunGeometry, order: int = ORDER) -> Array:
    """(f, b, k) products of Legendre polynomials over the field, of total order up to `order`."""
    low, high = scene.address_px.min(axis=(0, 1)), scene.address_px.max(axis=(0, 1))
    at = 2.0 * (scene.address_px - low) / (high - low) - 1.0
    x, y = (np.polynomial.legendre.legvander(at[..., axis], order) for axis in (0, 1))
    return np.stack([x[..., i] * y[..., j] for i in range(order + 1) for j in range(order + 1 - i)], axis=-1)


def noise_scaled_baseline(observation: Observation, whiten: Whitener | None = None) -> HyperparameterGrid:
    """Evaluate the baseline in units of the noise; the arguments are those of `noise_scaled_design`."""
    return build_grid(noise_scaled_design(observation, whiten))


def noise_scaled_design(observation: Observation, whiten: Whitener | None = None) -> DesignMatrix:
    """Columns of the baseline in units of the noise.

    The noise is estimated from the rough part of the residual, which contains no smooth effects. The correlation length over subsets is the
    most likely one.

    Args:
        observation: observation of a run.
        whiten: correlation of the noise, if it is not to be estimated; its size is.
    """
    rough, columns = rough_modes(observation), design(observation, whiten or most_likely_whitener(observation))
    for _ in range(PASSES):
        columns = columns.rescaled(noise_scale(best_point(columns), rough).ratio)
    return columns


def most_likely_whitener(observation: Observation) -> Whitener:
    """Whitening with the most likely window of the noise, and with the size of the residual of the estimate."""
    residual, maps = observation.residual_px(), [rows.dmap for rows in observation.state.rows if rows.within_pair]
    centred, rough = residual - residual.mean(axis=0), rough_modes(observation)
    max_blocks = observation.state.settings.max_blocks
    window = most_likely_window(observation.grid, observation.valid_blocks, centred, rough, window_of_points(maps), max_blocks)
    return make_whitener(observation.grid, observation.valid_blocks, window, float(residual.std()) or 1e-6, max_blocks)


def rough_modes(observation: Observation) -> Array:
    """(b, k) orthonormal columns orthogonal to all smooth fields; one set serves all frames because their points nearly coincide."""
    shapes = modes(observation.geometry).mean(axis=0)
    return np.linalg.qr(shapes, mode="complete")[0][:, shapes.shape[1] :]


@dataclass(frozen=True, slots=True)
class NoiseScale:
    """Size of the noise from the rough part of a residual.

    Attributes:
        ratio: root mean square relative to that of unit noise.
        freedom: number of independent values in this estimate.
    """

    ratio: float
    freedom: float


def noise_scale(baseline: HyperparameterGrid, rough: Array) -> NoiseScale:
    """Size of the noise of the rough part (b, k) of the residual of a baseline."""
    columns, residual = baseline.design, baseline.residual()
    f, b, _ = residual.shape
    to_rough = forward_substitution(rough_cholesky(columns.whiten.factor, rough), rough.T @ columns.whiten.factor)
    residuals = to_rough @ residual
    explained = 0.0
    for axis in (0, 1):
        own = (to_rough @ columns.columns[axis].reshape(f, b, -1)).reshape(f * len(to_rough), -1)
        inside = np.zeros((columns.size, own.shape[1]))
        inside[columns.index[axis]] = own.T @ own
        explained += float(np.trace(baseline.best.solve(inside)[columns.index[axis]]))
    freedom = max(2.0 * len(to_rough) * (f - 1) - explained, 1.0)
    limit = CLIP * 1.4826 * float(np.median(np.abs(residuals)))
    return NoiseScale(float(np.sqrt(np.sum(np.clip(residuals, -limit, limit) ** 2) / freedom)), freedom)
