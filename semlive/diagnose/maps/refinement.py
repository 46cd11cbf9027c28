"""Refinement of the nonlinear parameters of an effect between the grid values."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from semlive.data.diagnosis.effects import ParameterEstimate
from semlive.diagnose.baseline.baseline import BaselineEffect, HyperparameterGrid
from semlive.diagnose.baseline.bayes_factor import CandidateEvidence, ProjectedField, information, project, sizes_of
from semlive.model.effects import BasisField, EffectClass, NonlinearParameter
from semlive.model.effects.effect_class import Values

Array = NDArray[np.float64]
PASSES, ACROSS, CHOICES = 2, 12, 3
CLOSE = 1e-3  # of the distance between values on the grid
UNOBSERVABLE_PENALTY = 1e12
NEAR, WIDEST = 0.1, 0.5  # steps of the grid: where the curvature is taken, and the posterior at least
REACH, POSTERIOR_LOG_DEPTH = 13, 4.5  # the posterior is followed for so many steps, and to three standard deviations


@dataclass(frozen=True, slots=True, eq=False)
class RefinedEffect:
    """The most likely basis field of an effect class.

    Attributes:
        family: the effect class.
        field: its columns in px and its reported parameters.
        baseline_effect: the whitened columns, ready to be added to the baseline.
        values: nonlinear parameters.
        sigmas: standard uncertainties of the nonlinear parameters.
        amplitudes: (q,) most likely amplitudes.
        covariance: (q, q) covariance of the amplitudes, including `parameter_covariance`.
        parameter_covariance: (q, q) part of the covariance due to the uncertainty of the nonlinear parameters.
        log_factor: log Bayes factor at these values, weighted over smoothness and size, minus the cost of the parameter range.
    """

    family: EffectClass
    field: BasisField
    baseline_effect: BaselineEffect
    values: tuple[tuple[str, float], ...]
    sigmas: tuple[float, ...]
    amplitudes: Array
    covariance: Array
    parameter_covariance: Array
    log_factor: float

    @property
    def field_px(self) -> Array:
        """(f, b, 2, q) in px for unit amplitudes."""
        return self.field.field_px

    @property
    def peak_px(self) -> float:
        """The largest displacement since frame 0 of any block."""
        moved = self.field_px @ self.amplitudes
        return float(np.max(np.hypot(*np.moveaxis(moved - moved[0], -1, 0))))

    @property
    def parameters(self) -> tuple[ParameterEstimate, ...]:
        """Reported parameters: amplitudes and nonlinear parameters in physical units."""
        values = dict(self.values)
        own = [
            ParameterEstimate(nonlinear_parameter.name, values[nonlinear_parameter.name], sigma, nonlinear_parameter.unit)
            for nonlinear_parameter, sigma in zip(self.family.nonlinear_parameters, self.sigmas, strict=True)
        ]
        return (*reported_parameters(self.field, self.amplitudes, self.covariance), *own)


def refined(baseline: HyperparameterGrid, candidate: CandidateEvidence) -> RefinedEffect:
    """Refine the most likely basis field of a class one parameter at a time; the parameter uncertainty adds to the amplitude covariance."""
    gradient, values = _chosen(baseline, candidate)
    family, basis_field = candidate.family, gradient.law(values)
    mean, covariance = project(gradient.ladder, basis_field.field_px).amplitudes(0, gradient.size_px)
    sigmas, follows = parameter_uncertainty(gradient, values, mean)
    found = BaselineEffect(baseline.design.whiten(basis_field.field_px), gradient.size_px)
    factor = _integrated(baseline, candidate, basis_field, values, sigmas)
    return RefinedEffect(family, basis_field, found, tuple(values.items()), sigmas, mean, covariance + follows, follows, factor)


def _integrated(
    ladder: HyperparameterGrid, weighed: CandidateEvidence, basis_field: BasisField, values: Values, sigmas: Sequence[float]
) -> float:
    """Log Bayes factor over the parameter range, integrated with the refined peak, which may be narrower than the grid spacing."""
    sizes = sizes_of(weighed.family)
    each = (
        project(ladder, basis_field.field_px).log_factor(sizes) + np.array([[point.evidence] for point in ladder.points]) - ladder.evidence
    )
    factor = float(np.logaddexp.reduce(each, axis=None)) - math.log(len(sizes) * len(weighed.projected_fields))
    for nonlinear_parameter, sigma in zip(weighed.family.nonlinear_parameters, sigmas, strict=True):
        steps = (
            sigma / abs(values[nonlinear_parameter.name] * math.log(nonlinear_parameter.step))
            if nonlinear_parameter.ratio
            else sigma / nonlinear_parameter.step
        )
        factor += min(math.log(max(math.sqrt(2.0 * math.pi) * steps, CLOSE)), 0.0)
        if nonlinear_parameter.name not in weighed.values[0]:  # no grid, so it is believed to lie within about a step of nothing
            factor -= 0.5 * (values[nonlinear_parameter.name] / nonlinear_parameter.step) ** 2
    return factor


def refit_jointly(baseline_with_effects: HyperparameterGrid, found: Sequence[RefinedEffect]) -> tuple[RefinedEffect, ...]:
    """Effects with amplitudes fitted jointly; their columns are the last of the baseline."""
    best, count = baseline_with_effects.best, sum(len(effect.amplitudes) for effect in found)
    if not count:
        return ()
    own = slice(baseline_with_effects.design.size - count, None)
    mean, covariance = best.solve(best.gradient[:, None])[own, 0], best.solve(np.eye(baseline_with_effects.design.size)[:, own])[own]
    ends = np.cumsum([len(effect.amplitudes) for effect in found])
    places = [slice(end - len(effect.amplitudes), end) for effect, end in zip(found, ends, strict=True)]
    return tuple(
        replace(effect, amplitudes=mean[at], covariance=covariance[at, at] + effect.parameter_covariance)
        for effect, at in zip(found, places, strict=True)
    )


class CandidateObjective(Protocol):
    """Objective of the basis fields of a class for a fixed prior amplitude size."""

    @property
    def family(self) -> EffectClass:
        """Which."""
        ...

    @property
    def size_px(self) -> float:
        """Of the amplitudes."""
        ...

    def grid(self) -> Iterable[Values]:
        """The values that were tried."""
        ...

    def evaluate(self, values: Values) -> ProjectedField | None:
        """Basis field at parameter values, projected on the data; None if it is not observable."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class LinearParameterSums:
    """Precomputed sums for basis fields that are linear in their parameters.

    A distortion drift has four such parameters and took two thirds of the time of all refinements.

    Attributes:
        thetas: names of the parameters.
        information: (rungs, (1 + t) q, (1 + t) q) information: at zero parameters, then the change per unit of each parameter.
        pull: (rungs, (1 + t) q) gradient.
    """

    thetas: tuple[str, ...]
    information: Array
    pull: Array

    @classmethod
    def of(cls, ladder: HyperparameterGrid, family: EffectClass) -> LinearParameterSums | None:
        """Against all rungs; None for laws that are not linear."""
        if not family.linear_in_parameters:
            return None
        scene, names = (
            ladder.design.observation.geometry,
            tuple(nonlinear_parameter.name for nonlinear_parameter in family.nonlinear_parameters),
        )
        nothing, *each = (family.basis_field(scene, values) for values in ({}, *({name: 1.0} for name in names)))
        assert nothing is not None  # it was seen on the grid
        more = [displaced.field_px - nothing.field_px for displaced in each if displaced is not None]
        return cls(names, *information(ladder, np.concatenate((nothing.field_px, *more), axis=-1)))

    def at_point(self, place: int) -> LinearParameterSums:
        """Against one of the rungs."""
        return replace(self, information=self.information[place : place + 1], pull=self.pull[place : place + 1])

    def at(self, values: Values) -> ProjectedField:
        """The law with such values."""
        shares = np.array([[1.0, *(values[name] for name in self.thetas)]])
        mix = np.kron(shares.T, np.eye(self.pull.shape[1] // shares.size))
        return ProjectedField.of(mix.T @ self.information @ mix, self.pull @ mix)


@dataclass(frozen=True, slots=True, eq=False)
class _Asked:
    """Objective for one point of the baseline grid."""

    ladder: HyperparameterGrid
    family: EffectClass
    size_px: float
    sums: LinearParameterSums | None

    @classmethod
    def of(cls, ladder: HyperparameterGrid, weighed: CandidateEvidence, sums: LinearParameterSums | None, at: tuple[int, int]) -> _Asked:
        """A rung, and one of the sizes."""
        point_grid = replace(ladder, points=(ladder.points[at[0]],))
        return cls(point_grid, weighed.family, float(sizes_of(weighed.family)[at[1]]), sums and sums.at_point(at[0]))

    def grid(self) -> Iterable[Values]:
        return self.family.grid(self.ladder.design.observation.geometry)

    def law(self, values: Values) -> BasisField:
        basis_field = self.family.basis_field(self.ladder.design.observation.geometry, values)
        assert basis_field is not None  # it was seen on the grid
        return basis_field

    def evaluate(self, values: Values) -> ProjectedField | None:
        if self.sums is not None:
            return self.sums.at(values)
        basis_field = self.family.basis_field(self.ladder.design.observation.geometry, values)
        return None if basis_field is None else project(self.ladder, basis_field.field_px)


def _score(objective: CandidateObjective, projected_field: ProjectedField) -> float:
    return float(projected_field.log_factor(np.array([objective.size_px]))[0, 0])


def _chosen(ladder: HyperparameterGrid, weighed: CandidateEvidence) -> tuple[_Asked, dict[str, float]]:
    """Parameters between the grid values, and the most likely smoothness and size with them.

    On the grid a large jump is displaced from its true time, which only the roughest drift permits. With that drift retained, a
    hidden jump of
    (0.30, 0.40) px was estimated as (0.31, 0.26) px.
    """
    (law_at, *at), sums = weighed.best, LinearParameterSums.of(ladder, weighed.family)
    values = {nonlinear_parameter.name: 0.0 for nonlinear_parameter in weighed.family.nonlinear_parameters} | weighed.values[law_at]
    for _ in range(CHOICES):
        objective = _Asked.of(ladder, weighed, sums, (at[0], at[1]))
        values, before = optimise_parameters(objective, values), at
        each = project(ladder, objective.law(values).field_px).log_factor(sizes_of(weighed.family))
        factors = each + np.array([[point.evidence] for point in ladder.points])
        at = [int(value) for value in np.unravel_index(int(np.argmax(factors)), factors.shape)]
        if at == before:
            break
    return _Asked.of(ladder, weighed, sums, (at[0], at[1])), values


@dataclass(frozen=True, slots=True, eq=False)
class _Line:
    """Laws with one parameter on either side of a value, by the distance in steps of the grid; it ends half a step beyond the grid."""

    asked: CandidateObjective
    values: dict[str, float]
    theta: NonlinearParameter
    low: float
    high: float

    @classmethod
    def of(cls, objective: CandidateObjective, values: dict[str, float], theta: NonlinearParameter) -> _Line:
        on_grid = [value[theta.name] for value in objective.grid() if theta.name in value]
        if not on_grid:
            return cls(objective, values, theta, -np.inf, np.inf)
        about = values[theta.name]
        ways = [
            math.log(value / about, theta.step) if theta.ratio else (value - about) / theta.step for value in (min(on_grid), max(on_grid))
        ]
        return cls(objective, values, theta, min(ways[0] - 0.5, 0.0), max(ways[1] + 0.5, 0.0))

    def at(self, way: float) -> float:
        start = self.values[self.theta.name]
        return start * self.theta.step**way if self.theta.ratio else start + self.theta.step * way

    def against(self, way: float) -> ProjectedField | None:
        return self.asked.evaluate({**self.values, self.theta.name: self.at(way)})

    def score(self, way: float) -> float:
        projected_field = self.against(way)
        return -UNOBSERVABLE_PENALTY if projected_field is None else _score(self.asked, projected_field)


def optimise_parameters(objective: CandidateObjective, start: Values) -> dict[str, float]:
    """Most likely parameter values between the neighbouring grid values."""
    values = dict(start)
    for _ in range(PASSES):
        for theta in objective.family.nonlinear_parameters:
            line = _Line.of(objective, values, theta)
            found: Any = minimize_scalar(
                lambda way, line=line: -line.score(float(way)),
                bounds=(max(line.low, -1.0), min(line.high, 1.0)),
                method="bounded",
                options={"xatol": CLOSE, "maxiter": ACROSS},
            )
            values[theta.name] = line.at(float(found.x))
    return values


def parameter_uncertainty(objective: CandidateObjective, values: dict[str, float], mean: Array) -> tuple[tuple[float, ...], Array]:
    """Standard uncertainties of the nonlinear parameters, and the resulting (q, q) covariance of the amplitudes."""
    found = [_left_open(_Line.of(objective, values, theta), mean) for theta in objective.family.nonlinear_parameters]
    return tuple(sigma for sigma, _ in found), np.sum([also for _, also in found] or [np.zeros((len(mean),) * 2)], axis=0)


def _left_open(line: _Line, mean: Array) -> tuple[float, Array]:
    """Standard uncertainty of a parameter, and the resulting (q, q) covariance of the amplitudes, integrated over its posterior.

    A change of a tenth in the log onset time changes creep by a tenth. With the onset treated as known, amplitudes of creep
    deviated by 2.2 to
    5.5 standard uncertainties in 12 of 12 runs. The posterior is wider than the curvature at its peak indicates.
    """
    top = line.score(0.0)
    bend = 2.0 * top - line.score(-NEAR) - line.score(NEAR)
    distance = min(0.5 * NEAR / math.sqrt(bend), WIDEST) if bend > 0.0 else WIDEST
    total, square, outer = 1.0, 0.0, np.zeros((len(mean),) * 2)
    for way in (distance, -distance):
        for place in range(1, REACH):
            projected_field = line.against(way * place) if line.low <= way * place <= line.high else None
            if projected_field is None or (score := _score(line.asked, projected_field) - top) < -POSTERIOR_LOG_DEPTH:
                break
            weight, leaning = math.exp(score), projected_field.amplitudes(0, line.asked.size_px)[0] - mean
            total, square = total + weight, square + weight * (line.at(way * place) - line.at(0.0)) ** 2
            outer += weight * np.outer(leaning, leaning)
    return math.sqrt(square / total), outer / total


def reported_parameters(basis_field: BasisField, mean: Array, covariance: Array) -> tuple[ParameterEstimate, ...]:
    """Reported parameters from the amplitudes (q,) of a basis field and their covariance (q, q)."""
    parameters = [
        ParameterEstimate(
            reported_parameter.name,
            float(reported_parameter.row @ mean),
            float(np.sqrt(reported_parameter.row @ covariance @ reported_parameter.row)),
            reported_parameter.unit,
        )
        for reported_parameter in basis_field.reported_parameters
    ]
    if basis_field.random_amplitude is not None:
        name, unit, factor = basis_field.random_amplitude
        square = float(np.mean(mean**2 + np.diag(covariance)))
        slope = mean / (len(mean) * math.sqrt(square))
        sampling = square / (2.0 * len(mean))
        parameters.append(
            ParameterEstimate(name, factor * math.sqrt(square), factor * math.sqrt(float(slope @ covariance @ slope) + sampling), unit)
        )
    return tuple(parameters)
