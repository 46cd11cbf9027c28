"""Priors of drift and distortion for the diagnosis: candidate smoothness values and their precision matrices."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from semlive.diagnose.baseline.observation import Observation
from semlive.estimate.joint.elimination.arrowhead import ComponentBlocks, cholesky, factorise, sides
from semlive.estimate.joint.observations.priors import Hyperparameters, Smoothness, gauge_precision, prior_precision, smoothness_precision
from semlive.model.drift import DriftSpline

Array = NDArray[np.float64]

SMOOTHEST_PX, WIDEST_PX = 3e-4, 100.0  # beyond these, the prior precision has no Cholesky factor in double precision
ROUGHEST_PX = 1.0  # of a drift, from knot to knot, as in the estimator: a drift with 75 px followed the residual of a bending
ROTATION_FLOOR_RAD = 1e-9  # rotation of the specimen with each move is an effect of the dictionary (stage_yaw)
WALK_LEVEL_PRECISION_RATIO = 1e-6  # precision of the level of a random walk, relative to that of its steps
TIME_CONSTANT_RATIO = 1.6  # of neighbouring time constants of a relaxation, from two knots to the length of the run


@dataclass(frozen=True, slots=True)
class DriftPrior:
    """Candidate prior of the drift.

    Attributes:
        bend_factor: typical curvature relative to the first choice; 0 for the smoothest drift.
        random_walk_px: standard deviation of the step of an additional random walk between knots, px.
        relaxation_px: standard deviation of the amplitude of additional exponential decays from the start of the run, px.
    """

    bend_factor: float
    random_walk_px: float = 0.0
    relaxation_px: float = 0.0


# The first solution selected its smoothness with the effect in the data: a hidden jump makes the drift rough, and a rough drift absorbs the
# jump. Therefore every test also uses smoother and rougher drifts, and the most likely result counts.
SMOOTH_DRIFT_PRIORS = tuple(DriftPrior(by) for by in (0.01, 0.1, 1.0, 10.0, 100.0))
# Curvature of one size does not describe a random walk. In runs with a drift of 0.01 px/s^0.5, a random walk added to a smooth drift was
# more likely by log odds of 130 to 150. Without it, oscillations with periods of 61 to 62 s were identified, which only held-out pairs
# rejected.
RANDOM_WALK_PRIORS = tuple(DriftPrior(0.0, wander_px) for wander_px in (0.0, 0.01, 0.03, 0.1, 0.3, 1.0))
# A drift that relaxes from the start of a run has its curvature there. In one of ten runs without an effect decays after steps were more
# likely than a drift of one curvature, by log odds of up to 33.
RELAXATION_PRIORS = tuple(DriftPrior(0.0, relaxation_px=amplitude_px) for amplitude_px in (1.0, 10.0))
DRIFTS = (*SMOOTH_DRIFT_PRIORS, *RANDOM_WALK_PRIORS, *RELAXATION_PRIORS)


@dataclass(frozen=True, slots=True, eq=False)
class BaselinePrior:
    """Prior of the parameters of the baseline.

    Attributes:
        hyper: the smoothness.
        precision: (p, p) prior precision.
        half_log_det: half the log determinant of the precision.
    """

    hyper: Hyperparameters
    precision: Array
    half_log_det: float


@dataclass(frozen=True, slots=True, eq=False)
class PriorCache:
    """Cached priors of one observation, reused when the noise is scaled or an effect is added.

    Attributes:
        observation: the observation.
        parameters: (p,) joint parameters of the estimator contained in the baseline.
        components: component blocks of these parameters.
        gauge: (p, p) precision independent of the smoothness.
        drifts: precisions of the drift alone; storing them saves a seventh of the time of a verdict. Complete ones took 0.4 GB.
        first: the complete precision of the first prior, which differs from the others of the same distortion in the drift only.
        half_log_dets: half the log determinants of the parts of a prior, which are independent of each other. There are three
            distortions for a dozen drifts; factorising each combination took a twelfth of the time of a verdict.
        distortions: precisions of the distortion alone by its roughness factor, without the gauge.
    """

    observation: Observation
    parameters: NDArray[np.int64]
    components: ComponentBlocks
    gauge: Array
    drifts: dict[DriftPrior, Array] = field(default_factory=dict)
    first: list[Array] = field(default_factory=list)
    half_log_dets: dict[tuple[str, DriftPrior | float | None], float] = field(default_factory=dict)
    distortions: dict[float, Array] = field(default_factory=dict)

    @classmethod
    def of(cls, observation: Observation, retained: NDArray[np.int64]) -> PriorCache:
        """An empty cache."""
        full = sides(observation.state)
        own = ComponentBlocks(*(np.flatnonzero(np.isin(retained, value)) for value in (*full.own, full.shared)))
        return cls(observation, retained, own, gauge_precision(observation.state)[np.ix_(retained, retained)])

    def prior(self, drift: DriftPrior, roughness_factor: float) -> BaselinePrior:
        """Prior with a distortion rougher by a factor than the first choice."""
        hyper = self._hyper(drift, roughness_factor)
        precision = self._with_drift(drift)
        if roughness_factor != 1.0:
            self._set_distortion(precision, roughness_factor, hyper)
        half_log_det = sum(
            self._half_log_det(precision, part, key) for part, key in (("distortion", roughness_factor), ("drift", drift), ("others", None))
        )
        scaled = hyper if drift.bend_factor else replace(hyper, drift=_scaled(self.observation.solution.hyper.drift, 1.0))
        return BaselinePrior(scaled, precision, half_log_det)

    def different(self) -> list[DriftPrior]:
        """Distinct drift priors, that of the first choice first."""
        first = self.observation.solution.hyper.drift
        by_kind = {}
        for drift in sorted(DRIFTS, key=lambda candidate: abs(math.log(candidate.bend_factor or 1.0))):
            by_kind.setdefault((_drift_of(first, drift), drift.random_walk_px, drift.relaxation_px), drift)
        return list(by_kind.values())

    def _hyper(self, drift: DriftPrior, roughness_factor: float) -> Hyperparameters:
        first = self.observation.solution.hyper
        return replace(
            first,
            noise_scale=1.0,
            rotation_rad=ROTATION_FLOOR_RAD,
            raster_px=(0.0, 0.0),
            drift=_drift_of(first.drift, drift),
            distortion=_scaled(first.distortion, roughness_factor),
        )

    def _complete(self, drift: DriftPrior, hyper: Hyperparameters) -> Array:
        """Precision of all parameters."""
        precision = prior_precision(self.observation.state, hyper)[np.ix_(self.parameters, self.parameters)]
        precision[np.diag_indices_from(precision)] += WIDEST_PX**-2.0
        for axis in (0, 1):
            at = self._drift_along(axis)
            if drift.random_walk_px:
                precision[np.ix_(at, at)] = with_covariance(precision[np.ix_(at, at)], self._random_walk(drift.random_walk_px))
            if drift.relaxation_px:
                precision[np.ix_(at, at)] = with_terms(precision[np.ix_(at, at)], self._decays(drift.relaxation_px))
        precision += self.gauge
        return precision

    def _with_drift(self, drift: DriftPrior) -> Array:
        """Precision with the distortion of the first choice."""
        part = self._part("drift")
        if drift not in self.drifts:
            precision = self._complete(drift, self._hyper(drift, 1.0))
            if not self.first:  # before the drift, which another thread may find at once
                self.first.append(precision)
            self.drifts[drift] = precision[part, part].copy()
        precision = self.first[0].copy()
        precision[part, part] = self.drifts[drift]
        return precision

    def _set_distortion(self, precision: Array, roughness_factor: float, hyper: Hyperparameters) -> None:
        """Replace the distortion in a precision."""
        part = self._part("distortion")
        if roughness_factor not in self.distortions:
            block = smoothness_precision(self.observation.state.distortion, hyper.distortion)
            block[np.diag_indices_from(block)] += WIDEST_PX**-2.0
            self.distortions[roughness_factor] = block
        np.add(self.distortions[roughness_factor], self.gauge[part, part], out=precision[part, part])

    def _part(self, name: str) -> slice:
        """Range of the parameters of drift or distortion in the baseline, which contains all of them."""
        part = self.observation.state.layout.part(name)
        start = int(np.searchsorted(self.parameters, part.start))
        return slice(start, start + part.stop - part.start)

    def _half_log_det(self, precision: Array, name: str, key: DriftPrior | float | None) -> float:
        """Half the log determinant of one part: the distortion, the drift, or the other parameters."""
        if (name, key) not in self.half_log_dets:
            inside = np.zeros(len(precision), dtype=np.bool_)
            for part in ("distortion", "drift") if name == "others" else (name,):
                inside[self._part(part)] = True
            chosen = inside if name != "others" else ~inside
            blocks = ComponentBlocks(*(at[chosen[at]] for at in (*self.components.own, self.components.shared)))
            self.half_log_dets[name, key] = factorise(precision, blocks, 0.0).half_log_det
        return self.half_log_dets[name, key]

    def _random_walk(self, step_px: float) -> Array:
        """(k, k) covariance of a random walk between the knots, px²."""
        steps = self._drift_spline().roughness(1)
        return np.asarray(np.linalg.inv(steps + WALK_LEVEL_PRECISION_RATIO * np.eye(len(steps))) * step_px**2, dtype=np.float64)

    def _decays(self, amplitude_px: float) -> Array:
        """(k, m) exponential decays between the knots, px; coefficients of a decay are a decay."""
        spline = self._drift_spline().spline
        knots = spline.place(np.arange(spline.size))
        count = max(2, math.ceil(math.log(max(knots[-1] / 2.0, 2.0)) / math.log(TIME_CONSTANT_RATIO)))
        return np.asarray(np.exp(-knots[:, None] / np.geomspace(2.0, max(knots[-1], 4.0), count)) * amplitude_px)

    def _drift_spline(self) -> DriftSpline:
        drift = self.observation.state.drift
        assert drift is not None  # there are pairs
        return drift

    def _drift_along(self, axis: int) -> NDArray[np.int64]:
        """(k,) places of the coefficients of the drift along an axis in the precision."""
        start = self.observation.state.layout.part("drift").start
        return np.searchsorted(self.parameters, start + axis + 2 * np.arange(self._drift_spline().spline.size))


def with_covariance(precision: Array, covariance: Array) -> Array:
    """(k, k) precision of coefficients with a precision and an additional (k, k) covariance, which must not be singular."""
    loose = np.linalg.inv(np.linalg.inv(precision) + covariance)
    return np.asarray(0.5 * (loose + loose.T))


def with_terms(precision: Array, terms: Array) -> Array:
    """(k, k) precision of coefficients with a precision and additional (k, m) terms, each with an amplitude of unit variance.

    It is the product of a factor with itself, because rounding must not make it indefinite. As the inverse of a sum of covariances, in
    runs with a pause of 1000 s the smallest eigenvalue was -8e-4 with a largest of 7e8.

    Raises:
        IllPosed: the precision is not finite or not positive definite.
    """
    factor = cholesky(precision).T
    vectors, size, _ = np.linalg.svd(factor @ terms, full_matrices=False)
    loose = factor - vectors @ ((1.0 - 1.0 / np.hypot(1.0, size))[:, None] * (vectors.T @ factor))
    return np.asarray(loose.T @ loose)


def _drift_of(first: Sequence[Smoothness], drift: DriftPrior) -> tuple[Smoothness, Smoothness]:
    if not drift.bend_factor:
        return Smoothness(3, SMOOTHEST_PX), Smoothness(3, SMOOTHEST_PX)
    x, y = (replace(kind, size_px=min(kind.size_px, ROUGHEST_PX)) for kind in _scaled(first, drift.bend_factor))
    return x, y


def _scaled(kinds: Sequence[Smoothness], by: float) -> tuple[Smoothness, Smoothness]:
    """Smoothness scaled by a factor, without a preferred oscillation, because oscillations are effects to be identified."""
    x, y = (replace(kind, size_px=max(kind.size_px * by, SMOOTHEST_PX), oscillation_period_knots=0.0) for kind in kinds)
    return x, y
