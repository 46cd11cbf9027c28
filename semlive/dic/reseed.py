"""Initial guesses of failed points from converged neighbours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semlive.kernels.subset_matching import interface

MIN_DISCREPANCY_PX = 1.0  # guesses that differ by more belong to different motions


def neighbour_seeds(
    solutions: interface.Solutions, fresh: NDArray[np.bool_], step_px: int
) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.float64], NDArray[np.bool_]]:
    """Extrapolate initial guesses with their gradients from the eight neighbours.

    At a crack the neighbour with the largest ZNCC may lie on the other side. Therefore the best neighbour with a different motion
    gives a second guess.

    Args:
        solutions: results so far.
        fresh: (ny, nx) points to extrapolate from.
        step_px: distance of the points.

    Returns:
        Guess (ny, nx, n) of the best neighbour and (ny, nx) whether it exists; guess of the best neighbour with a different motion
        and whether it exists.
    """
    values = _extrapolated(solutions, fresh, step_px)
    first, score = _best(values)
    second, second_score = _best([(p, np.where(seed_distance(p, first) > MIN_DISCREPANCY_PX, z, 0.0)) for p, z in values])
    return first, score > 0.0, second, second_score > 0.0


def _extrapolated(
    solutions: interface.Solutions, fresh: NDArray[np.bool_], step_px: int
) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Guess and ZNCC from each of the eight neighbours, zero without neighbour."""
    ny, nx = fresh.shape
    score = np.where(fresh, solutions.zncc, 0.0)
    values = []
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            if dx == dy == 0:
                continue
            to = (slice(max(-dy, 0), ny - max(dy, 0)), slice(max(-dx, 0), nx - max(dx, 0)))
            source = (slice(max(dy, 0), ny - max(-dy, 0)), slice(max(dx, 0), nx - max(-dx, 0)))
            guess, filled = np.zeros_like(solutions.parameters), np.zeros((ny, nx))
            p = solutions.parameters[source].copy()
            p[..., 0] -= step_px * (dx * p[..., 1] + dy * p[..., 2])
            p[..., 3] -= step_px * (dx * p[..., 4] + dy * p[..., 5])
            guess[to], filled[to] = p, score[source]
            values.append((guess, filled))
    return values


def _best(values: list[tuple[NDArray[np.float64], NDArray[np.float64]]]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    best, score = np.zeros_like(values[0][0]), np.zeros_like(values[0][1])
    for guess, zncc in values:
        better = zncc > score
        best[better] = guess[better]
        score[better] = zncc[better]
    return best, score


def seed_distance(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance between the displacements of two guesses, px."""
    return np.hypot(a[..., 0] - b[..., 0], a[..., 3] - b[..., 3])
