"""Backward pass: posterior of the border, then of each pair given the border, with uncertainty.

The cost is linear in the number of pairs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, get_blas_funcs, solve_triangular

from semlive.estimate.joint.elimination.arrowhead import cholesky, regularise
from semlive.estimate.joint.elimination.elimination import EliminationChain, EliminationStep, eliminate_last
from semlive.estimate.joint.elimination.shared_parameters import DISTORTION, KINDS, Codes, Matrix, Vector, parameter_indices, shared_prior
from semlive.estimate.joint.observations.priors import Hyperparameters

LIVE_WINDOW_PAIRS = 32  # pairs that are smoothed with every further one: 3 ms each with their covariances
TOGETHER = 64  # steps whose responses are multiplied at once: 1.9 ms per pair in all where 16 take 2.1


@dataclass(frozen=True, slots=True, eq=False)
class SharedPosterior:
    """Posterior of the border given all pairs of a chain.

    Attributes:
        chain: the elimination.
        last: the step that eliminates the remaining front.
        factor: (b, b) lower Cholesky factor of the posterior precision of the border.
        step: (b,) posterior mean of the border relative to the `linearisation_point` of the chain.
    """

    chain: EliminationChain
    last: EliminationStep
    factor: Matrix
    step: Vector

    def backward_pass(self) -> Iterator[EliminationStep]:
        """From the last one to the first of the chain."""
        yield self.last
        yield from reversed(self.chain.steps)

    def covariance_of(self, rows: Matrix) -> Matrix:
        """(k, k) covariance of k linear functions (k, n) of the joint parameters; steps before the first that they touch are left out."""
        layout, border = self.chain.state.layout, self.chain.border
        residual, total = rows.copy(), np.zeros((len(rows),) * 2)
        held = np.zeros((len(rows), border.size))
        held[:, : border.joint_size] = rows[:, parameter_indices(layout, border.codes()[: border.joint_size])]
        for step in self._since(rows):
            here = residual[:, parameter_indices(layout, step.eliminated)]
            if here.any():
                ahead = solve_triangular(step.factor, here.T, lower=True, check_finite=False)
                total += ahead.T @ ahead
                residual[:, parameter_indices(layout, step.remaining)] -= ahead.T @ step.front_coupling
                held -= ahead.T @ step.to_border
        ahead = solve_triangular(self.factor, held.T, lower=True, check_finite=False)
        return total + ahead.T @ ahead

    def _since(self, rows: Matrix) -> Iterator[EliminationStep]:
        """The steps from the first that touches linear functions on: what came before does not cost a look each."""
        layout, border, found = self.chain.state.layout, self.chain.border, list[EliminationStep]()
        touched = np.asarray(np.any(rows, axis=0), dtype=np.bool_)
        touched[parameter_indices(layout, border.codes()[: border.joint_size])] = False
        count = int(touched.sum())
        for step in self.backward_pass() if count else ():
            found.append(step)
            count -= int(touched[parameter_indices(layout, step.eliminated)].sum())
            if not count:
                break
        return reversed(found)


def solve_shared(chain: EliminationChain, belief: Hyperparameters | None = None) -> SharedPosterior:
    """Compute the posterior of the border.

    Args:
        chain: the elimination of all pairs.
        belief: prior of the border; None uses the prior given by the hyperparameters of the chain.
    """
    last, precision, pull = eliminate_last(chain)
    believed = shared_prior(chain.state, belief or chain.hyper, chain.border)
    border_codes = chain.border.codes()[: chain.border.joint_size]
    about = chain.linearisation_point[parameter_indices(chain.state.layout, border_codes)]
    pull[: len(border_codes)] -= believed[: len(border_codes), : len(border_codes)] @ about
    precision += believed
    factor = cholesky(regularise(precision))
    return SharedPosterior(chain, last, factor, cho_solve((factor, True), pull, check_finite=False))


def mean_of(ending: SharedPosterior, newest: int | None = None) -> Vector:
    """(n,) posterior mean of the joint parameters.

    Args:
        ending: posterior of the border.
        newest: number of newest pairs to update; None updates all. Older parameters stay at the `linearisation_point` of the chain, so the
            cost does not grow with the run.
    """
    layout, border = ending.chain.state.layout, ending.chain.border
    move = np.zeros(layout.size)
    border_codes = border.codes()[: border.joint_size]
    move[parameter_indices(layout, border_codes)] = ending.step[: border.joint_size]
    remaining = newest or 0
    for step in ending.backward_pass():
        gradient = step.pull - step.front_coupling @ move[parameter_indices(layout, step.remaining)] - step.to_border @ ending.step
        move[parameter_indices(layout, step.eliminated)] = solve_triangular(step.factor, gradient, lower=True, trans=1, check_finite=False)
        remaining -= step.pair is not None
        if newest and not remaining:
            break
    return ending.chain.linearisation_point + move


@dataclass(frozen=True, slots=True, eq=False)
class PairCovariance:
    """Posterior covariance of the parameters of one pair, of the knots of its neighbours, and of the knots of frame 0.

    Attributes:
        pair: number of the pair.
        index: (m,) sorted joint indices.
        covariance: (m, m) covariance.
    """

    pair: int
    index: NDArray[np.int64]
    covariance: Matrix

    def of(self, index: NDArray[np.int64]) -> Matrix:
        """Covariance of some of them."""
        at = np.searchsorted(self.index, index)
        return self.covariance[np.ix_(at, at)]


def distortion_covariance(ending: SharedPosterior) -> Matrix:
    """(d, d) covariance of the distortion parameters."""
    own = np.zeros((len(ending.factor), ending.chain.border.counts[DISTORTION]))
    np.fill_diagonal(own, 1.0)
    half = solve_triangular(ending.factor, own, lower=True, check_finite=False)
    return half.T @ half


@dataclass(frozen=True, slots=True, eq=False)
class _Back:
    """Result of one step of the backward pass, conditional on the border.

    Attributes:
        step: the elimination step.
        codes: sorted codes of its front.
        order: permutation that sorts the eliminated and remaining codes.
        remaining_at: positions of the remaining codes in the front of the previous step of the pass.
        given: (front, m) factor of the covariance of the front given the border: product with its transpose.
        response: (front, b) response of the front to the border.
        answer: (gone, b) the rows of the response of the eliminated parameters.
    """

    step: EliminationStep
    codes: Codes
    order: NDArray[np.int64]
    remaining_at: NDArray[np.int64]
    given: Matrix
    response: Matrix
    answer: Matrix


def covariances(ending: SharedPosterior, rows: Mapping[int, tuple[Codes, Matrix]]) -> dict[int, Matrix]:
    """(k, k) covariance, for each pair, of k linear functions of its parameters, in one backward pass.

    Args:
        ending: posterior of the border.
        rows: for each pair, codes (m,) of parameters of the pair or of the border, and functions (k, m) of them.

    Raises:
        KeyError: the chain does not contain a pair.
    """
    border, found = ending.chain.border, {}
    for step in _way_back(ending):
        if step.step.pair is None or step.step.pair not in rows:
            continue
        codes, own = rows[step.step.pair]
        place = border.place(codes)
        inside = place < 0
        of_front, of_border = np.zeros((len(own), len(step.codes))), np.zeros((len(own), border.size))
        of_front[:, np.searchsorted(step.codes, codes[inside])] = own[:, inside]
        of_border[:, place[~inside]] = own[:, ~inside]
        alone = of_front @ step.given
        shared = solve_triangular(ending.factor, (of_border + of_front @ step.response).T, lower=True, check_finite=False)
        found[step.step.pair] = alone @ alone.T + shared.T @ shared
        if len(found) == len(rows):
            break
    return {pair: found[pair] for pair in rows}


def pair_covariances(ending: SharedPosterior, newest: int | None = None) -> Iterator[PairCovariance]:
    """Covariances of every pair, or of the `newest` pairs; the newest first.

    Given the border, covariances propagate from step to step as in a Rauch-Tung-Striebel smoother. The uncertainty of the border adds its
    posterior covariance multiplied by the response of each parameter.
    """
    layout, border = ending.chain.state.layout, ending.chain.border
    knots = np.concatenate([np.arange(border.size)[border.part(kind)] for kind in range(DISTORTION + 1, KINDS.index("axes"))])
    (trsm,), factor = get_blas_funcs(("trsm",), (ending.factor,)), np.asfortranarray(ending.factor)
    knot_codes, through_knots = border.codes()[knots], trsm(1.0, factor, np.eye(border.size)[:, knots], lower=1).T
    through = np.zeros((0, border.size))
    way, remaining = _way_back(ending), newest or 0
    while together := list(islice(way, min(TOGETHER, newest + 1) if newest else TOGETHER)):
        solved = trsm(1.0, factor, np.concatenate([group.answer for group in together]).T, lower=1, overwrite_b=1).T
        row = 0
        for group in together:
            stop = row + len(group.step.eliminated)
            through = np.concatenate((solved[row:stop], through[group.remaining_at]))[group.order]
            row = stop
            if group.step.pair is None:
                continue
            all_through = np.concatenate((through, through_knots))
            total = all_through @ all_through.T
            total[: len(group.codes), : len(group.codes)] += group.given @ group.given.T
            index = parameter_indices(layout, np.concatenate((group.codes, knot_codes)))
            sort = np.argsort(index)
            yield PairCovariance(group.step.pair, index[sort], total[np.ix_(sort, sort)])
            remaining -= 1
            if newest and not remaining:
                return


def _way_back(ending: SharedPosterior) -> Iterator[_Back]:
    """Iterate from the last step to the first with covariances as factors.

    With a stiff drift, the gains amplify rounding errors by up to 1e10: variances of 2e-5 px^2 were computed as -5e-5 and -59. With
    factors, the square of the rounding error is amplified.
    """
    codes, given = np.zeros(0, dtype=np.int64), np.zeros((0, 0))
    response = np.zeros((0, ending.chain.border.size))
    for step in ending.backward_pass():
        at = np.searchsorted(codes, step.remaining)
        given, response = _narrowed(given[at]), response[at]
        alone = np.asarray(solve_triangular(step.factor, np.eye(len(step.eliminated)), lower=True, check_finite=False), dtype=np.float64).T
        gain, answer = alone @ step.front_coupling, -(alone @ (step.to_border + step.front_coupling @ response))
        both = np.concatenate((step.eliminated, step.remaining))
        order = np.argsort(both)
        codes = both[order]
        front = np.zeros((len(both), alone.shape[1] + given.shape[1]))
        front[: len(alone), : alone.shape[1]] = alone
        front[: len(alone), alone.shape[1] :] = -gain @ given
        front[len(alone) :, alone.shape[1] :] = given
        given = front[order]
        response = np.concatenate((answer, response))[order]
        yield _Back(step, codes, order, at, given, response, answer)


def _narrowed(factor: Matrix) -> Matrix:
    """A factor with at most n columns of the same covariance, from a factor (n, m)."""
    return factor if factor.shape[1] <= len(factor) else np.asarray(np.linalg.qr(factor.T, mode="r"), dtype=np.float64).T
