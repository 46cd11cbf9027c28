"""Posterior of the joint estimate: Cholesky factor of the information matrix, with hyperparameters selected from the data."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve

from semlive.data.drift import TermTest
from semlive.errors import IllPosed
from semlive.estimate.joint.elimination.arrowhead import ArrowheadFactor, cholesky, factorise, regularise, sides
from semlive.estimate.joint.elimination.elimination import EliminationChain, eliminate_all
from semlive.estimate.joint.elimination.shared_parameters import distortion_prior
from semlive.estimate.joint.elimination.smoother import SharedPosterior, mean_of, solve_shared
from semlive.estimate.joint.observations.normal_equations import gradient, marginal, relinearise, reweight
from semlive.estimate.joint.observations.priors import Hyperparameters, gauge_precision, prior_precision
from semlive.estimate.joint.observations.reformulate import with_advected_distortion, with_row_shifts
from semlive.estimate.joint.observations.state import EstimatorState, MapObservations, offload_rows
from semlive.estimate.joint.selection.marginal_likelihood import LocalLikelihood, maximise_evidence, select_row_shift_size
from semlive.estimate.joint.selection.model_selection import COUPLING_SIGMAS, distortion_advection, raster_terms
from semlive.estimate.joint.selection.row_term import row_groups, row_shift_term_test
from semlive.estimate.joint.solution.residual_noise import MIN_FINAL_BLOCK_NOISE_PX, estimated_noise, residuals
from semlive.estimate.storage import IN_MEMORY, Storage

HUBER = 5.0
"""Limit of normalised residuals, in noise scales; of 32,000 block means of pure noise, one in fifty runs exceeds it."""
HUBER_PASSES = 2
PASSES = (3, 6)
"""Smallest and largest number of passes with advected distortion.

The drift of a fit with the wrong advection is wrong by 0.02 px, of which a fraction of 5e-3 remains: three passes with noise. Without
noise, the smoothness is selected again as the misfit decreases, by two digits in each pass.
"""
CONVERGENCE_TOLERANCE = 0.01  # of the noise scale
RASTER_START_PX = 0.1
MAX_INITIAL_ITERATIONS, NOISE_SCALE_JUMP = 3, 3.0
MAX_NOISE_SCALE_RATIO = 0.95
"""Ratio of noise scales below which advection is selected; with a few thousand block means a ratio of 0.99 is already significant."""

Information = tuple[NDArray[np.float64], NDArray[np.float64]]
"""(n, n) information matrix and (n,) information vector, without priors."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Posterior of all parameters given the accumulated data.

    Attributes:
        state: the data, linearised about the posterior mean at which the hyperparameters were selected.
        hyper: noise scale and prior sizes.
        mean: (n,) posterior mean.
        shared_posterior: the elimination that gave the posterior and to which further pairs are added.
        noise_floor_px: robust standard deviation of the residual of one POI, per component, at the last selection, px.
        terms: optional terms and the results of their tests.
    """

    state: EstimatorState
    hyper: Hyperparameters
    mean: NDArray[np.float64]
    shared_posterior: SharedPosterior
    noise_floor_px: float
    terms: tuple[TermTest, ...] = ()

    def part(self, name: str) -> NDArray[np.float64]:
        """Posterior mean of the parameters of one effect."""
        return self.mean[self.state.layout.part(name)]

    def covariance_of(self, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """(k, k) covariance of k linear functions (k, n) of the parameters."""
        return self.shared_posterior.covariance_of(rows)

    def distortion_covariance(self) -> NDArray[np.float64]:
        """(m, m) covariance of the parameters of the distortion, px^2."""
        rows = np.zeros((self.state.distortion.size, len(self.mean)))
        rows[:, self.state.layout.part("distortion")] = np.eye(self.state.distortion.size)
        return self.covariance_of(rows)

    def distortion_prior(self) -> NDArray[np.float64]:
        """(m, m) prior precision P of the parameters of the distortion, 1/px^2.

        The posterior precision is that of the data plus P. The posterior means of a true distortion are therefore I - C P times it on
        average, with the posterior covariance C.
        """
        return distortion_prior(self.state, self.hyper)


def select_and_solve(state: EstimatorState) -> Solution:
    """Compute the posterior mean and covariance of drift, distortion and motion, and select all hyperparameters.

    The noise scale follows from the residuals. The smoothness of drift and distortion follows from the marginal likelihood
    (empirical Bayes).
    The columns of the gradients are linearised a second time about a first solution.

    Raises:
        IllPosed: there are no data, or they are not finite.
    """
    return _finished(_couplings(state)[0], state.storage)


def solve_both_couplings(state: EstimatorState) -> tuple[Solution, Solution | None]:
    """Solve with the selected distortion advection and, if the data leave the selection in doubt, also with the other one.

    The selection is in doubt if the estimated advection coefficient differs from the selected 0 or 1.

    Raises:
        IllPosed: there are no data, or they are not finite.
    """
    chosen, alternative = _couplings(state)
    found = _finished(chosen, state.storage)
    try:
        return found, alternative and _finished(alternative, state.storage)
    except IllPosed:  # the fit with the rejected advection may fail
        return found, None


def posterior_from_elimination(
    chain: EliminationChain, terms: tuple[TermTest, ...], noise_floor_px: float, newest: int | None = None
) -> Solution:
    """Posterior from an elimination; with `newest`, only of that number of newest pairs and of the shared parameters."""
    ending = solve_shared(chain)
    mean = chain.state.storage.store_transient(mean_of(ending, newest))
    return Solution(chain.state, chain.hyper, mean, ending, noise_floor_px, terms)


def _concluded(
    state: EstimatorState, data: LocalLikelihood, hyper: Hyperparameters, gauge: NDArray[np.float64], terms: tuple[TermTest, ...]
) -> Solution:
    while True:
        mean, factor = _posterior_about(state, data, prior_precision(state, hyper) + gauge, hyper.noise_scale)
        scale, floor_px = estimated_noise(state, data.precision, hyper, mean, factor, MIN_FINAL_BLOCK_NOISE_PX)
        if scale > 0.5 * hyper.noise_scale:
            return posterior_from_elimination(eliminate_all(state, hyper, mean), terms, floor_px)
        hyper = replace(hyper, noise_scale=scale)  # the noise may be below the floor used for selection


@dataclass(frozen=True, slots=True, eq=False)
class _Fitted:
    """An intermediate fit: the data linearised about a mean, and the hyperparameters selected there."""

    state: EstimatorState
    data: LocalLikelihood
    hyper: Hyperparameters
    mean: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class _Coupled:
    """A fit with or without distortion advection, and the optional terms that were tested."""

    fitted: _Fitted
    terms: tuple[TermTest, ...]


def _couplings(state: EstimatorState) -> tuple[_Coupled, _Coupled | None]:
    """The selected fit, and the fit with the other advection if the selection is in doubt."""
    if state.drift is None:
        raise IllPosed("no pair has been accumulated yet, so there is nothing to estimate: add pair 0 first")
    state = replace(state, rows=tuple(state.rows), storage=IN_MEMORY)  # the rows are read dozens of times
    gauge = gauge_precision(state)
    mean = _first_mean(state, Hyperparameters(), gauge)
    fitted, tests = _with_raster_terms(_fitted(relinearise(state, mean), Hyperparameters(), gauge, mean), gauge)
    # A wrong magnification resembles a wrong advection and vice versa. The advection is tested with magnification in the model,
    # and the magnification is tested again after the advection.
    test = _coupling(fitted, gauge)
    still = _Coupled(fitted, (*tests, replace(test, included=False)))
    if abs(test.value) <= COUPLING_SIGMAS * test.sigma:  # one column does not determine gamma if the misfit dominates
        return still, None
    fitted, tests = _with_raster_terms(_carried(state, mean, gauge), gauge)
    along = _Coupled(fitted, (*tests, replace(test, included=True)))
    if test.included or along.fitted.hyper.noise_scale < MAX_NOISE_SCALE_RATIO * still.fitted.hyper.noise_scale:
        return along, still if abs(test.value - 1.0) > COUPLING_SIGMAS * test.sigma else None
    return still, along


def _finished(coupled: _Coupled, storage: Storage) -> Solution:
    fitted, lines = _with_line_shifts(coupled.fitted)
    gauge = gauge_precision(fitted.state)
    fitted = _robust(fitted, gauge)
    stored = replace(fitted.state, rows=storage.append((), (offload_rows(each, storage) for each in fitted.state.rows)), storage=storage)
    return _concluded(stored, fitted.data, fitted.hyper, gauge, (*coupled.terms, lines))


def _fitted(state: EstimatorState, hyper: Hyperparameters, gauge: NDArray[np.float64], near: NDArray[np.float64]) -> _Fitted:
    """Select noise scale, smoothness and noise scale again, and compute the mean with these.

    With the prior smoothness, a distortion that bends by 2 px in 276 px gave a noise scale of 1.5 instead of 1.0.
    """
    data = LocalLikelihood(marginal(state)[0], gradient(state, near), near)
    for choose in (None, maximise_evidence, None):
        mean, factor = _posterior_about(state, data, prior_precision(state, hyper) + gauge, hyper.noise_scale)
        scale, _ = estimated_noise(state, data.precision, hyper, mean, factor)
        hyper = replace(hyper, noise_scale=scale)
        hyper = choose(state, data, hyper, gauge) if choose else hyper
    mean, _ = _posterior_about(state, data, prior_precision(state, hyper) + gauge, hyper.noise_scale)
    return _Fitted(state, data, hyper, mean)


def _carried(state: EstimatorState, mean: NDArray[np.float64], gauge: NDArray[np.float64]) -> _Fitted:
    """Repeat fits with the distortion advected by the drift of the previous fit until the misfit is constant."""
    fitted = _fitted(with_advected_distortion(relinearise(state, mean)), Hyperparameters(), gauge, mean)
    for number in range(1, PASSES[1]):
        before = fitted.hyper
        start = replace(Hyperparameters(), noise_scale=before.noise_scale)
        fitted = _fitted(with_advected_distortion(relinearise(fitted.state, fitted.mean)), start, gauge, fitted.mean)
        if number + 1 >= PASSES[0] and _same(before, fitted.hyper):
            break
    return fitted


def _with_raster_terms(fitted: _Fitted, gauge: NDArray[np.float64]) -> tuple[_Fitted, tuple[TermTest, ...]]:
    hyper, tests = raster_terms(fitted.state, fitted.data, fitted.hyper, gauge)
    if hyper.raster_px == fitted.hyper.raster_px:
        return fitted, tests
    # Noise, smoothness and linearisation point were selected without the new term: select them again.
    start = replace(Hyperparameters(), raster_px=tuple(RASTER_START_PX if size else 0.0 for size in hyper.raster_px))
    remade = with_advected_distortion if fitted.state.distortion.carried else _as_it_is
    mean = _first_mean(fitted.state, start, gauge)
    for number in range(PASSES[1]):
        before = fitted.hyper
        fitted = _fitted(remade(relinearise(fitted.state, mean)), start, gauge, mean)
        hyper, tests = raster_terms(fitted.state, fitted.data, fitted.hyper, gauge)
        mean, start = fitted.mean, replace(Hyperparameters(), noise_scale=hyper.noise_scale, raster_px=hyper.raster_px)
        if number + 1 >= PASSES[0] and _same(before, fitted.hyper) and hyper.raster_px == fitted.hyper.raster_px:
            break
    return fitted if hyper == fitted.hyper else _fitted(fitted.state, hyper, gauge, mean), tests


def _with_line_shifts(fitted: _Fitted) -> tuple[_Fitted, TermTest]:
    test, size_px = row_shift_term_test(fitted.state, residuals(fitted.state, fitted.mean), fitted.hyper.noise_scale)
    if not test.included:
        return fitted, test
    # Noise and drift had absorbed the row shifts: select them again with the shifts in the model.
    state = with_row_shifts(fitted.state, row_groups(fitted.state), fitted.mean)
    start = replace(Hyperparameters(), raster_px=fitted.hyper.raster_px, rotation_rad=fitted.hyper.rotation_rad, row_shift_px=size_px)
    gauge, mean = gauge_precision(state), _first_mean(state, start, gauge_precision(state))
    state = relinearise(state, mean)
    data = LocalLikelihood(marginal(state)[0], gradient(state, mean), mean)
    return _fitted(state, select_row_shift_size(state, data, start, gauge), gauge, mean), test


def _same(first: Hyperparameters, second: Hyperparameters) -> bool:
    return abs(np.log(first.noise_scale / second.noise_scale)) < CONVERGENCE_TOLERANCE


def _as_it_is(state: EstimatorState) -> EstimatorState:
    return state


def _robust(fitted: _Fitted, gauge: NDArray[np.float64]) -> _Fitted:
    """Fit again with Huber weights of the block means if any is an outlier. Outliers within a block are excluded from its mean before."""
    state = fitted.state
    for _ in range(HUBER_PASSES):
        limit = HUBER * fitted.hyper.noise_scale
        misfit = iter(residuals(fitted.state, fitted.mean))
        retained, any_far = list[MapObservations](), False
        for rows in state.rows:
            far = np.abs(next(misfit)) * np.sqrt(rows.weight) if rows.weight.any() else np.zeros_like(rows.weight)
            retained.append(replace(rows, weight=rows.weight * (limit / np.maximum(far, limit))) if (far > limit).any() else rows)
            any_far = any_far or bool((far > limit).any())
        if not any_far:
            return fitted
        fitted = _fitted(reweight(fitted.state, tuple(retained)), fitted.hyper, gauge, fitted.mean)
    return fitted


def _coupling(fitted: _Fitted, gauge: NDArray[np.float64]) -> TermTest:
    state, hyper = fitted.state, fitted.hyper
    return distortion_advection(state, fitted.data, fitted.mean, prior_precision(state, hyper) + gauge, hyper.noise_scale)


def posterior(data: Information, prior: NDArray[np.float64], noise_scale: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(n,) posterior mean and (n, n) lower Cholesky factor of its precision, for information at unit noise scale."""
    factor = cholesky(regularise(data[0] * noise_scale**-2.0 + prior))
    return cho_solve((factor, True), data[1] * noise_scale**-2.0, check_finite=False), factor


def mean_with(state: EstimatorState, hyper: Hyperparameters) -> NDArray[np.float64]:
    """(n,) posterior mean with given smoothness and the noise scale estimated with it."""
    return _first_mean(state, hyper, gauge_precision(state))


def _first_mean(state: EstimatorState, start: Hyperparameters, gauge: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean with the prior smoothness and the noise scale estimated with it.

    With the noise reported by the DIC instead, a misfit a hundred times larger (no noise, wrong advection) caused a drift error of 170 px.
    """
    prior, (precision, information), scale = prior_precision(state, start) + gauge, marginal(state), 1.0
    mean = factorise(precision + prior, sides(state)).solve(information)
    for _ in range(MAX_INITIAL_ITERATIONS):
        data = LocalLikelihood(precision, gradient(state, mean), mean)
        mean, factor = _posterior_about(state, data, prior, scale)
        found, _ = estimated_noise(state, precision, replace(start, noise_scale=scale), mean, factor)
        if found < NOISE_SCALE_JUMP * scale:
            break
        scale = found
    return mean


def _posterior_about(
    state: EstimatorState, data: LocalLikelihood, prior: NDArray[np.float64], noise_scale: float
) -> tuple[NDArray[np.float64], ArrowheadFactor]:
    """Mean and factor from data linearised about a point. The result is exact because the step is small."""
    believed = data.scaled(noise_scale**-2.0).with_prior(prior)
    factor = factorise(believed.precision, sides(state))
    return data.linearisation_point + factor.solve(believed.gradient), factor
