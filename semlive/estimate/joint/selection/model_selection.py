"""Selection of optional terms from the data: magnification and rotation of the raster, and advection of the distortion by the drift."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from semlive.data.drift import FrameTime, TermTest
from semlive.estimate.joint.elimination.arrowhead import factorise, sides
from semlive.estimate.joint.observations.design_columns import add_transposed_product, predicted
from semlive.estimate.joint.observations.priors import Hyperparameters, prior_precision, raster_prior, rotation_indices
from semlive.estimate.joint.observations.state import EstimatorState, MapObservations
from semlive.estimate.joint.selection.marginal_likelihood import (
    ROTATION_CANDIDATES,
    ROTATION_PRIOR,
    LocalLikelihood,
    log_prior,
    marginal_of,
)
from semlive.model import RasterChange, RasterTerm, sighting

RASTER_CANDIDATES = 10.0 ** np.arange(-3.0, 1.01, 0.5)  # px at half the image's width, second difference from knot to knot
# Natural logarithm of how much likelier the data must become: a Bayes factor of 400 comes by chance in less than one run of 400 (Ville).
# A drift of the magnification by 5e-4 reaches 4,000 and more with correlated noise.
MIN_BAYES_FACTOR = 6.0
COUPLING_SIGMAS = 4.0


def raster_terms(
    state: EstimatorState, data: LocalLikelihood, hyper: Hyperparameters, gauge: NDArray[np.float64]
) -> tuple[Hyperparameters, tuple[TermTest, ...]]:
    """Test the raster terms and select their sizes.

    Each term is tested after marginalising all other parameters. The noise is that of blocks of subset size, so that overlapping subsets
    count once.
    """
    where = sides(state)
    baseline, tests = data.scaled(hyper.noise_scale**-2.0).with_prior(gauge), []
    for number, change in enumerate(state.raster):
        part = state.layout.part(change.name)
        off = _sized(hyper, number, 0.0)
        own = marginal_of(baseline, prior_precision(state, off), where, np.arange(part.start, part.stop))
        still = _from_zero(own, part.stop - part.start)
        if change.term is RasterTerm.ROTATION:
            gains, turns = _gains_of_rotation(state, baseline, off, change, gauge[part, part])
        else:
            gains = np.array([_gain(still, raster_prior(change, size), gauge[part, part]) for size in RASTER_CANDIDATES])
            turns = np.full(len(gains), hyper.rotation_rad)
        best = int(np.argmax(gains))
        used = bool(gains[best] > MIN_BAYES_FACTOR)
        hyper = replace(_sized(hyper, number, float(RASTER_CANDIDATES[best])), rotation_rad=float(turns[best])) if used else off
        tests.append(TermTest(change.name, used, _f_ratio(still), float(gains[best])))
    return hyper, tuple(tests)


def _sized(hyper: Hyperparameters, number: int, size_px: float) -> Hyperparameters:
    sizes = [size_px if at == number else value for at, value in enumerate(hyper.raster_px)]
    return replace(hyper, raster_px=(sizes[0], sizes[1]))


def _gains_of_rotation(
    state: EstimatorState, baseline: LocalLikelihood, off: Hyperparameters, change: RasterChange, gauge: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Log likelihood gain for each size of the raster rotation, and the corresponding size of the specimen rotation.

    From pair to pair the specimen may rotate instead, so each size is evaluated with the most likely size of the other rotation. With the
    specimen rotation selected without the raster rotation, a raster rotation of 5e-4 rad was missed in twelve of twelve runs.
    """
    part, turning = state.layout.part(change.name), rotation_indices(state)
    at = np.concatenate((np.arange(part.start, part.stop), turning))
    own, count = marginal_of(baseline, prior_precision(state, off), sides(state), at), part.stop - part.start
    order = np.argsort(np.argsort(at))  # the marginal is sorted by parameter
    own = _from_zero(LocalLikelihood(own.precision[np.ix_(order, order)], own.gradient[order], own.linearisation_point[order]), count)
    sizes = np.concatenate(([0.0], RASTER_CANDIDATES))
    turns = ROTATION_CANDIDATES if turning.size else np.array([off.rotation_rad])
    scores = np.zeros((len(sizes), len(turns)))
    data_gauge = np.zeros_like(own.precision)
    data_gauge[:count, :count] = gauge
    for row, size in enumerate(sizes):
        for column, turn in enumerate(turns):
            prior = np.zeros_like(own.precision)
            prior[:count, :count] = raster_prior(change, size)
            prior[count:, count:] = np.eye(len(turning)) * turn**-2.0
            scores[row, column] = _gain(own, prior, data_gauge)
    scores += log_prior(turns, ROTATION_PRIOR)
    return scores[1:].max(axis=1) - scores[0].max(), turns[scores[1:].argmax(axis=1)]


def distortion_advection(
    state: EstimatorState, data: LocalLikelihood, mean: NDArray[np.float64], prior: NDArray[np.float64], noise_scale: float
) -> TermTest:
    """Estimate the advection coefficient gamma of E(R - gamma d) from one column fitted jointly with all other parameters.

    The column is the change of the maps if the drift advected the estimated distortion. All other parameters are free, so they can explain
    the same change.
    """
    own, pulled, across = 0.0, 0.0, np.zeros(len(mean))
    noise, noise_pull = np.zeros((state.blocks.size, 2)), np.zeros((state.blocks.size, 2))
    for rows in state.rows:
        if not rows.weight.any() or not rows.disparity_px.any():
            continue
        column = advection_column(state, rows, mean)
        misfit = rows.disparity_px - predicted(state, rows, mean)
        own += float(np.sum(rows.weight * column**2))
        pulled += float(np.sum(rows.weight * column * misfit))
        add_transposed_product(state, rows, rows.weight * column, across)
        if rows.from_reference:
            noise -= rows.weight * column
            noise_pull -= rows.weight * misfit
    used = state.reference.weight > 0
    per = np.where(used, 1.0 / np.where(used, state.reference.weight, 1.0), 0.0)
    own -= float(np.sum(noise**2 * per))
    pulled -= float(np.sum(noise * noise_pull * per))
    for axis in (0, 1):
        across -= state.reference.coupling[axis].T @ (noise[:, axis] * per[:, axis])
    weight = noise_scale**-2.0
    full = data.scaled(weight).with_prior(prior)
    solved = factorise(full.precision, sides(state)).solve(np.column_stack((across * weight, full.gradient)))
    # `mean` is the best fit of all others, but for rounding, so what they would take over is the step that is left.
    step = full.linearisation_point + solved[:, 1] - mean
    information = own * weight - float(across @ solved[:, 0]) * weight
    gamma = (pulled * weight - float(across @ step) * weight) / information if information > 0 else 0.0
    sigma = information**-0.5 if information > 0 else np.inf
    # A value far from both 0 and 1 indicates another model error, which advection would hide.
    carried = bool(abs(gamma - 1.0) < 0.4 and gamma > COUPLING_SIGMAS * sigma)
    return TermTest("coupling", carried, (gamma / sigma) ** 2, 0.5 * (gamma**2 - (1.0 - gamma) ** 2) / sigma**2, float(gamma), float(sigma))


def advection_column(state: EstimatorState, rows: MapObservations, mean: NDArray[np.float64]) -> NDArray[np.float64]:
    """(blocks, 2) change of a map by advection of the distortion, px, at the centre of each block."""
    here = rows.position_px + state.centre_px
    there = here + rows.disparity_px
    return _carried_at(state, state.frame_time(rows.current), there, mean) - _carried_at(
        state, state.frame_time(rows.reference), here, mean
    )


def _carried_at(state: EstimatorState, when: FrameTime, at: NDArray[np.float64], mean: NDArray[np.float64]) -> NDArray[np.float64]:
    assert state.drift is not None  # there are rows
    observation = sighting(when, at[:, 0], at[:, 1])
    drift = state.drift.rows(observation.visit_time_s.mean(axis=0)) @ mean[state.layout.part("drift")].reshape(-1, 2)
    bend = mean[state.layout.part("distortion")]
    before = at - drift
    return state.distortion.field(bend, before[:, 0], before[:, 1]) - state.distortion.field(bend, at[:, 0], at[:, 1])


def _from_zero(own: LocalLikelihood, count: int) -> LocalLikelihood:
    """The data linearised about a point where the first `count` parameters, those of the tested term, are zero."""
    about = own.linearisation_point.copy()
    about[:count] = 0.0
    return LocalLikelihood(own.precision, own.gradient - own.precision @ (about - own.linearisation_point), about)


def _gain(own: LocalLikelihood, prior: NDArray[np.float64], gauge: NDArray[np.float64]) -> float:
    """Log likelihood gain of a prior about zero relative to the term being absent; the gauge is part of the data."""
    after, pull = own.precision + prior, own.gradient - prior @ own.linearisation_point
    fit = float(pull @ np.linalg.solve(after, pull)) - float(own.linearisation_point @ prior @ own.linearisation_point)
    return 0.5 * (fit + float(np.linalg.slogdet(prior + gauge)[1]) - float(np.linalg.slogdet(after)[1]))


def _f_ratio(own: LocalLikelihood) -> float:
    """Mean square per degree of freedom explained by the term; 1 on average without an effect, for any number of knots."""
    values, vectors = np.linalg.eigh(own.precision)
    determined = values > 1e-3  # the data determine this direction to about 0.1 px or better
    return float(np.mean((own.gradient @ vectors[:, determined]) ** 2 / values[determined])) if determined.any() else 0.0
