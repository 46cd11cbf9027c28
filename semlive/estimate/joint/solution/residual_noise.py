"""Residuals of the block means, and the noise scale that follows from them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semlive.estimate.joint.elimination.arrowhead import ArrowheadFactor
from semlive.estimate.joint.observations.block_means import Blocks
from semlive.estimate.joint.observations.design_columns import predicted
from semlive.estimate.joint.observations.priors import Hyperparameters
from semlive.estimate.joint.observations.state import EstimatorState

MAX_DEVIATION_SIGMAS = 4.0
"""Normalised residuals are clipped at this multiple of their robust standard deviation."""
MIN_BLOCK_NOISE_PX = 3e-4
"""Smallest noise of the mean of a block while hyperparameters are selected.

The model lacks the products of its own terms (a rotation of 5e-4 rad times 1 px of distortion). With 1e-5 px of noise that misfit became
rough drift: 0.1 px of displacement and 1.7e-3 of strain.
"""
MIN_FINAL_BLOCK_NOISE_PX = 1e-6
"""Smallest noise of the mean of a block in the last fit: a strain error of 1e-6 at the edges of the field becomes 1.5e-7."""


def residuals(state: EstimatorState, mean: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """(blocks, 2) residual of the block means of each map with weight, px. Maps from frame 0 are corrected for the noise of frame 0."""
    noise_px = state.reference.mean_px(mean)
    used_rows = [rows for rows in state.rows if rows.weight.any()]
    return [rows.disparity_px - predicted(state, rows, mean) + (noise_px if rows.from_reference else 0.0) for rows in used_rows]


def estimated_noise(
    state: EstimatorState,
    precision: NDArray[np.float64],
    hyper: Hyperparameters,
    mean: NDArray[np.float64],
    factor: ArrowheadFactor,
    min_noise_px: float = MIN_BLOCK_NOISE_PX,
) -> tuple[float, float]:
    """Noise scale from clipped normalised residuals, and the noise of one POI, px.

    Block means scatter by a part of their assigned variance (see `block_scatter`). Each determined parameter reduces the sum by one
    assigned variance. The noise of frame 0 counts as a residual against its prior.
    """
    blocks, noise = state.blocks, state.reference
    z, variance, fields = [(noise.mean_px(mean) * np.sqrt(noise.prior))[noise.prior > 0]], [], []
    used_rows = [rows for rows in state.rows if rows.weight.any()]
    for rows, residual in zip(used_rows, residuals(state, mean), strict=True):
        used = rows.weight > 0
        fields.append(residual * np.sqrt(rows.weight))
        z.append(fields[-1][used])
        variance.append(2 / rows.noisy_frames / rows.weight[used])
    joined = np.concatenate(z)
    spread = 1.4826 * float(np.median(np.abs(joined)))
    clipped = np.clip(joined, -MAX_DEVIATION_SIGMAS * spread, MAX_DEVIATION_SIGMAS * spread)
    expected = block_scatter(blocks, fields, MAX_DEVIATION_SIGMAS * spread) * float(len(joined) - len(z[0]))
    determined = factor.trace_of_inverse_with(precision) * hyper.noise_scale**-2.0
    freedom = max(expected - determined, 0.1 * expected, 1.0)
    mean_variance = float(np.mean(np.concatenate(variance)))
    scale = max(float(np.sqrt(np.sum(clipped**2) / freedom)), min_noise_px / np.sqrt(mean_variance))
    poi_px = float(np.sqrt(mean_variance / blocks.variance(blocks.full_count).mean()))
    return scale, scale * poi_px


def block_scatter(blocks: Blocks, fields: list[NDArray[np.float64]], limit: float) -> float:
    """Variance of block means relative to their assigned variance, estimated from residuals.

    The result lies between 1 for independent blocks (white noise of single POI) and the value for overlapping subsets. If neighbours are
    correlated by r along x and y, slow fields have ``(1 + 2 r_x) (1 + 2 r_y)`` times the variance of independent blocks.
    Assuming full overlap
    made the standard deviations of white noise too large by a factor of 1.46.
    """
    if not fields:
        return 1.0
    clipped = np.clip(np.stack(fields), -limit, limit).reshape(len(fields), *blocks.layout, 2)
    along_x, along_y = clipped[:, :, 1:] * clipped[:, :, :-1], clipped[:, 1:] * clipped[:, :-1]
    inflation = 1.0
    for product, pair in (
        (along_x, (clipped[:, :, 1:] != 0) & (clipped[:, :, :-1] != 0)),
        (along_y, (clipped[:, 1:] != 0) & (clipped[:, :-1] != 0)),
    ):
        power = float(np.mean(clipped[clipped != 0] ** 2)) if clipped.any() else 1.0
        inflation *= 1.0 + 2.0 * max(float(product.sum()) / max(int(pair.sum()), 1) / power, 0.0)
    return float(np.clip(1.0 / inflation, blocks.block_variance_ratio, 1.0))
