"""Effect classes that are linear in parameters without a grid: all parameters are fitted jointly, without bounds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.bayes_factor import ProjectedField, information
from semlive.model.effects import EffectClass
from semlive.model.effects.effect_class import Values

Array = NDArray[np.float64]

MAX_START_STEPS = 30.0  # an affine part of 3 % is 15 px at the edge of 1024 px
DIFFERENCE_STEPS = 0.1  # for second differences of the posterior
MIN_CURVATURE = 0.1  # of the posterior along any direction, per squared step: a standard deviation of three steps


def log_prior_without_grid(steps: Array) -> float:
    """Log prior density of parameters without a grid, in steps, relative to zero: normal near zero, Cauchy tails.

    A normal prior of one step excluded an affine part of 6 px from the distortion, which the raster of a real instrument has.
    """
    return -float(np.sum(np.log1p(0.5 * steps**2)))


@dataclass(frozen=True, slots=True, eq=False)
class LinearParameterSums:
    """Precomputed sums for basis fields that are linear in their parameters.

    A distortion drift has four such parameters and took two thirds of the time of all refinements.

    Attributes:
        thetas: names of the parameters.
        steps: (t,) prior scale of each parameter.
        information: (points, (1 + t) q, (1 + t) q) information: at zero parameters, then the change per unit of each parameter.
        gradient: (points, (1 + t) q) gradient.
    """

    thetas: tuple[str, ...]
    steps: Array
    information: Array
    gradient: Array

    @classmethod
    def of(cls, baseline: HyperparameterGrid, family: EffectClass) -> LinearParameterSums | None:
        """Sums for all points of a baseline; None for effect classes that are not linear in their parameters."""
        if not family.linear_in_parameters:
            return None
        scene, thetas = baseline.design.observation.geometry, family.nonlinear_parameters
        at_zero, *each = (family.basis_field(scene, values) for values in ({}, *({theta.name: 1.0} for theta in thetas)))
        assert at_zero is not None  # it was observable on the grid
        more = [displaced.field_px - at_zero.field_px for displaced in each if displaced is not None]
        steps = np.array([theta.step for theta in thetas])
        return cls(tuple(theta.name for theta in thetas), steps, *information(baseline, np.concatenate((at_zero.field_px, *more), axis=-1)))

    def at_point(self, place: int) -> LinearParameterSums:
        """Sums for one point."""
        return replace(self, information=self.information[place : place + 1], gradient=self.gradient[place : place + 1])

    def at(self, values: Values) -> ProjectedField:
        """Basis field at parameter values, projected on the data."""
        shares = np.array([[1.0, *(values[name] for name in self.thetas)]])
        mix = np.kron(shares.T, np.eye(self.gradient.shape[1] // shares.size))
        return ProjectedField.of(mix.T @ self.information @ mix, self.gradient @ mix)


@dataclass(frozen=True, slots=True, eq=False)
class LinearPosterior:
    """Posterior of the parameters (t,), in steps, with the amplitudes marginalised.

    Attributes:
        sums: sums of one point.
        size_px: prior standard deviation of the amplitudes, px.
    """

    sums: LinearParameterSums
    size_px: float

    def most_likely(self, start: Values) -> dict[str, float]:
        """Values of the largest posterior density. The parameters are correlated, so a search one at a time needs many passes."""
        starts = (self._steps_of(start), self._separable_start())
        found: list[Any] = [minimize(self._cost, at, method="L-BFGS-B") for at in starts]
        return self._values(min(found, key=lambda result: result.fun).x)

    def spread(self, values: Values) -> tuple[Array, Array, Array]:
        """Spread of the posterior about its maximum.

        The product of a distortion drift and its affine part is determined better than either. With the other parameters fixed, the drift
        deviated by 8 standard uncertainties.

        Returns:
            (t,) standard uncertainty of each parameter, (t,) standard deviations along the principal axes in steps, and the (q, q)
            covariance of the amplitudes that results.
        """
        at, shifts = self._steps_of(values), DIFFERENCE_STEPS * np.eye(len(self.sums.thetas))
        cost = self._cost
        curvature = [[cost(at + a + b) - cost(at + a - b) - cost(at - a + b) + cost(at - a - b) for a in shifts] for b in shifts]
        inverse, axes = np.linalg.eigh(np.array(curvature) / (2.0 * DIFFERENCE_STEPS) ** 2)
        variances, shifts = 1.0 / np.maximum(inverse, MIN_CURVATURE), DIFFERENCE_STEPS * axes.T
        slopes = np.array([self._amplitudes(at + shift) - self._amplitudes(at - shift) for shift in shifts]) / (2.0 * DIFFERENCE_STEPS)
        sigmas = self.sums.steps * np.sqrt(np.sum(axes**2 * variances, axis=1))
        return sigmas, np.sqrt(variances), (slopes.T * variances) @ slopes

    def _steps_of(self, values: Values) -> Array:
        return np.array([values[name] for name in self.sums.thetas]) / self.sums.steps

    def _values(self, at: Array) -> dict[str, float]:
        return dict(zip(self.sums.thetas, (at * self.sums.steps).tolist(), strict=True))

    def _cost(self, at: Array) -> float:
        return -float(self.sums.at(self._values(at)).log_factor(np.array([self.size_px]))[0, 0]) - log_prior_without_grid(at)

    def _amplitudes(self, at: Array) -> Array:
        return self.sums.at(self._values(at)).amplitudes(0, self.size_px)[0]

    def _separable_start(self) -> Array:
        """(t,) parameters of the one shape with one time course nearest to the fit in which every parameter has its own time course.

        The amplitudes of that fit are a matrix, parameters by time courses; the start is its largest singular component.
        """
        scale = np.concatenate(([1.0], self.sums.steps))
        columns = self.sums.gradient.shape[1] // len(scale)
        precision = np.repeat((self.size_px * scale) ** -2.0, columns)
        amplitudes = np.linalg.solve(self.sums.information[0] + np.diag(precision), self.sums.gradient[0]).reshape(len(scale), columns)
        shape = np.linalg.svd(amplitudes)[0][:, 0]
        return np.clip(shape[1:] / (shape[0] or 1.0) / self.sums.steps, -MAX_START_STEPS, MAX_START_STEPS)
