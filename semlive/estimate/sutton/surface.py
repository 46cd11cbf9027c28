"""A bicubic B-spline surface over the calibrated area."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.sparse import csr_array

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Two components over x and y; constant beyond the edge of its area.

    Attributes:
        knots_x: clamped knots along x.
        knots_y: clamped knots along y.
        coefficients: (size, 2), row by row.
    """

    knots_x: Array
    knots_y: Array
    coefficients: Array

    @classmethod
    def flat(cls, low_px: Array, high_px: Array, knot_px: float) -> Surface:
        """Zero over a rectangle, with knots about `knot_px` apart."""
        knots_x, knots_y = (_clamped(float(a), float(b), knot_px) for a, b in zip(low_px, high_px, strict=True))
        return cls(knots_x, knots_y, np.zeros(((len(knots_x) - 4) * (len(knots_y) - 4), 2)))

    def rows(self, address_px: Array) -> csr_array:
        """(n, size) sparse rows of the basis at addresses (n, 2)."""
        along_x = BSpline.design_matrix(np.clip(address_px[:, 0], self.knots_x[0], self.knots_x[-1]), self.knots_x, 3)
        along_y = BSpline.design_matrix(np.clip(address_px[:, 1], self.knots_y[0], self.knots_y[-1]), self.knots_y, 3)
        n = len(address_px)
        value = along_y.data.reshape(n, 4, 1) * along_x.data.reshape(n, 1, 4)
        index = along_y.indices.reshape(n, 4, 1).astype(np.int64) * (len(self.knots_x) - 4) + along_x.indices.reshape(n, 1, 4)
        shape = (n, len(self.coefficients))
        return csr_array((value.ravel(), index.ravel(), np.arange(0, 16 * n + 1, 16)), shape=shape)

    def at(self, address_px: Array) -> Array:
        """(n, 2) values at addresses (n, 2)."""
        return np.asarray(self.rows(address_px) @ self.coefficients)


def _clamped(low: float, high: float, knot_px: float) -> Array:
    inner = np.linspace(low, high, max(1, round((high - low) / knot_px)) + 1)
    return np.concatenate((np.full(3, low), inner, np.full(3, high)))
