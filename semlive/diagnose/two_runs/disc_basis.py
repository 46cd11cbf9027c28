"""Distortion on a disc about the frame centre, in polynomials without affine terms; a rotation mixes only terms of equal order."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from semlive.diagnose.baseline.baseline import HyperparameterGrid

Array = NDArray[np.float64]
ORDER = 6  # largest order of the polynomials
AFFINE = 3  # number of polynomials of order 0 and 1, which are gauge freedom
_RINGS, _SPOKES = 12, 36


@dataclass(frozen=True, slots=True, eq=False)
class DiscBasis:
    """Polynomials that are orthonormal over a unit disc.

    A projection on them removes finer components, also after a rotation of the disc. Therefore the comparison of two fields does not assume
    that finer components are absent.

    Attributes:
        at: (n, 2) points of the disc.
        weight: (n,) weights of the points in a mean over the disc.
        powers: (m, 2) powers of x and y, lowest order first.
        coefficients: (m, m) coefficients of the polynomials in these powers.
        order: (m,) order of each polynomial.
    """

    at: Array
    weight: Array
    powers: NDArray[np.int64]
    coefficients: Array
    order: NDArray[np.int64]

    def values(self, at: Array) -> Array:
        """(n, m) values of all polynomials at points (n, 2)."""
        return np.asarray(np.prod(at[:, None, :] ** self.powers, axis=-1) @ self.coefficients)

    def project(self, values: Array) -> Array:
        """(m, ...) projection of values (n, ...) at the points of the disc on the polynomials."""
        return np.tensordot(self.values(self.at) * self.weight[:, None], values, axes=(0, 0))

    def moved(self, points: Array) -> Array:
        """(m - 3, m - 3) map of the non-affine polynomials for arguments at other points (n, 2)."""
        return self.project(self.values(points))[AFFINE:, AFFINE:]


@lru_cache(maxsize=1)
def modes() -> DiscBasis:
    """Basis of all polynomials up to `ORDER`."""
    node, share = np.polynomial.legendre.leggauss(_RINGS)
    radius, turn = np.sqrt(0.5 * (node + 1.0)), 2.0 * np.pi * np.arange(_SPOKES) / _SPOKES
    at = np.stack((np.outer(radius, np.cos(turn)).ravel(), np.outer(radius, np.sin(turn)).ravel()), axis=-1)
    weight = np.repeat(0.5 * share / _SPOKES, _SPOKES)
    powers = np.array([(total - j, j) for total in range(ORDER + 1) for j in range(total + 1)])
    raw = np.prod(at[:, None, :] ** powers, axis=-1)
    upper = np.linalg.qr(raw * np.sqrt(weight)[:, None])[1]
    mix = np.linalg.inv(upper)
    return DiscBasis(at, weight, powers, mix * np.sign(np.diag(mix)), powers.sum(axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class DiscDistortion:
    """Distortion of a run on the disc.

    Attributes:
        value_px: (2, k) coefficients along x and y of the polynomials of second and higher order, px.
        covariance_px2: (2 k, 2 k) their covariance.
        slope: (2, 2) gradient of the affine part, which the gauge of the run's points determines.
    """

    value_px: Array
    covariance_px2: Array
    slope: Array


def disc_radius_px(run: HyperparameterGrid) -> float:
    """Radius of the largest disc about the frame centre inside the area with points, px."""
    address = run.design.observation.geometry.address_px.reshape(-1, 2)
    return float(min(-address.min(axis=0).max(), address.max(axis=0).min()))


def baseline_mean(run: HyperparameterGrid) -> Array:
    """(p + r,) most likely parameters of the baseline and amplitudes of the given effects."""
    design = run.design
    first = design.observation.solution.mean[design.parameter_indices]
    return np.asarray(np.concatenate((first, np.zeros(design.size - len(first)))) + run.best.solve(run.best.gradient[:, None])[:, 0])


def parameter_subset(run: HyperparameterGrid, name: str) -> NDArray[np.int64]:
    """Indices of the parameters of one part of the estimate among those of a baseline."""
    part = run.design.observation.state.layout.part(name)
    return np.flatnonzero((run.design.parameter_indices >= part.start) & (run.design.parameter_indices < part.stop))


def distortion_on_disc(run: HyperparameterGrid, radius_px: float) -> DiscDistortion:
    """Distortion of a run on a disc of the given radius, px."""
    basis, state, own = modes(), run.design.observation.state, parameter_subset(run, "distortion")
    pixel = basis.at * radius_px + state.centre_px
    rows = np.zeros((len(pixel), state.distortion.along_y.size, state.distortion.along_x.size))
    index_x, value_x = state.distortion.along_x.local(pixel[:, 0])
    index_y, value_y = state.distortion.along_y.local(pixel[:, 1])
    at = np.arange(len(pixel))[:, None, None]
    rows[at, index_y[:, :, None], index_x[:, None, :]] = value_y[:, :, None] * value_x[:, None, :]
    evaluated = basis.project(rows.reshape(len(pixel), -1))
    mean = evaluated @ baseline_mean(run)[own].reshape(-1, 2)
    gradient = np.zeros((run.design.size, 2, len(evaluated) - AFFINE))
    for axis in (0, 1):
        gradient[own[axis::2], axis] = evaluated[AFFINE:].T
    gradient = gradient.reshape(run.design.size, -1)
    covariance = gradient.T @ run.best.solve(gradient)
    return DiscDistortion(mean[AFFINE:].T, 0.5 * (covariance + covariance.T), _slope(basis, mean) / radius_px)


def _slope(basis: DiscBasis, evaluated: Array) -> Array:
    """(2, 2) gradient over the unit disc of a field with coefficients (m, 2)."""
    across = basis.values(np.array([[0.5, 0.0], [0.0, 0.5]])) - basis.values(-np.array([[0.5, 0.0], [0.0, 0.5]]))
    return np.asarray((across[:, :AFFINE] @ evaluated[:AFFINE]).T)
