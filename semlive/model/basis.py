"""Uniform cubic B-splines in one dimension: local rows of the design matrix and roughness matrices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, slots=True)
class UniformSpline:
    """A cubic B-spline on equidistant knots over ``[origin, origin + intervals * spacing]``.

    Coefficient i has its support on the intervals i-3 ... i, so a spline is lengthened by appending coefficients; those
    that exist keep their meaning. Rows are written out in closed form: the same numbers as
    ``scipy.interpolate.BSpline.design_matrix`` (a test holds them together) at a tenth of its time.

    Attributes:
        origin: where the first interval begins.
        spacing: distance of the knots.
        intervals: number of intervals, >= 1.
    """

    origin: float
    spacing: float
    intervals: int

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return self.intervals + 3

    def local(self, position: ArrayLike) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """(n, 4) coefficient indices and (n, 4) basis values; positions outside continue the outermost cubic."""
        first, f = self._split(position)
        g = 1.0 - f
        value = np.stack((g**3, 3 * f**3 - 6 * f**2 + 4, 3 * g**3 - 6 * g**2 + 4, f**3), axis=1) / 6.0
        return first[:, None] + np.arange(4), value

    def local_rate(self, position: ArrayLike) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """(n, 4) coefficient indices and (n, 4) first derivatives of the basis."""
        first, f = self._split(position)
        g = 1.0 - f
        value = np.stack((-(g**2), 3 * f**2 - 4 * f, -(3 * g**2 - 4 * g), f**2), axis=1) / (2.0 * self.spacing)
        return first[:, None] + np.arange(4), value

    def gram(self, derivative: int) -> NDArray[np.float64]:
        """(size, size) integrals over the domain of products of the basis' derivatives of order 0, 1 or 2."""
        # Four Gauss points are exact to degree 7, the products have degree 6 at most.
        node, weight = np.polynomial.legendre.leggauss(4)
        f, w = 0.5 * (node + 1.0), 0.5 * weight * self.spacing
        g = 1.0 - f
        values = (
            np.stack((g**3, 3 * f**3 - 6 * f**2 + 4, 3 * g**3 - 6 * g**2 + 4, f**3)) / 6.0,
            np.stack((-(g**2), 3 * f**2 - 4 * f, -(3 * g**2 - 4 * g), f**2)) / (2.0 * self.spacing),
            np.stack((g, 3 * f - 2, 3 * g - 2, f)) / self.spacing**2,
        )[derivative]
        one = (values * w) @ values.T
        total = np.zeros((self.size, self.size))
        for i in range(self.intervals):
            total[i : i + 4, i : i + 4] += one
        return total

    def _split(self, position: ArrayLike) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        scaled = (np.asarray(position, dtype=np.float64).ravel() - self.origin) / self.spacing
        first = np.clip(np.floor(scaled), 0, self.intervals - 1)
        return first.astype(np.int64), scaled - first
