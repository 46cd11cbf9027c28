"""Clusters of neighbouring points of a map with agreeing motions."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from semlive.kernels.arrays import checked

SIGMAS = 3.0


@njit(nogil=True, cache=True)
def _root(parent, k):
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@njit(nogil=True, cache=True)
def _gap(here, there, slope_here, slope_there, half):
    """Difference of two neighbours after subtraction of both slopes."""
    return abs(there - here - np.float64(half * (slope_here + slope_there)))


@njit(nogil=True, cache=True)
def _group(u, v, gradient, sigma, candidates, half, max_difference, parent, size):
    ny, nx = candidates.shape
    for j in range(ny):
        for i in range(nx):
            k = j * nx + i
            parent[k] = k
            if not candidates[j, i]:
                continue
            for axis in range(2):
                a, b = (j, i - 1) if axis == 0 else (j - 1, i)
                if a < 0 or b < 0 or not candidates[a, b]:
                    continue
                limit = max_difference + SIGMAS * sigma[a, b]
                along_u = _gap(u[a, b], u[j, i], gradient[a, b, axis], gradient[j, i, axis], half)
                along_v = _gap(v[a, b], v[j, i], gradient[a, b, 2 + axis], gradient[j, i, 2 + axis], half)
                if along_u <= limit and along_v <= limit:
                    one, other = _root(parent, a * nx + b), _root(parent, k)
                    parent[max(one, other)] = min(one, other)
    for j in range(ny):
        for i in range(nx):
            if candidates[j, i]:
                root = _root(parent, j * nx + i)
                parent[j * nx + i] = root
                size[root // nx, root % nx] += 1
    for j in range(ny):
        for i in range(nx):
            if candidates[j, i]:
                root = parent[j * nx + i]
                size[j, i] = size[root // nx, root % nx]


def cluster_sizes(
    u_px: NDArray[np.float64],
    v_px: NDArray[np.float64],
    gradient: NDArray[np.float32],
    sigma_px: NDArray[np.float64],
    candidates: NDArray[np.bool_],
    half_step_px: float,
    max_difference_px: float,
) -> NDArray[np.int32]:
    """Return (ny, nx) number of points in the cluster of each point, itself included; 0 where not `candidates`.

    Neighbours along x or y belong to one cluster if u and v, after subtraction of the slopes, differ by no more than `max_difference_px`
    plus
    SIGMAS standard uncertainties.

    Args:
        u_px: (ny, nx) displacement along x.
        v_px: (ny, nx) displacement along y.
        gradient: (ny, nx, 4) du/dx, du/dy, dv/dx, dv/dy.
        sigma_px: (ny, nx) standard uncertainty.
        candidates: (ny, nx) points that count.
        half_step_px: half the distance of neighbours.
        max_difference_px: largest accepted difference.

    Raises:
        ValueError: arrays of wrong dtype, shape or layout.
    """
    shape = candidates.shape
    checked(candidates, "candidates", np.bool_, (None, None))
    for array, name in ((u_px, "u_px"), (v_px, "v_px"), (sigma_px, "sigma_px")):
        checked(array, name, np.float64, shape)
    checked(gradient, "gradient", np.float32, (*shape, 4))
    size = np.zeros(shape, dtype=np.int32)
    parent = np.empty(candidates.size, dtype=np.int64)
    _group(u_px, v_px, gradient, sigma_px, candidates, np.float32(half_step_px), max_difference_px, parent, size)
    return size
