"""Robust affine fit of the motion of blocks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semlive.kernels.order_statistics import median_of

BLOCK_DISTANCE_PX = 100  # about one block per this distance; distortion fields are smoother
CONVERGED_PX = 1e-3  # largest change in the last iteration; sufficient for an initial guess
OUTLIER_PX = 4.0  # distortion causes residuals of 2 px in the affine fit
MIN_INLIERS = 6  # blocks that agree on an affine map of six unknowns


def design_matrix(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3) design matrix of an affine function of x and y."""
    return np.column_stack([np.ones_like(x), x, y])


def robust_affine(
    x: NDArray[np.float64], y: NDArray[np.float64], motion: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return (3, 2) affine coefficients by reweighted least squares (Cauchy weights), and (n,) whether a match agrees with them."""
    affine = np.zeros((3, 2))
    affine[0] = [median_of(motion[:, axis]) for axis in range(2)]
    design = design_matrix(x, y)
    for _ in range(10 if _determined(x, y) else 0):
        root = 1.0 / np.sqrt(1.0 + (_length(motion - design @ affine) / OUTLIER_PX) ** 2)
        before = affine
        affine = np.asarray(np.linalg.lstsq(design * root[:, None], motion * root[:, None], rcond=None)[0], dtype=np.float64)
        if np.abs(design @ (affine - before)).max() < CONVERGED_PX:
            break
    return affine, _length(motion - design @ affine) <= OUTLIER_PX


def _determined(x: NDArray[np.float64], y: NDArray[np.float64]) -> bool:
    """Whether positions determine an affine map: enough, far enough apart, and not on one line."""
    if len(x) < 6 or max(x.max() - x.min(), y.max() - y.min()) <= BLOCK_DISTANCE_PX:
        return False
    dx, dy = x - x.mean(), y - y.mean()
    xx, xy, yy = float(dx @ dx), float(dx @ dy), float(dy @ dy)
    across = 0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy)  # sum of squared distances from the line through them
    return bool(across > 1.0)


def _length(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lengths (n,) of (n, 2) vectors."""
    return np.sqrt(vectors[:, 0] ** 2 + vectors[:, 1] ** 2)
