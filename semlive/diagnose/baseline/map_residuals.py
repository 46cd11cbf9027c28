"""Displacement by a baseline: in the blocks, and at all points of a map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.observation import Observation

Array = NDArray[np.float64]
ESTIMATE_ORDER, EXTRAPOLATED = 5, 1.15  # polynomial of the estimate; half a block lies beyond the centres of the outer ones


def over_grid_px(observation: Observation, position_px: Array, estimate_px: Array) -> Array:
    """(2, n, m) values (b, 2) at positions (b, 2) relative to the centre of the frame, px, as a polynomial over the grid."""
    position = position_px + observation.state.centre_px
    low, size = position.min(axis=0), np.ptp(position, axis=0)
    x, y = 2.0 * (position - low).T / size[:, None] - 1.0
    mesh_x, mesh_y = (2.0 * (one - start) / length - 1.0 for one, start, length in zip(observation.grid.mesh(), low, size, strict=True))
    order = (min(ESTIMATE_ORDER, int(np.sqrt(0.5 * len(estimate_px)))),) * 2
    fitted = np.linalg.lstsq(np.polynomial.legendre.legvander2d(x, y, order), estimate_px, rcond=1e-6)[0]
    inside = (np.clip(mesh_x, -EXTRAPOLATED, EXTRAPOLATED), np.clip(mesh_y, -EXTRAPOLATED, EXTRAPOLATED))
    return np.moveaxis(np.polynomial.legendre.legvander2d(*inside, order) @ fitted, -1, 0)


def fitted_px(baseline: HyperparameterGrid) -> Array:
    """(f, b, 2) displacement in the blocks by the most likely baseline and its effects, up to a displacement equal in all frames, px."""
    whiten, white = baseline.design.whiten, baseline.residual()
    if whiten.over_frames is not None:
        white = np.stack([np.linalg.solve(inverse, white[:, :, axis]) for axis, inverse in enumerate(whiten.over_frames)], axis=2)
    residual_px = whiten.sigma_px * np.matmul(whiten.factor, white)
    return np.asarray(baseline.design.observation.disparity_px - residual_px)
