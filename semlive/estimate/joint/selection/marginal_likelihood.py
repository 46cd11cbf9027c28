"""Selection of smoothness by the marginal likelihood of each candidate (empirical Bayes)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, eigh, solve_triangular

from semlive.estimate.joint.elimination.arrowhead import ComponentBlocks, marginalise, regularise, sides
from semlive.estimate.joint.observations.priors import (
    BASE_PX,
    UNINFORMATIVE_PX,
    Hyperparameters,
    Kind,
    Smoothness,
    gaps_of,
    prior_precision,
    rotation_indices,
)
from semlive.estimate.joint.observations.state import EstimatorState
from semlive.model import DistortionSpline, DriftSpline

Orders = dict[Kind, tuple[float, float]]
Spectrum = tuple[NDArray[np.float64], NDArray[np.float64]]
# Orders of roughness that are tried, each with log-normal beliefs (median, standard deviation of the logarithm) about the typical
# difference of that order from knot to knot, px: they decide only while data are silent.
NON_OSCILLATING_PRIORS: Orders = {(3, 0.0): (0.01, 4.0), (2, 0.0): (0.05, 2.0)}
# A drift that wanders may like to swing with one period, in knots. As random bends of one size, which are all waves up to Nyquist's, waves
# of 240 s were taken for much smaller than they are: under 0.3 px of wander drift and distortion erred by 1.2 of what was stated and
# Young's modulus by 1.8 to 2.1, where it errs by half as much now, and as stated. Bends held down beyond a corner, or
# steps held down so, explain the maps less well.
OSCILLATING_PRIORS: Orders = {(2, float(knots)): (0.05, 2.0) for knots in np.geomspace(5.0, 80.0, 14)}
DRIFT_ORDERS: Orders = NON_OSCILLATING_PRIORS | OSCILLATING_PRIORS
STILL_PX = 1e-3  # differences of a drift that has no swing worth knowing
# With a third order besides, it was chosen for the fourth at x200, and the correction added 1.7e-5 to the scatter of strain for 1.25e-5.
DISTORTION_ORDERS: Orders = {(2, 0.0): (0.5, 1.5), (4, 0.0): (0.05, 4.0)}
# A quadratic drift has no third differences at all. Held to 1e-4 px it took twice as much noise for strain along y as held to 3e-5 px;
# below that the elimination of pairs loses digits. Above 1 px lies no drift: 31 px were chosen in its stead while the coupling was wrong.
# In steps of a quarter of a decade sigma was chosen up to a sixth too large or too small.
CANDIDATES = 10.0 ** np.arange(-4.5, 0.01, 0.125)
# A first pair does not determine the distortion: 1e-4 px could be selected, and with BASE_PX the elimination then lost seven digits.
DISTORTION_CANDIDATES = 10.0 ** np.arange(-2.0, 1.51, 0.25)
ROTATION_PRIOR, ROW_SHIFT_PRIOR = (1e-4, 3.0), (0.03, 1.5)
ROTATION_CANDIDATES = 10.0 ** np.arange(-7.0, -1.9, 0.25)  # rad
LINE_CANDIDATES = 10.0 ** np.arange(-3.5, 0.6, 0.125)  # px


@dataclass(frozen=True, slots=True, eq=False)
class LocalLikelihood:
    """Quadratic log-likelihood about a point: for parameters ``point + step`` it is ``gradient @ step - step @ precision @ step / 2``.

    About a first solution the gradient is small and exact. The information vector about zero contains rounding errors that resemble
    structure if the data are free of noise.

    Attributes:
        precision: (n, n) information matrix, without priors.
        gradient: (n,) gradient of the log-likelihood at the point.
        linearisation_point: (n,) the point.
    """

    precision: NDArray[np.float64]
    gradient: NDArray[np.float64]
    linearisation_point: NDArray[np.float64]

    def scaled(self, weight: float) -> LocalLikelihood:
        """The likelihood with every weight multiplied by `weight`."""
        return LocalLikelihood(self.precision * weight, self.gradient * weight, self.linearisation_point)

    def with_prior(self, prior: NDArray[np.float64]) -> LocalLikelihood:
        """The likelihood times a Gaussian prior with zero mean."""
        return LocalLikelihood(self.precision + prior, self.gradient - prior @ self.linearisation_point, self.linearisation_point)


def maximise_evidence(state: EstimatorState, data: LocalLikelihood, hyper: Hyperparameters, gauge: NDArray[np.float64]) -> Hyperparameters:
    """Select, one after the other, the size of rotations and the smoothness of distortion and drift that maximise the marginal likelihood.

    Distortion comes before drift. A drift that repeats in every frame is equivalent to a distortion along y. With the prior
    smoothness of the
    distortion, the drift of a small frame with a distortion of 2 px had to be rough along y instead (by 60 in log likelihood), and
    the uncertainty of the modulus was 11 % instead of 3 %.
    """
    at, where = rotation_indices(state), sides(state)
    baseline = data.scaled(hyper.noise_scale**-2.0).with_prior(gauge)
    if at.size:
        turning = marginal_of(baseline, prior_precision(state, hyper), where, at)
        hyper = replace(hyper, rotation_rad=_likeliest_size(turning, ROTATION_CANDIDATES, ROTATION_PRIOR))
    for effect, orders, sizes in (
        (state.distortion, DISTORTION_ORDERS, DISTORTION_CANDIDATES),
        (state.drift, NON_OSCILLATING_PRIORS, CANDIDATES),
    ):
        assert effect is not None  # solve() refuses an empty state
        part = state.layout.part(effect.name)
        both = marginal_of(baseline, prior_precision(state, hyper), where, np.arange(part.start, part.stop))
        pinned = gauge[part, part][0::2, 0::2]  # the same for x and y
        best, prior = [], SmoothnessPrior(effect, pinned)
        for axis in (0, 1):
            component = slice(axis, None, 2)
            own = LocalLikelihood(both.precision[component, component], both.gradient[component], both.linearisation_point[component])
            best.append(select_smoothness(own, prior, orders, sizes))
        hyper = replace(hyper, **{effect.name: (best[0], best[1])})
    return hyper


def select_row_shift_size(
    state: EstimatorState, data: LocalLikelihood, hyper: Hyperparameters, gauge: NDArray[np.float64]
) -> Hyperparameters:
    """Select the most likely size of row shifts, with the prior smoothness of the drift.

    If both sizes are selected in turn, they do not converge: with a slightly too stiff drift, the row shifts
    take over its change between frames, grow from 0.06 px to 0.6 px and then explain all curvature of the drift.
    """
    lines, baseline = (
        np.arange(*state.layout.part("line_shift").indices(state.layout.size)),
        data.scaled(hyper.noise_scale**-2.0).with_prior(gauge),
    )
    shifted = marginal_of(baseline, prior_precision(state, replace(hyper, drift=Hyperparameters().drift)), sides(state), lines)
    return replace(hyper, row_shift_px=_likeliest_size(shifted, LINE_CANDIDATES, ROW_SHIFT_PRIOR))


def marginal_of(baseline: LocalLikelihood, belief: NDArray[np.float64], where: ComponentBlocks, at: NDArray[np.int64]) -> LocalLikelihood:
    """Information on some parameters after marginalising all others, without their own prior `belief`."""
    eliminated = np.ones(len(baseline.gradient), dtype=bool)
    eliminated[at] = False
    belief = np.where(eliminated[:, None], belief, 0.0)  # no belief joins parameters of two effects
    precision, pull = marginalise(baseline.precision + belief, baseline.gradient - belief @ baseline.linearisation_point, where, eliminated)
    return LocalLikelihood(precision, pull, baseline.linearisation_point[~eliminated])


def _likeliest_size(data: LocalLikelihood, candidates: NDArray[np.float64], believed: tuple[float, float]) -> float:
    """Most likely standard deviation of independent parameters."""
    values, vectors = np.linalg.eigh(data.precision)
    belief = candidates[:, None] ** -2.0
    pull, about = data.gradient @ vectors, data.linearisation_point @ vectors
    values = np.clip(values, 0.0, None)
    fit = (pull - belief * about) ** 2 / (values + belief) - belief * about**2
    score = 0.5 * (fit - np.log1p(values / belief)).sum(axis=1) + log_prior(candidates, believed)
    return float(candidates[int(np.argmax(score))])


class SmoothnessPrior:
    """Prior of one component of an effect common to all smoothness candidates.

    Attributes:
        effect: the effect.
        base: (m, m) precision common to all candidates.
    """

    def __init__(self, effect: DriftSpline | DistortionSpline, gauge: NDArray[np.float64]) -> None:
        """With a gauge (m, m), which is no belief, in force."""
        self.effect = effect
        self.base = _base_precision(effect)
        self._gauge = gauge.tobytes()

    def spread(self, kind: Kind) -> NDArray[np.float64]:
        """(m,) eigenvalues of the roughness of a kind relative to the base prior."""
        return _prior_spread(self.effect, kind, self._gauge)


def _base_precision(effect: DriftSpline | DistortionSpline) -> NDArray[np.float64]:
    """(m, m) prior precision of one component that all smoothness candidates have in common."""
    return effect.roughness() * BASE_PX**-2.0 + np.eye(effect.size // 2) * UNINFORMATIVE_PX**-2.0


# One solution fits ten times with the same splines and gauge: without the cache a tenth of its time was spent here.
@lru_cache(maxsize=32)
def _prior_spread(effect: DriftSpline | DistortionSpline, kind: Kind, gauge: bytes) -> NDArray[np.float64]:
    """(m,) eigenvalues of the roughness of a kind relative to the base prior with a gauge, the bytes of its (m, m) precision."""
    base = _base_precision(effect)
    values = _spectrum(effect, kind, base + np.frombuffer(gauge).reshape(base.shape))[0]
    values.flags.writeable = False
    return values


def select_smoothness(data: LocalLikelihood, prior: SmoothnessPrior, orders: Orders, sizes: NDArray[np.float64]) -> Smoothness:
    """Select kind and size of smoothness with the largest marginal likelihood for one component of one effect.

    The marginal likelihood equals a product of predictive likelihoods: of the first block mean, of the second given the first,
    and so on, in
    any order. Oscillating kinds are tested only for a drift with enough curvature.
    """
    data = data.with_prior(prior.base)
    best, highest = Smoothness(2, 0.0), -np.inf
    for group in (orders, OSCILLATING_PRIORS) if isinstance(prior.effect, DriftSpline) else (orders,):
        for kind, belief in group.items() if group is orders or best.size_px > STILL_PX else ():
            score = _scores(data, prior, kind, sizes) + log_prior(sizes, belief)
            at = int(np.argmax(score))
            if score[at] > highest:
                best, highest = smoothness_of_kind(kind, float(sizes[at])), float(score[at])
    return best


def _scores(data: LocalLikelihood, smoothness_prior: SmoothnessPrior, kind: Kind, sizes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Log marginal likelihood of each size, up to a constant common to all kinds and sizes.

    One generalised eigendecomposition serves all sizes s of a kind: with the precision ``P`` of data and base prior,
    ``V^T (P + R / s0^2) V = 1`` and ``V^T R V = L``, every posterior precision ``P + R / s^2`` is diagonal, as is the prior in
    its own basis.
    """
    roughness, tight = smoothness_of_kind(kind, 1.0).roughness(smoothness_prior.effect), sizes**-2.0
    data, held = _about_tightest(data, roughness * tight.max())
    values, vectors = _spectrum(smoothness_prior.effect, kind, regularise(data.precision + roughness * tight[-1]))
    held_back = smoothness_of_kind(kind, 1.0).filter
    drifts = isinstance(smoothness_prior.effect, DriftSpline)
    # Computed from differences to avoid cancellation of large values.
    gaps = gaps_of(smoothness_prior.effect)
    bent = held_back.reversed(held_back.of(data.linearisation_point, gaps), gaps) if drifts else roughness @ data.linearisation_point
    pull = data.gradient @ vectors - np.outer(tight, bent @ vectors)
    more = 1.0 + np.outer(tight - tight[-1], values)
    fit = (pull**2 / more).sum(axis=1) - tight * float(data.linearisation_point @ bent)
    after = np.log(more).sum(axis=1) - 2.0 * float(np.linalg.slogdet(vectors)[1])
    prior = np.log1p(np.outer(tight, smoothness_prior.spread(kind))).sum(axis=1)
    return np.asarray(held + 0.5 * (fit + prior - after), dtype=np.float64)


def _spectrum(effect: DriftSpline | DistortionSpline, kind: Kind, against: NDArray[np.float64]) -> Spectrum:
    """Eigenvalues (m,) and vectors (m, m) of a kind's roughness R against a precision P: ``V^T P V = 1``, ``V^T R V = L``.

    For a drift they follow from singular values of its filtered differences. For a long oscillation R has eigenvalues of 1e7 and of 0. The
    rounding error of the latter is significant for differences of 3e-5 px: the logarithm of a likelihood was wrong by 26, and the order of
    summation decided whether a drift with curvature was identified as an oscillation.
    """
    if not isinstance(effect, DriftSpline):
        values, vectors = eigh(smoothness_of_kind(kind, 1.0).roughness(effect), against, check_finite=False)
        return np.clip(values, 0.0, None), vectors
    factor = cholesky(against, lower=True, check_finite=False)
    differences = smoothness_of_kind(kind, 1.0).filter.rows(effect.size // 2, gaps_of(effect))
    rows = solve_triangular(factor, differences.T, lower=True, check_finite=False).T
    values = np.zeros(len(factor))
    _, singular, turned = np.linalg.svd(rows)
    values[: len(singular)] = singular**2
    return values, np.asarray(solve_triangular(factor, turned.T, lower=True, trans=1, check_finite=False), dtype=np.float64)


def _about_tightest(data: LocalLikelihood, belief: NDArray[np.float64]) -> tuple[LocalLikelihood, float]:
    """The data linearised about the mean under the tightest prior, and the gain in log-likelihood relative to their own point.

    About a point with curvature, the cost of a tight prior is the small difference of large numbers.
    """
    step = np.linalg.solve(regularise(data.precision + belief), data.gradient - belief @ data.linearisation_point)
    gradient = data.precision @ step
    return LocalLikelihood(data.precision, data.gradient - gradient, data.linearisation_point + step), float(
        data.gradient @ step - 0.5 * step @ gradient
    )


def smoothness_of_kind(kind: Kind, size_px: float) -> Smoothness:
    """A kind of smoothness of a size."""
    return Smoothness(kind[0], size_px, kind[1])


def log_prior(candidates: NDArray[np.float64], belief: tuple[float, float]) -> NDArray[np.float64]:
    """Log density of a log-normal prior (median, standard deviation of the logarithm) at candidates."""
    return -0.5 * (np.log(candidates / belief[0]) / belief[1]) ** 2 - np.log(belief[1])
