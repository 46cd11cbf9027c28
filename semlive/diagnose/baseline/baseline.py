"""The baseline: drift, distortion and motion of the estimator, the effects identified so far, and the residual of the data."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from semlive.diagnose.baseline.design_matrix import DesignMatrix
from semlive.diagnose.baseline.priors import SMOOTH_DRIFT_PRIORS, BaselinePrior, DriftPrior
from semlive.diagnose.parallel import WORKERS, parallel_map
from semlive.estimate.joint.elimination.arrowhead import ArrowheadFactor, ComponentBlocks, factorise
from semlive.estimate.joint.observations.priors import Hyperparameters
from semlive.estimate.joint.selection.marginal_likelihood import log_prior

Array = NDArray[np.float64]

FREE_DISTORTION_FACTOR = 10.0
PRIOR_LOG_SD = 4.0  # of the logarithm of a smoothness, relative to that of the first solution
DISTORTION_SMOOTHNESS_FACTORS = (0.3, 1.0, 3.0)
# Of the matrices of all points: a baseline of 1,100 parameters has 13 points, one of 2,200 has 3. With 1.2 GB a run whose drift walks
# by 0.04 px within frames of 180 s (2,281 parameters, 6 points) needed 231 s of processor time and 3.3 GB.
MAX_GRID_BYTES = 250_000_000
MAX_LOG_ODDS_DEFICIT = 40.0  # drift priors that are less likely by more than this are left out of the grid


@dataclass(frozen=True, slots=True, eq=False)
class HyperparameterPoint:
    """Posterior of the baseline for one smoothness.

    Attributes:
        hyper: the smoothness.
        factor: factor of the posterior precision.
        evidence: log marginal likelihood, up to a constant common to all points.
        occam_factor: the Occam factor, the negative part of the evidence due to the prior volume.
        gradient: (p + r,) gradient of the log posterior at the first solution.
        half_solved_gradient: (p + r,) forward substitution of the gradient.
        prior_choice: prior of the drift, and roughness of the distortion relative to the first choice; None for joined runs.
    """

    hyper: Hyperparameters
    factor: ArrowheadFactor
    evidence: float
    occam_factor: float
    gradient: Array
    half_solved_gradient: Array
    prior_choice: tuple[DriftPrior, float] | None = None

    def half(self, right: Array) -> Array:
        """(p + r, ...) forward substitution; products of two results are quadratic forms of the posterior covariance."""
        return self.factor.half(right)

    def solve(self, right: Array) -> Array:
        """(p + r, q) posterior covariance times (p + r, q)."""
        return self.factor.solve(right)


@dataclass(frozen=True, slots=True, eq=False)
class HyperparameterGrid:
    """The baseline evaluated on the data for several smoothness values.

    Attributes:
        design: the columns.
        whitened_residual: (f, b, 2) whitened residual of the first solution.
        points: one point per drift prior, the smoothest first.
    """

    design: DesignMatrix
    whitened_residual: Array
    points: tuple[HyperparameterPoint, ...]

    @property
    def best(self) -> HyperparameterPoint:
        """The most likely point."""
        return max(self.points, key=lambda candidate: candidate.evidence)

    @property
    def best_prior(self) -> Array:
        """(p + r, p + r) prior precision of the most likely point, assembled at each call: one at every point would take 0.2 GB."""
        return joint_prior(self.design, *self.best_choice).precision

    @property
    def best_choice(self) -> tuple[DriftPrior, float]:
        """Prior of the drift and roughness of the distortion of the most likely point.

        Raises:
            ValueError: the grid is of joined runs.
        """
        if self.best.prior_choice is None:
            raise ValueError("runs that were joined have no smoothness of one run")
        return self.best.prior_choice

    @property
    def evidence(self) -> float:
        """Log marginal likelihood, summed over the points."""
        return float(np.logaddexp.reduce([point.evidence for point in self.points]))

    @property
    def log_evidence(self) -> float:
        """Log marginal likelihood in px instead of noise units, comparable between solutions of the same maps."""
        whiten, f = self.design.whiten, self.design.observation.frames
        volume = len(whiten.factor) * np.log(whiten.sigma_px) + np.sum(np.log(np.diag(whiten.factor)))
        return float(self.evidence - 2.0 * (f - 1) * volume - whiten.half_log_det)

    def residual(self) -> Array:
        """(f, b, 2) whitened residual of the most likely baseline."""
        step = self.best.solve(self.best.gradient[:, None])
        return self.whitened_residual - self.design.apply(step)[..., 0]


def build_grid(columns: DesignMatrix) -> HyperparameterGrid:
    """Evaluate, for each drift prior, the most likely smoothness of the distortion.

    Points with negligible likelihood are left out, and further ones of a baseline whose points would need too much memory.
    """
    evaluator = _PointEvaluator.of(columns)
    likely = _likely_points(evaluator, columns.priors.different())

    def most_likely(drift: DriftPrior) -> HyperparameterPoint:
        candidates = chain((likely.pop(drift),), evaluator.with_distortion_priors(drift))
        return max(candidates, key=_evidence)  # taken one by one: only the most likely so far remains in memory

    return HyperparameterGrid(columns, evaluator.residual, tuple(parallel_map(most_likely, tuple(likely))))


def _likely_points(evaluator: _PointEvaluator, priors: Sequence[DriftPrior]) -> dict[DriftPrior, HyperparameterPoint]:
    """Points of the priors that a grid contains.

    Those with negligible likelihood are dropped on the way: of 13 points of 76 MB each, a baseline of 2,181 parameters has 7 in the end.
    """
    scores, points = dict[DriftPrior, tuple[float, float]](), dict[DriftPrior, HyperparameterPoint]()
    for first in range(0, len(priors), WORKERS):
        for drift, point in parallel_map(lambda drift: (drift, evaluator.point(drift, 1.0)), priors[first : first + WORKERS]):
            scores[drift], points[drift] = (point.evidence, point.occam_factor), point
        points = {drift: points[drift] for drift in _not_negligible(scores) if drift in points}
    retained = _at_most(MAX_GRID_BYTES // (16 * evaluator.columns.size**2), {drift: scores[drift] for drift in _not_negligible(scores)})
    return {drift: points[drift] if drift in points else evaluator.point(drift, 1.0) for drift in retained}


def _at_most(count: int, scores: Mapping[DriftPrior, tuple[float, float]]) -> list[DriftPrior]:
    """The most likely prior, then smoother ones, evenly spread, then the most likely others: at least one and at most `count`."""
    if len(scores) <= count:
        return list(scores)
    likely = sorted(scores, key=lambda drift: scores[drift][0], reverse=True)
    smoother = sorted((drift for drift in likely if scores[drift][1] > scores[likely[0]][1]), key=lambda drift: scores[drift][1])
    places = np.linspace(len(smoother) - 1, 0, min(max(count - 1, 0), len(smoother))).round().astype(int)
    chosen = dict.fromkeys([likely[0], *(smoother[place] for place in places), *likely])
    return list(chosen)[: max(count, 1)]


def _not_negligible(scores: Mapping[DriftPrior, tuple[float, float]]) -> list[DriftPrior]:
    """Priors with evidence near the largest, and smoother ones, by evidence and Occam factor: an effect may make them more likely."""
    best, best_occam = max(scores.values())
    return [drift for drift, (evidence, occam) in scores.items() if evidence > best - MAX_LOG_ODDS_DEFICIT or occam > best_occam]


def _evidence(point: HyperparameterPoint) -> float:
    return point.evidence


def best_point(columns: DesignMatrix) -> HyperparameterGrid:
    """Grid of one point: the most likely smoothness of the drift, then of the distortion."""
    evaluator = _PointEvaluator.of(columns)
    points_by_prior = dict(parallel_map(lambda candidate: (candidate, evaluator.point(candidate, 1.0)), columns.priors.different()))
    best = max(points_by_prior, key=lambda candidate: points_by_prior[candidate].evidence)
    return HyperparameterGrid(
        columns,
        evaluator.residual,
        (max((points_by_prior[best], *evaluator.with_distortion_priors(best)), key=lambda candidate: candidate.evidence),),
    )


def prior_point(columns: DesignMatrix) -> HyperparameterGrid:
    """Grid of one point with the smoothness of the first solution."""
    evaluator = _PointEvaluator.of(columns)
    return HyperparameterGrid(columns, evaluator.residual, (evaluator.point(DriftPrior(1.0), 1.0),))


def point_like(columns: DesignMatrix, like: HyperparameterGrid) -> HyperparameterGrid:
    """Grid of one point with the most likely smoothness of another grid.

    Raises:
        ValueError: the other grid is of joined runs.
    """
    evaluator = _PointEvaluator.of(columns)
    return HyperparameterGrid(columns, evaluator.residual, (evaluator.point(*like.best_choice),))


def with_free_distortion(columns: DesignMatrix) -> HyperparameterGrid:
    """Grid of one point: the most likely smoothness of the drift, with a distortion prior much wider than selected.

    A real distortion is not a sample of its prior. With the selected prior, one in five runs of five pairs had significant
    distortion terms.
    """
    evaluator = _PointEvaluator.of(columns)
    return HyperparameterGrid(
        columns,
        evaluator.residual,
        (max((evaluator.point(value, FREE_DISTORTION_FACTOR) for value in SMOOTH_DRIFT_PRIORS), key=lambda candidate: candidate.evidence),),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _PointEvaluator:
    """Data common to all smoothness values."""

    columns: DesignMatrix
    first_solution: Array
    residual: Array
    data_gradient: Array
    power: float

    @classmethod
    def of(cls, columns: DesignMatrix) -> _PointEvaluator:
        first_solution = np.concatenate(
            (columns.observation.solution.mean[columns.parameter_indices], np.zeros(columns.size - len(columns.parameter_indices)))
        )
        residual = columns.whiten(columns.observation.disparity_px) - columns.apply(first_solution[:, None])[..., 0]
        return cls(columns, first_solution, residual, columns.transposed(residual[..., None])[:, 0], float(np.sum(residual**2)))

    def point(self, drift: DriftPrior, roughness_factor: float) -> HyperparameterPoint:
        columns, own = self.columns, self.columns.priors.components
        prior = joint_prior(columns, drift, roughness_factor)
        components = replace(own, shared=np.concatenate((own.shared, np.arange(len(columns.parameter_indices), columns.size))))
        log_prior_density = log_prior(np.array([drift.bend_factor or 1.0]), (1.0, PRIOR_LOG_SD)) + log_prior(
            np.array([roughness_factor]), (1.0, PRIOR_LOG_SD)
        )
        point = evaluate_point(
            columns.normal_matrix,
            (prior.precision, prior.half_log_det),
            self.data_gradient,
            self.power,
            self.first_solution,
            prior.hyper,
            float(log_prior_density[0]),
            components,
        )
        return replace(point, prior_choice=(drift, roughness_factor))

    def with_distortion_priors(self, drift: DriftPrior) -> Iterator[HyperparameterPoint]:
        """Points with other smoothness values of the distortion than the first solution."""
        return (self.point(drift, roughness_factor) for roughness_factor in DISTORTION_SMOOTHNESS_FACTORS if roughness_factor != 1.0)


def joint_prior(columns: DesignMatrix, drift: DriftPrior, roughness_factor: float) -> BaselinePrior:
    """Prior of the parameters of the baseline and of the amplitudes of its r effects: p + r parameters."""
    own = columns.priors.prior(drift, roughness_factor)
    p, r = len(own.precision), len(columns.sizes_px)
    if not r:
        return own
    total = np.zeros((p + r, p + r))
    total[:p, :p] = own.precision
    total[range(p, p + r), range(p, p + r)] = columns.sizes_px**-2.0
    return BaselinePrior(own.hyper, total, own.half_log_det - float(np.sum(np.log(columns.sizes_px))))


def evaluate_point(
    normal: Array,
    prior: tuple[Array, float],
    data_gradient: Array,
    power: float,
    first_solution: Array,
    hyper: Hyperparameters,
    log_prior_density: float,
    components: ComponentBlocks,
) -> HyperparameterPoint:
    """Evaluate a baseline of p parameters from the residual of a first solution.

    Args:
        normal: (p, p) A^T A.
        prior: (p, p) prior precision, and half its log determinant.
        data_gradient: (p,) A^T times the whitened residual of the first solution.
        power: sum of squares of this residual.
        first_solution: (p,) the first solution.
        hyper: the smoothness.
        log_prior_density: log prior density of the smoothness.
        components: component blocks of the parameters.
    """
    factor = factorise(normal + prior[0], components, 0.0)
    prior_gradient = prior[0] @ first_solution
    posterior_gradient = data_gradient - prior_gradient
    half_gradient = factor.half(posterior_gradient)
    volume = prior[1] - factor.half_log_det
    fit = power + float(first_solution @ prior_gradient) - float(half_gradient @ half_gradient)
    return HyperparameterPoint(hyper, factor, volume - 0.5 * fit + log_prior_density, volume, posterior_gradient, half_gradient)
