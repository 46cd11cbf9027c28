"""First guesses for points that failed, from neighbours that did not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semlive.kernels import interface

OTHER_SIDE_PX = 1.0  # two guesses further apart than this are two motions


def neighbour_seeds(
    solutions: interface.Solutions, fresh: NDArray[np.bool_], step_px: int
) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.float64], NDArray[np.bool_]]:
    """First guesses extrapolated with their gradients from the eight neighbours.

    Beside a crack the neighbour that correlates best may be on the other side; then the best of those that disagree with it is
    worth a second try.

    Args:
        solutions: what is known.
        fresh: (ny, nx) points to extrapolate from.
        step_px: distance of the points.

    Returns:
        The guess of the best neighbour (ny, nx, n), where there is one, that of the best neighbour that contradicts it, and
        where there is one.
    """
    values = _extrapolated(solutions, fresh, step_px)
    first, score = _best(values)
    second, second_score = _best([(p, np.where(seed_distance(p, first) > OTHER_SIDE_PX, z, 0.0)) for p, z in values])
    return first, score > 0.0, second, second_score > 0.0


def _extrapolated(
    solutions: interface.Solutions, fresh: NDArray[np.bool_], step_px: int
) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """For each of the eight neighbours its guess and its ZNCC, zero where there is none."""
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
    """Distance of two guesses' displacements."""
    return np.hypot(a[..., 0] - b[..., 0], a[..., 3] - b[..., 3])
