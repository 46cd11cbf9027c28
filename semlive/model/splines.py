"""Uniform B-splines in one dimension: local rows of the design matrix and roughness matrices."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from semlive.kernels.splines.spline_columns import evaluate_piecewise


@dataclass(frozen=True, slots=True)
class UniformSpline:
    """A B-spline on equidistant knots over ``[origin, origin + intervals * spacing]``.

    Coefficient i has its support on the intervals i - degree ... i, so a spline is lengthened by appending coefficients;
    those that exist keep their meaning. On its interval every basis function is a polynomial in the fraction f of the
    interval: the same numbers as ``scipy.interpolate.BSpline.design_matrix`` (a test holds them together) at a tenth of its time.

    Attributes:
        origin: where the first interval begins.
        spacing: distance of the knots.
        intervals: number of intervals, >= 1.
        degree: of the polynomials.
    """

    origin: float
    spacing: float
    intervals: int
    degree: int = 3

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return self.intervals + self.degree

    def local(self, position: ArrayLike) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """(n, degree + 1) coefficient indices and basis values; positions outside continue the outermost polynomial."""
        return self._local(position, 0)

    def local_rate(self, position: ArrayLike) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """(n, degree + 1) coefficient indices and first derivatives of the basis."""
        return self._local(position, 1)

    def roughness(self, order: int) -> NDArray[np.float64]:
        """(size, size) sum of squared differences of an order of neighbouring coefficients, each weighing the same.

        Close to the integral of the squared derivative, but as strict with the outermost coefficients. Of those the domain holds
        only the tail, and integrals over it would let a quintic's be anything up to 1e5 px.
        """
        return _roughness(self.size, order)

    def _local(self, position: ArrayLike, derivative: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        at = np.ascontiguousarray(position, dtype=np.float64).ravel()
        table = _polynomials(self.degree, derivative)
        index, value = evaluate_piecewise(at, self.origin, self.spacing, self.intervals, table)
        return index, value / self.spacing**derivative if derivative else value


@cache
def _polynomials(degree: int, derivative: int) -> NDArray[np.float64]:
    """(degree + 1 - derivative, degree + 1) the basis functions that are not zero on an interval, or their derivatives."""
    table = np.ascontiguousarray(np.polynomial.polynomial.polyder(_cardinal(degree), derivative, axis=0), dtype=np.float64)
    table.setflags(write=False)
    return table


@lru_cache(maxsize=64)
def _roughness(size: int, order: int) -> NDArray[np.float64]:
    difference = np.diff(np.eye(size), n=order, axis=0)
    table = difference.T @ difference
    table.setflags(write=False)
    return table


@cache
def _cardinal(degree: int) -> NDArray[np.float64]:
    """(degree + 1, degree + 1): ``[k, j]`` is the coefficient of f^k of basis function j on an interval.

    Pieces of the cardinal B-spline, ``sum_i (-1)^i C(d+1, i) (t - i)_+^d / d!`` at ``t = f + d - j`` (de Boor, A Practical Guide
    to Splines, chapter IX).
    """
    table = np.zeros((degree + 1, degree + 1))
    for j in range(degree + 1):
        for i in range(degree - j + 1):
            shift = degree - j - i
            for k in range(degree + 1):
                table[k, j] += (-1) ** i * math.comb(degree + 1, i) * math.comb(degree, k) * float(shift) ** (degree - k)
    table /= math.factorial(degree)
    table.setflags(write=False)
    return table
