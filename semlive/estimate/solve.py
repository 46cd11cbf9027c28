"""The posterior: Cholesky of the information matrix, with noise scale and smoothness chosen by the data."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve, eigh, get_lapack_funcs

from semlive.errors import IllPosed
from semlive.estimate.accumulate import marginal, predicted, relinearised
from semlive.estimate.prior import Hyper, angles, belief_precision, gauge_precision
from semlive.estimate.state import EstimatorState

CANDIDATES = 10.0 ** np.arange(-5.0, 1.01, 0.25)  # typical second differences from knot to knot, px
ROTATION_CANDIDATES = 10.0 ** np.arange(-7.0, -1.9, 0.25)  # rad
# Log-normal beliefs (median, standard deviation of the logarithm): they decide only while data are silent.
DRIFT_BELIEF = (0.05, 2.0)
DISTORTION_BELIEF = (0.5, 1.5)
ROTATION_BELIEF = (1e-4, 3.0)
CLIP = 4.0
MIN_NOISE_SCALE = 1e-3

Information = tuple[NDArray[np.float64], NDArray[np.float64]]
"""(n, n) information matrix and (n,) information vector, without priors."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Posterior of all parameters given everything accumulated.

    Attributes:
        state: the data, linearised about this posterior's mean of the pass before.
        hyper: noise scale and smoothness used.
        mean: (n,) posterior mean.
        covariance: (n, n) posterior covariance.
        noise_floor_px: robust standard deviation of one POI that the model leaves unexplained, per component.
    """

    state: EstimatorState
    hyper: Hyper
    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]
    noise_floor_px: float

    def part(self, name: str) -> NDArray[np.float64]:
        """Posterior mean of one effect's parameters."""
        return self.mean[self.state.layout.part(name)]

    def covariance_of(self, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """(k, k) covariance of k linear functions (k, n) of the parameters."""
        return rows @ self.covariance @ rows.T


def solve(state: EstimatorState) -> Solution:
    """Posterior mean and covariance of drift, distortion and motion.

    The noise scale follows from the residuals, the smoothness of drift and distortion from the marginal likelihood
    (empirical Bayes), and the gradients' columns are re-linearised once about a first solution.

    Raises:
        IllPosed: there are no data, or they are not finite.
    """
    if state.drift is None:
        raise IllPosed("no pair has been accumulated yet, so there is nothing to estimate: add pair 0 first")
    gauge = gauge_precision(state)
    hyper = Hyper()
    mean, _ = posterior(marginal(state), belief_precision(state, hyper) + gauge, hyper.noise_scale)
    state = relinearised(state, mean)
    data = marginal(state)
    for choose in (_same, _likeliest_hyper):
        mean, factor = posterior(data, belief_precision(state, hyper) + gauge, hyper.noise_scale)
        scale, _ = _noise(state, data, hyper, mean, _inverse(factor))
        hyper = choose(state, data, replace(hyper, noise_scale=scale), gauge)
    mean, factor = posterior(data, belief_precision(state, hyper) + gauge, hyper.noise_scale)
    covariance = _inverse(factor)
    _, floor_px = _noise(state, data, hyper, mean, covariance)
    return Solution(state, hyper, mean, covariance, floor_px)


def posterior(data: Information, prior: NDArray[np.float64], noise_scale: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(n,) posterior mean and (n, n) lower Cholesky factor of its precision, for information at unit noise scale."""
    weight = noise_scale**-2.0
    try:
        factor, _ = cho_factor(data[0] * weight + prior, lower=True, check_finite=True)
    except (LinAlgError, ValueError) as error:
        raise IllPosed(
            "drift, distortion and motion cannot be told from the pairs so far: a map holds numbers that are not finite"
        ) from error
    return cho_solve((factor, True), data[1] * weight, check_finite=False), factor


def residuals(state: EstimatorState, mean: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """(blocks, 2) residual of each map's block means, px, with the noise of frame 0 taken out of the maps from it."""
    noise_px = state.reference.mean_px(mean)
    return [rows.disparity_px - predicted(state, rows, mean) + (noise_px if rows.from_reference else 0.0) for rows in state.rows]


def _inverse(factor: NDArray[np.float64]) -> NDArray[np.float64]:
    """Inverse from a lower Cholesky factor, symmetric."""
    (potri,) = get_lapack_funcs(("potri",), (factor,))
    lower, _ = potri(factor, lower=1)
    return np.tril(lower) + np.tril(lower, -1).T


def _noise(
    state: EstimatorState, data: Information, hyper: Hyper, mean: NDArray[np.float64], covariance: NDArray[np.float64]
) -> tuple[float, float]:
    """Noise scale from normalised residuals (clipped, for outliers), and the noise of one POI in px.

    Block means scatter by ``scatter`` of their assigned variance, and each parameter that the data determine takes one
    whole assigned variance away. The noise of frame 0 counts as residual against its prior.
    """
    blocks, noise = state.blocks, state.reference
    z, variance = [(noise.mean_px(mean) * np.sqrt(noise.prior))[noise.prior > 0]], []
    for rows, residual in zip(state.rows, residuals(state, mean), strict=True):
        used = rows.weight > 0
        z.append((residual * np.sqrt(rows.weight))[used])
        variance.append(2 / rows.noisy_frames / rows.weight[used])
    joined = np.concatenate(z)
    spread = 1.4826 * float(np.median(np.abs(joined)))
    clipped = np.clip(joined, -CLIP * spread, CLIP * spread)
    expected = blocks.scatter * float(len(joined) - len(z[0]))
    determined = float(np.sum(covariance * data[0])) * hyper.noise_scale**-2.0
    freedom = max(expected - determined, 0.1 * expected, 1.0)
    scale = max(float(np.sqrt(np.sum(clipped**2) / freedom)), MIN_NOISE_SCALE)
    poi_px = float(np.sqrt(np.mean(np.concatenate(variance)) / blocks.variance(blocks.full_count).mean()))
    return scale, scale * poi_px


def _same(state: EstimatorState, data: Information, hyper: Hyper, gauge: NDArray[np.float64]) -> Hyper:
    return hyper


def _likeliest_hyper(state: EstimatorState, data: Information, hyper: Hyper, gauge: NDArray[np.float64]) -> Hyper:
    """The smoothness of drift and distortion and the size of rotations that make the data most likely, one after the other."""
    at = angles(state)
    if at.size:
        precision, information = _marginal(data, belief_precision(state, hyper), gauge, hyper.noise_scale, at)
        size = _likeliest(precision, information, np.eye(at.size), 0, ROTATION_BELIEF, ROTATION_CANDIDATES)
        hyper = replace(hyper, rotation_rad=size)
    for effect, belief in ((state.drift, DRIFT_BELIEF), (state.distortion, DISTORTION_BELIEF)):
        assert effect is not None  # solve() refuses an empty state
        part, rank_loss = state.layout.part(effect.name), 2 if effect is state.drift else 3
        precision, information = _marginal(data, belief_precision(state, hyper), gauge, hyper.noise_scale, np.arange(part.start, part.stop))
        best = [
            _likeliest(precision[axis::2, axis::2], information[axis::2], effect.roughness(), rank_loss, belief, CANDIDATES)
            for axis in (0, 1)
        ]
        hyper = replace(hyper, **{f"{effect.name}_px": (best[0], best[1])})
    return hyper


def _marginal(
    data: Information, belief: NDArray[np.float64], gauge: NDArray[np.float64], noise_scale: float, at: NDArray[np.int64]
) -> Information:
    """Information on some parameters, with all others integrated out and what `belief` says of these left out."""
    weight = noise_scale**-2.0
    bare = data[0] * weight + gauge
    full = bare + belief
    information = data[1] * weight
    own = np.zeros(len(information), dtype=bool)
    own[at] = True
    cross = full[np.ix_(own, ~own)]
    factor = cho_factor(full[np.ix_(~own, ~own)], lower=True, check_finite=False)
    solved = cho_solve(factor, np.column_stack((cross.T, information[~own])), check_finite=False)
    return bare[np.ix_(own, own)] - cross @ solved[:, :-1], information[own] - cross @ solved[:, -1]


def _likeliest(
    precision: NDArray[np.float64],
    information: NDArray[np.float64],
    roughness: NDArray[np.float64],
    rank_loss: int,
    belief: tuple[float, float],
    candidates: NDArray[np.float64],
) -> float:
    """The candidate smoothness with the largest marginal likelihood, for one component of one effect.

    One generalised eigendecomposition serves all candidates s: with ``P0 = precision + roughness / s0^2``, V^T P0 V = 1
    and V^T roughness V = L, every posterior precision is diagonal, ``1 + L (1 / s^2 - 1 / s0^2)``.
    """
    roughest = candidates[-1]
    values, vectors = eigh(roughness, precision + roughness / roughest**2, check_finite=False)
    projected = (information @ vectors) ** 2
    more = 1.0 + np.outer(candidates**-2.0 - roughest**-2.0, np.clip(values, 0.0, None))
    log_belief = -0.5 * (np.log(candidates / belief[0]) / belief[1]) ** 2
    rank = len(information) - rank_loss
    score = 0.5 * (projected / more).sum(axis=1) - 0.5 * np.log(more).sum(axis=1) - rank * np.log(candidates) + log_belief
    return float(candidates[int(np.argmax(score))])
