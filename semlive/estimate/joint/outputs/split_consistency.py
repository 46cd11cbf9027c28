"""Consistency checks of a long run at bounded cost, from a few dozen pairs.

One matrix of all parameters would be too large. The drift from the halves of the field is compared conditional on the shared parameters,
which all pairs determine. The distortion from odd and even pairs is compared after eliminating all other parameters pair by pair.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, cho_solve, cho_solve_banded, cholesky_banded

from semlive.estimate.joint.elimination.elimination import eliminate_all
from semlive.estimate.joint.elimination.shared_parameters import DISTORTION, DRIFT, NOISE, SHIFT, shared_prior
from semlive.estimate.joint.elimination.smoother import solve_shared
from semlive.estimate.joint.observations.state import EstimatorState, rows_of
from semlive.estimate.joint.selection.long_run import BandedSystem, banded_system, split_at_pauses, with_prior
from semlive.estimate.joint.solution.posterior import Solution
from semlive.estimate.joint.solution.subset import subset_state

Field = NDArray[np.float64]
BEYOND = 4  # pairs on either side that are solved for with some that are compared, 96 parameters: the drift forgets within some ten knots


def field_half_difference(solution: Solution, pairs: tuple[int, ...]) -> tuple[Field, Field]:
    """Difference (k,) of the drift within frames from the left and the right half of the field, and its covariance (k, k).

    Both halves use the same shared parameters and the same drift prior, which cannot cause a difference. Pairs too far apart for
    their drift to
    be correlated are solved separately, so the cost depends on the number of pairs and not on the length of the run.
    """
    found = [_drift_of_halves(solution, some, around) for some, around in _neighbours(solution.state, pairs)]
    return np.concatenate([value for value, _ in found]), np.asarray(block_diag(*(value for _, value in found)), dtype=np.float64)


def _neighbours(state: EstimatorState, pairs: tuple[int, ...]) -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
    """Pairs with less than twice `BEYOND` others between them, together; with each lot, in order of time, all that it is solved with.

    Neither goes beyond a pause. Of pair 0 nothing is compared.
    """
    found = []
    for every in split_at_pauses(state, tuple(dict.fromkeys(when.frame // 2 for when in state.frames))):
        at = [place for place, pair in enumerate(every) if pair in pairs and pair]
        cuts = [number for number in range(1, len(at)) if at[number] - at[number - 1] > 2 * BEYOND]
        lots = [at[begin:end] for begin, end in zip((0, *cuts), (*cuts, len(at)), strict=True) if begin < end]
        found += [(tuple(every[value] for value in group), every[max(group[0] - BEYOND, 0) : group[-1] + BEYOND + 1]) for group in lots]
    return found


def _drift_of_halves(solution: Solution, pairs: tuple[int, ...], around: tuple[int, ...]) -> tuple[Field, Field]:
    state, columns = solution.state, solution.state.blocks.layout[1]
    first_half = ((np.arange(state.blocks.size) % columns) < columns // 2)[:, None]
    rows = rows_of(state, pairs)
    halves = [
        tuple(replace(map_rows, weight=np.where(side, map_rows.weight, 0.0)) for map_rows in rows) for side in (first_half, ~first_half)
    ]
    noise_px = solution.shared_posterior.step[solution.shared_posterior.chain.border.part(NOISE)]
    bands = [banded_system(replace(state, rows=half), solution.hyper, solution.mean, noise_px, around) for half in (*halves, ())]
    gradient = _within_frames(bands[0], pairs)
    steps, spreads = [], []
    for band in bands[:2]:
        precision, pull, _ = with_prior(band, solution.hyper)
        factor = (cholesky_banded(precision, lower=True, check_finite=False), True)
        spreads.append(cho_solve_banded(factor, gradient.T, check_finite=False))
        steps.append(cho_solve_banded(factor, pull, check_finite=False))
    cross = spreads[0].T @ _times(with_prior(bands[2], solution.hyper)[0], spreads[1])
    return gradient @ (steps[0] - steps[1]), gradient @ (spreads[0] + spreads[1]) - cross - cross.T


def odd_even_difference(solution: Solution, pairs: tuple[int, ...], rows: Field) -> tuple[Field, Field]:
    """Difference (k,) of linear functions (k, d) of the distortion from odd and from even pairs, and its covariance (k, k).

    The halves share the prior of the border. Their drift priors are treated as independent, because each half determines the drift of its
    own pairs. This makes the covariance slightly too large.
    """

    def of(parity: int) -> tuple[Field, Field, Field]:
        half, near = subset_state(solution, tuple(pair for pair in pairs if pair and pair % 2 == parity))
        ending = solve_shared(eliminate_all(half, solution.hyper, near))
        gradient = np.zeros((len(rows), len(ending.step)))
        gradient[:, ending.chain.border.part(DISTORTION)] = rows
        return gradient, gradient @ ending.step, np.asarray(cho_solve((ending.factor, True), gradient.T, check_finite=False))

    (gradient, odd, first_spread), (_, even, second_spread) = of(1), of(0)
    border = solution.shared_posterior.chain.border
    cross = first_spread.T @ shared_prior(solution.state, solution.hyper, border) @ second_spread
    return odd - even, gradient @ (first_spread + second_spread) - cross - cross.T


def _within_frames(band: BandedSystem, pairs: tuple[int, ...]) -> Field:
    """Change of the drift from the middle of every frame of some pairs to its ends, as functions of a band's parameters."""
    drift = band.state.drift
    assert drift is not None  # a solution has data
    frames = [when for when in band.state.frames if when.frame // 2 in pairs and when.frame // 2]
    at = {fraction: [when.start_s + fraction * when.timing.duration_s for when in frames] for fraction in (0.0, 0.5, 1.0)}
    index, value = drift.spline.local(at[0.5])
    rows, places = [], []
    for end in (0.0, 1.0):
        there = drift.spline.local(at[end])
        for axis in (0, 1):
            knots = np.concatenate((there[0], index), axis=1)
            places.append(band.place((DRIFT << SHIFT) | (2 * knots + axis).astype(np.int64)))
            rows.append(np.concatenate((there[1], -value), axis=1))
    place, row = np.concatenate(places), np.concatenate(rows)
    stop = len(band.codes)
    dense = np.zeros((len(row), stop + 1))  # the last column takes what is in the border
    np.add.at(dense, (np.arange(len(row))[:, None], np.where(place < 0, stop, place)), row)
    return dense[:, :stop]


def _times(band: Field, columns: Field) -> Field:
    """Product of a symmetric matrix, given by its lower band, and columns."""
    total, size = band[0][:, None] * columns, len(columns)
    for lag in range(1, len(band)):
        own = band[lag, : size - lag][:, None]
        total[lag:] += own * columns[: size - lag]
        total[: size - lag] += own * columns[lag:]
    return total
