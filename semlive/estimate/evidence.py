"""What the data say of smoothness: the marginal likelihood of each candidate (empirical Bayes)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, eigh

from semlive.estimate.prior import ANYWHERE_PX, BASE_PX, Hyper, Smoothness, angles, belief_precision
from semlive.estimate.state import EstimatorState
from semlive.model import DistortionSpline, DriftSpline

# Orders of roughness that are tried, each with log-normal beliefs (median, standard deviation of the logarithm) about the typical
# difference of that order from knot to knot, px: they decide only while data are silent.
DRIFT_ORDERS = {2: (0.05, 2.0), 3: (0.01, 4.0)}
DISTORTION_ORDERS = {2: (0.5, 1.5), 4: (0.05, 4.0)}
CANDIDATES = 10.0 ** np.arange(-4.0, 1.01, 0.25)
ROTATION_BELIEF = (1e-4, 3.0)
ROTATION_CANDIDATES = 10.0 ** np.arange(-7.0, -1.9, 0.25)  # rad
ROUNDING = 1e-14


@dataclass(frozen=True, slots=True, eq=False)
class Misfit:
    """The data about a point: for parameters ``about + step`` their log-likelihood is ``pull @ step - step @ precision @ step / 2``.

    About a first solution the pull is small and exact; the information vector itself, about zero, carries rounding errors that pass
    for structure where data are free of noise.

    Attributes:
        precision: (n, n) information matrix, without priors.
        pull: (n,) what the residuals ask for.
        about: (n,) the point.
    """

    precision: NDArray[np.float64]
    pull: NDArray[np.float64]
    about: NDArray[np.float64]

    def scaled(self, weight: float) -> Misfit:
        """With every weight multiplied."""
        return Misfit(self.precision * weight, self.pull * weight, self.about)

    def believing(self, prior: NDArray[np.float64]) -> Misfit:
        """Together with a prior about zero."""
        return Misfit(self.precision + prior, self.pull - prior @ self.about, self.about)


def likeliest_hyper(state: EstimatorState, data: Misfit, hyper: Hyper, gauge: NDArray[np.float64]) -> Hyper:
    """The smoothness of drift and distortion and the size of rotations that make the data most likely, one after the other."""
    at = angles(state)
    bare = data.scaled(hyper.noise_scale**-2.0).believing(gauge)
    if at.size:
        hyper = replace(hyper, rotation_rad=_likeliest_size(marginal_of(bare, belief_precision(state, hyper), at)))
    for effect, orders in ((state.drift, DRIFT_ORDERS), (state.distortion, DISTORTION_ORDERS)):
        assert effect is not None  # solve() refuses an empty state
        part = state.layout.part(effect.name)
        both = marginal_of(bare, belief_precision(state, hyper), np.arange(part.start, part.stop))
        best = []
        for axis in (0, 1):
            one = slice(axis, None, 2)
            own = Misfit(both.precision[one, one], both.pull[one], both.about[one])
            best.append(_likeliest(own, effect, gauge[part, part][one, one], orders))
        hyper = replace(hyper, **{effect.name: (best[0], best[1])})
    return hyper


def marginal_of(bare: Misfit, belief: NDArray[np.float64], at: NDArray[np.int64]) -> Misfit:
    """What is known of some parameters, with all others integrated out and what `belief` says of these left out."""
    own = np.zeros(len(bare.pull), dtype=bool)
    own[at] = True
    cross = bare.precision[np.ix_(own, ~own)]
    others = np.ix_(~own, ~own)
    pull = bare.pull[~own] - belief[others] @ bare.about[~own]
    factor = cho_factor(steady(bare.precision[others] + belief[others]), lower=True, check_finite=False)
    solved = cho_solve(factor, np.column_stack((cross.T, pull)), check_finite=False)
    return Misfit(bare.precision[np.ix_(own, own)] - cross @ solved[:, :-1], bare.pull[own] - cross @ solved[:, -1], bare.about[own])


def steady(precision: NDArray[np.float64]) -> NDArray[np.float64]:
    """The matrix with as much added to its diagonal as rounding may have taken: what no datum says must not turn negative."""
    return precision + np.diag(ROUNDING * np.diag(precision))


def _likeliest_size(data: Misfit) -> float:
    """The likeliest standard deviation of parameters that are independent of each other."""
    values, vectors = np.linalg.eigh(data.precision)
    belief = ROTATION_CANDIDATES[:, None] ** -2.0
    pull, about = data.pull @ vectors, data.about @ vectors
    values = np.clip(values, 0.0, None)
    fit = (pull - belief * about) ** 2 / (values + belief) - belief * about**2
    score = 0.5 * (fit - np.log1p(values / belief)).sum(axis=1) + _log_belief(ROTATION_CANDIDATES, ROTATION_BELIEF)
    return float(ROTATION_CANDIDATES[int(np.argmax(score))])


def _likeliest(
    data: Misfit, effect: DriftSpline | DistortionSpline, gauge: NDArray[np.float64], orders: dict[int, tuple[float, float]]
) -> Smoothness:
    """The order and size of smoothness with the largest marginal likelihood, for one component of one effect.

    One generalised eigendecomposition serves all sizes s of an order: with the precision ``P`` of data and base belief,
    ``V^T (P + R / s0^2) V = 1`` and ``V^T R V = L``, every posterior precision ``P + R / s^2`` is diagonal, as is the prior in its own.
    """
    base = effect.roughness() * BASE_PX**-2.0 + np.eye(len(data.pull)) * ANYWHERE_PX**-2.0
    data = data.believing(base)
    tight = CANDIDATES**-2.0
    best, highest = Smoothness(2, 0.0), -np.inf
    for order, belief in orders.items():
        roughness = effect.roughness(order)
        before = np.clip(eigh(roughness, base + gauge, eigvals_only=True, check_finite=False), 0.0, None)
        values, vectors = eigh(roughness, steady(data.precision + roughness * tight[-1]), check_finite=False)
        bent = roughness @ data.about
        pull = data.pull @ vectors - np.outer(tight, bent @ vectors)
        more = 1.0 + np.outer(tight - tight[-1], np.clip(values, 0.0, None))
        fit = (pull**2 / more).sum(axis=1) - tight * float(data.about @ bent)
        after = np.log(more).sum(axis=1) - 2.0 * float(np.linalg.slogdet(vectors)[1])
        prior = np.log1p(np.outer(tight, before)).sum(axis=1)
        score = 0.5 * (fit + prior - after) + _log_belief(CANDIDATES, belief)
        at = int(np.argmax(score))
        if score[at] > highest:
            best, highest = Smoothness(order, float(CANDIDATES[at])), float(score[at])
    return best


def _log_belief(candidates: NDArray[np.float64], belief: tuple[float, float]) -> NDArray[np.float64]:
    return -0.5 * (np.log(candidates / belief[0]) / belief[1]) ** 2 - np.log(belief[1])
