"""A solution restricted to some of its pairs: the state as if only these had been taken."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from semlive.estimate.joint.observations.normal_equations import without_normal_matrix
from semlive.estimate.joint.observations.state import EstimatorState, rows_of
from semlive.estimate.joint.solution.posterior import Solution
from semlive.model import PairMotions

Field = NDArray[np.float64]
MAX_PAIR_COUPLES = 16  # of neighbouring pairs


def sampled_pair_numbers(state: EstimatorState, since: int) -> tuple[int, ...]:
    """Numbers of at most `2 MAX_PAIR_COUPLES` pairs, in couples of neighbours evenly over those that came after the first `since`."""
    every = (0, *state.motions.pairs)
    late = every[max(min(since, len(every) - 2 * MAX_PAIR_COUPLES), 0) :]
    first = np.unique(np.linspace(0, len(late) // 2 - 1, MAX_PAIR_COUPLES).astype(int))
    return tuple(late[2 * one + member] for one in first for member in (0, 1))


def subset_state(solution: Solution, pairs: tuple[int, ...]) -> tuple[EstimatorState, Field]:
    """The state as if it had seen some pairs alone, linearised where it is, and the parameters of the solution in its layout."""
    state = solution.state
    motion, held = state.layout.part("motion"), [(pair, *state.motions.part(pair)) for pair in state.motions.pairs if pair in pairs]
    index = np.concatenate([np.arange(motion.start), *(motion.start + np.arange(one.start, one.stop) for _, one, _ in held)])
    phase = dict(zip((0, *state.motions.pairs), state.phases, strict=True))
    alone = replace(
        without_normal_matrix(state),
        motions=PairMotions(tuple(pair for pair, _, _ in held), tuple(kind for _, _, kind in held)),
        frames=tuple(when for when in state.frames if when.frame // 2 in (0, *pairs)),
        phases=(phase[0], *(phase[pair] for pair, _, _ in held)),
        rows=tuple(rows_of(state, pairs)),
        linearisation_point=state.linearisation_point[index],
    )
    return alone, solution.mean[index]
