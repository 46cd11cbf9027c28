"""Back along the chain: the border's posterior, then every pair's given it, with uncertainty; linear in pairs."""

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
    """The border's posterior, given all pairs of a chain.

    Attributes:
        chain: what was eliminated.
        last: the step that eliminates what the chain had left.
        factor: (b, b) lower Cholesky factor of the border's posterior precision.
        step: (b,) the border's posterior mean, from the chain's `linearisation_point`.
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
        held[:, : border.known] = rows[:, parameter_indices(layout, border.codes()[: border.known])]
        for step in self._since(rows):
            here = residual[:, parameter_indices(layout, step.eliminated)]
            if here.any():
                ahead = solve_triangular(step.factor, here.T, lower=True, check_finite=False)
                total += ahead.T @ ahead
                residual[:, parameter_indices(layout, step.kept)] -= ahead.T @ step.front_coupling
                held -= ahead.T @ step.to_border
        ahead = solve_triangular(self.factor, held.T, lower=True, check_finite=False)
        return total + ahead.T @ ahead

    def _since(self, rows: Matrix) -> Iterator[EliminationStep]:
        """The steps from the first that touches linear functions on: what came before does not cost a look each."""
        layout, border, found = self.chain.state.layout, self.chain.border, list[EliminationStep]()
        touched = np.asarray(np.any(rows, axis=0), dtype=np.bool_)
        touched[parameter_indices(layout, border.codes()[: border.known])] = False
        count = int(touched.sum())
        for step in self.backward_pass() if count else ():
            found.append(step)
            count -= int(touched[parameter_indices(layout, step.eliminated)].sum())
            if not count:
                break
        return reversed(found)


def solve_shared(chain: EliminationChain, belief: Hyperparameters | None = None) -> SharedPosterior:
    """The border's posterior.

    Args:
        chain: all pairs.
        belief: what is believed of the border instead of what the chain's hyper-parameters say.
    """
    last, precision, pull = eliminate_last(chain)
    believed = shared_prior(chain.state, belief or chain.hyper, chain.border)
    border_codes = chain.border.codes()[: chain.border.known]
    about = chain.linearisation_point[parameter_indices(chain.state.layout, border_codes)]
    pull[: len(border_codes)] -= believed[: len(border_codes), : len(border_codes)] @ about
    precision += believed
    factor = cholesky(regularise(precision))
    return SharedPosterior(chain, last, factor, cho_solve((factor, True), pull, check_finite=False))


def mean_of(ending: SharedPosterior, newest: int | None = None) -> Vector:
    """(n,) posterior mean of the joint parameters.

    Args:
        ending: of the chain.
        newest: of so many newest pairs alone. Older parameters stay at the chain's `linearisation_point`; the cost does not grow with the
            run.
    """
    layout, border = ending.chain.state.layout, ending.chain.border
    move = np.zeros(layout.size)
    border_codes = border.codes()[: border.known]
    move[parameter_indices(layout, border_codes)] = ending.step[: border.known]
    remaining = newest or 0
    for step in ending.backward_pass():
        gradient = step.pull - step.front_coupling @ move[parameter_indices(layout, step.kept)] - step.to_border @ ending.step
        move[parameter_indices(layout, step.eliminated)] = solve_triangular(step.factor, gradient, lower=True, trans=1, check_finite=False)
        remaining -= step.pair is not None
        if newest and not remaining:
            break
    return ending.chain.linearisation_point + move


@dataclass(frozen=True, slots=True, eq=False)
class PairCovariance:
    """Posterior covariance of what concerns one pair: its own parameters, its neighbours' knots, and the knots of frame 0.

    Attributes:
        pair: its number.
        index: (m,) joint indices, sorted.
        covariance: (m, m) of them.
    """

    pair: int
    index: NDArray[np.int64]
    covariance: Matrix

    def of(self, index: NDArray[np.int64]) -> Matrix:
        """Covariance of some of them."""
        at = np.searchsorted(self.index, index)
        return self.covariance[np.ix_(at, at)]


def distortion_covariance(ending: SharedPosterior) -> Matrix:
    """(d, d) covariance of the distortion's parameters."""
    own = np.zeros((len(ending.factor), ending.chain.border.counts[DISTORTION]))
    np.fill_diagonal(own, 1.0)
    half = solve_triangular(ending.factor, own, lower=True, check_finite=False)
    return half.T @ half


@dataclass(frozen=True, slots=True, eq=False)
class _Back:
    """What one step gives on the way back, given the border.

    Attributes:
        step: the step.
        codes: of its front, sorted.
        order: that sorts what is gone and kept.
        kept_at: where the kept are in the front of the step before on the way.
        given: (front, m) factor of the front's covariance, given the border: its product with its transpose.
        response: (front, b) of the front to the border.
        answer: (gone, b) the part of it that is of what is gone.
    """

    step: EliminationStep
    codes: Codes
    order: NDArray[np.int64]
    kept_at: NDArray[np.int64]
    given: Matrix
    response: Matrix
    answer: Matrix


def covariances(ending: SharedPosterior, rows: Mapping[int, tuple[Codes, Matrix]]) -> dict[int, Matrix]:
    """(k, k) covariance of k linear functions of what each pair touches, by pair: one way back for all of them.

    Args:
        ending: of the chain.
        rows: by pair, codes (m,) of parameters of the pair or of the border and the functions (k, m) of them.

    Raises:
        KeyError: the chain does not have a pair.
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
    """Of every pair, or of so many newest ones; the newest first.

    Given the border, the covariance goes back from step to step as in a Rauch-Tung-Striebel smoother. What the border's uncertainty adds
    is its posterior seen through each parameter's response to it.
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
            through = np.concatenate((solved[row:stop], through[group.kept_at]))[group.order]
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
    """From the last step to the first, covariances as factors.

    Where the drift is stiff, gains enlarge what rounding leaves by up to 1e10 on the way: variances of 2e-5 px^2 came out as -5e-5 and
    as -59. Of factors it is the square of what rounding leaves that is enlarged.
    """
    codes, given = np.zeros(0, dtype=np.int64), np.zeros((0, 0))
    response = np.zeros((0, ending.chain.border.size))
    for step in ending.backward_pass():
        at = np.searchsorted(codes, step.kept)
        given, response = _narrowed(given[at]), response[at]
        alone = np.asarray(solve_triangular(step.factor, np.eye(len(step.eliminated)), lower=True, check_finite=False), dtype=np.float64).T
        gain, answer = alone @ step.front_coupling, -(alone @ (step.to_border + step.front_coupling @ response))
        both = np.concatenate((step.eliminated, step.kept))
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
    """A factor (n, m) of the same covariance with at most n columns."""
    return factor if factor.shape[1] <= len(factor) else np.asarray(np.linalg.qr(factor.T, mode="r"), dtype=np.float64).T
