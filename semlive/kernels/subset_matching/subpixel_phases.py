"""Where between pixels subsets lie, as the variance of interpolated noise needs it."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from semlive.kernels.arrays import checked
from semlive.kernels.subset_matching.warp import AFFINE


@njit(nogil=True, cache=True)
def _fill(parameters, subset, phase, moved):
    for j in range(phase.shape[1]):
        for i in range(phase.shape[2]):
            for axis in range(2):
                shift = parameters[j, i, 3 * axis]
                phase[axis, j, i] = np.float32(2.0 * np.pi * (shift - np.rint(shift)))
                for along in range(2):
                    moved[along, axis, j, i] = np.float32(parameters[j, i, 3 * axis + 1 + along] * subset)


def phases(parameters: NDArray[np.float64], subset_px: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Phases of affine solutions and how far they move a subset's edge.

    Args:
        parameters: (ny, nx, 6) solutions.
        subset_px: edge of the subset.

    Returns:
        (2, ny, nx) phase of u and v, 2 pi for a pixel, and (2, 2, ny, nx) px over the subset along x and y, of u and v.

    Raises:
        ValueError: not such an array.
    """
    checked(parameters, "parameters", np.float64, (None, None, AFFINE))
    shape = parameters.shape[:2]
    phase, moved = np.empty((2, *shape), dtype=np.float32), np.empty((2, 2, *shape), dtype=np.float32)
    _fill(parameters, float(subset_px), phase, moved)
    return phase, moved
