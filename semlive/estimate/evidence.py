"""What the data say of smoothness: the marginal likelihood of each candidate (empirical Bayes)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from semlive.estimate.arrow import Sides, eliminated, sides, steady
from semlive.estimate.prior import ANYWHERE_PX, BASE_PX, Hyper, Smoothness, angles, belief_precision
from semlive.estimate.state import EstimatorState
from semlive.model import DistortionSpline, DriftSpline

# Orders of roughness that are tried, each with log-normal beliefs (median, standard deviation of the logarithm) about the typical
# difference of that order from knot to knot, px: they decide only while data are silent.
DRIFT_ORDERS = {2: (0.05, 2.0), 3: (0.01, 4.0)}
# With a third order besides, it was chosen for the fourth at x200, and the correction added 1.7e-5 to the scatter of strain for 1.25e-5.
DISTORTION_ORDERS = {2: (0.5, 1.5), 4: (0.05, 4.0)}
# A quadratic drift has no third differences at all. Held to 1e-4 px it took twice as much noise for strain along y as held to 3e-5 px;
# below that the elimination of pairs loses digits. Above 1 px lies no drift: 31 px were chosen in its stead while the coupling was wrong.
CANDIDATES = 10.0 ** np.arange(-4.5, 0.01, 0.25)
# A first pair says nothing of the distortion: 1e-4 px could be chosen, and beside BASE_PX the elimination of pairs then lost seven digits.
DISTORTION_CANDIDATES = 10.0 ** np.arange(-2.0, 1.51, 0.25)
ROTATION_BELIEF = (1e-4, 3.0)
ROTATION_CANDIDATES = 10.0 ** np.arange(-7.0, -1.9, 0.25)  # rad


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
    """The size of rotations and the smoothness of distortion and drift that make the data most likely, one after the other.

    Distortion comes before drift. A drift that repeats in every frame is a distortion along y: judged while the distortion was still
    held as smooth as is believed without data, the drift of a small frame that bends by 2 px had to be rough along y in its place (by 60
    in the logarithm of the likelihood), and the modulus was known to 11 % where it is to 3 %.
    """
    at, where = angles(state), sides(state)
    bare = data.scaled(hyper.noise_scale**-2.0).believing(gauge)
    if at.size:
        hyper = replace(hyper, rotation_rad=_likeliest_size(marginal_of(bare, belief_precision(state, hyper), where, at)))
    for effect, orders, sizes in ((state.distortion, DISTORTION_ORDERS, DISTORTION_CANDIDATES), (state.drift, DRIFT_ORDERS, CANDIDATES)):
        assert effect is not None  # solve() refuses an empty state
        part = state.layout.part(effect.name)
        both = marginal_of(bare, belief_precision(state, hyper), where, np.arange(part.start, part.stop))
        pinned = gauge[part, part][0::2, 0::2]  # the same for x and y
        before = {order: prior_spread(effect, pinned, order) for order in orders}
        best = []
        for axis in (0, 1):
            one = slice(axis, None, 2)
            own = Misfit(both.precision[one, one], both.pull[one], both.about[one])
            best.append(smoothest(own, effect, before, orders, sizes))
        hyper = replace(hyper, **{effect.name: (best[0], best[1])})
    return hyper


def marginal_of(bare: Misfit, belief: NDArray[np.float64], where: Sides, at: NDArray[np.int64]) -> Misfit:
    """What is known of some parameters, with all others integrated out and what `belief` says of these left out."""
    gone = np.ones(len(bare.pull), dtype=bool)
    gone[at] = False
    belief = np.where(gone[:, None], belief, 0.0)  # no belief joins parameters of two effects
    precision, pull = eliminated(bare.precision + belief, bare.pull - belief @ bare.about, where, gone)
    return Misfit(precision, pull, bare.about[~gone])


def _likeliest_size(data: Misfit) -> float:
    """The likeliest standard deviation of parameters that are independent of each other."""
    values, vectors = np.linalg.eigh(data.precision)
    belief = ROTATION_CANDIDATES[:, None] ** -2.0
    pull, about = data.pull @ vectors, data.about @ vectors
    values = np.clip(values, 0.0, None)
    fit = (pull - belief * about) ** 2 / (values + belief) - belief * about**2
    score = 0.5 * (fit - np.log1p(values / belief)).sum(axis=1) + log_belief(ROTATION_CANDIDATES, ROTATION_BELIEF)
    return float(ROTATION_CANDIDATES[int(np.argmax(score))])


def smoothest(
    data: Misfit,
    effect: DriftSpline | DistortionSpline,
    before: dict[int, NDArray[np.float64]],
    orders: dict[int, tuple[float, float]],
    sizes: NDArray[np.float64] = CANDIDATES,
) -> Smoothness:
    """The order and size of smoothness with the largest marginal likelihood, for one component of one effect.

    One generalised eigendecomposition serves all sizes s of an order: with the precision ``P`` of data and base belief,
    ``V^T (P + R / s0^2) V = 1`` and ``V^T R V = L``, every posterior precision ``P + R / s^2`` is diagonal, as is the prior in its own.
    """
    data = data.believing(_base(effect))
    tight = sizes**-2.0
    best, highest = Smoothness(2, 0.0), -np.inf
    for order, belief in orders.items():
        roughness = effect.roughness(order)
        values, vectors = eigh(roughness, steady(data.precision + roughness * tight[-1]), check_finite=False)
        bent = roughness @ data.about
        pull = data.pull @ vectors - np.outer(tight, bent @ vectors)
        more = 1.0 + np.outer(tight - tight[-1], np.clip(values, 0.0, None))
        fit = (pull**2 / more).sum(axis=1) - tight * float(data.about @ bent)
        after = np.log(more).sum(axis=1) - 2.0 * float(np.linalg.slogdet(vectors)[1])
        prior = np.log1p(np.outer(tight, before[order])).sum(axis=1)
        score = 0.5 * (fit + prior - after) + log_belief(sizes, belief)
        at = int(np.argmax(score))
        if score[at] > highest:
            best, highest = Smoothness(order, float(sizes[at])), float(score[at])
    return best


def _base(effect: DriftSpline | DistortionSpline) -> NDArray[np.float64]:
    """(m, m) precision of one component that every candidate has."""
    return effect.roughness() * BASE_PX**-2.0 + np.eye(effect.size // 2) * ANYWHERE_PX**-2.0


def prior_spread(effect: DriftSpline | DistortionSpline, gauge: NDArray[np.float64], order: int) -> NDArray[np.float64]:
    """(m,) eigenvalues of an order's roughness against what is believed anyway."""
    return np.clip(eigh(effect.roughness(order), _base(effect) + gauge, eigvals_only=True, check_finite=False), 0.0, None)


def log_belief(candidates: NDArray[np.float64], belief: tuple[float, float]) -> NDArray[np.float64]:
    """Logarithm of a log-normal belief (median, standard deviation of the logarithm) at candidates."""
    return -0.5 * (np.log(candidates / belief[0]) / belief[1]) ** 2 - np.log(belief[1])
