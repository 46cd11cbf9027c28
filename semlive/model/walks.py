"""Differences of a series of coefficients across coefficients that it does not contain, as of a drift through a pause without data.

Filtered differences of one size from coefficient to coefficient are a random walk. Between the coefficients before and after a pause it has
a closed form: what it predicts after so many steps, and how it scatters about this. So the coefficients of the pause are integrated out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]
Gap = tuple[int, int]
"""Index of the first coefficient after a gap, and the number of coefficients that the gap lacks."""


def differences_across(order: int, taps: tuple[float, ...], size: int, gaps: Sequence[Gap]) -> Iterator[tuple[slice, slice, Matrix]]:
    """Rows of the filtered differences that replace those across each gap of a series.

    Args:
        order: order of the differences.
        taps: filter over neighbouring differences, newest first.
        size: number of coefficients of the series.
        gaps: the gaps, at least as far apart as the differences reach.

    Yields:
        The rows, the coefficients on which they act, and the weights; uncorrelated and as large as differences without a gap.
    """
    reach = order + len(taps) - 1
    for begin, skipped in gaps:
        count = min(reach, size - begin)
        if begin >= reach and count > 0:
            weights = _rows_across(order, taps, skipped)[:count, : reach + count]
            yield slice(begin - reach, begin - reach + count), slice(begin - reach, begin + count), weights


@lru_cache(maxsize=4096)
def _rows_across(order: int, taps: tuple[float, ...], skipped: int) -> Matrix:
    """(reach, 2 reach) weights of the coefficients before and after a gap; row k acts on the first k + 1 after it."""
    reach = order + len(taps) - 1
    moved, scatter = _steps(order, taps, skipped + reach)
    size = np.sqrt(np.diag(scatter))
    factor = size[:, None] * np.linalg.cholesky(scatter / np.outer(size, size))
    forward = np.stack([np.diff(np.eye(reach), n=k, axis=0)[0] for k in range(reach)])
    rows: Matrix = np.asarray(np.linalg.solve(factor, np.concatenate((-moved @ forward, forward), axis=1)), dtype=np.float64)
    rows[:, reach:] = np.tril(rows[:, reach:])
    rows.setflags(write=False)
    return rows


def _steps(order: int, taps: tuple[float, ...], count: int) -> tuple[Matrix, Matrix]:
    """Transition and scatter of the forward differences 0 ... reach - 1 of neighbouring coefficients over `count` steps.

    In differences the transition is triangular in blocks, with powers that are exact; in coefficients all digits would be lost.
    """
    reach = order + len(taps) - 1
    step = np.eye(reach) + np.eye(reach, k=1)
    if len(taps) == 3:  # a difference of `order` e follows t0 e[j] + t1 e[j-1] + t2 e[j-2]
        step[-1, -2:] = -(taps[0] + taps[1] + taps[2]) / taps[0], -(taps[0] + taps[1]) / taps[0]
    scatter = np.zeros((reach, reach))
    scatter[-1, -1] = taps[0] ** -2.0
    moved, total = np.eye(reach), np.zeros((reach, reach))
    while count:
        if count % 2:
            total = step @ total @ step.T + scatter
            moved = step @ moved
        scatter = step @ scatter @ step.T + scatter
        step = step @ step
        count //= 2
    return moved, total
