"""One-dimensional B-splines on non-uniform knots, denser where the function varies faster."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline

from semlive.kernels.splines.spline_columns import piecewise

Field = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class KnotSpline:
    """B-spline on arbitrary increasing knots with the interface of `UniformSpline`; identical to it on equidistant knots.

    Beyond either end the outermost interval is repeated. Coefficient i has its support on the intervals i - degree ... i.

    Attributes:
        knots: increasing; the first and last bound the domain.
        degree: of the polynomials.
    """

    knots: tuple[float, ...]
    degree: int = 3

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return len(self.knots) - 1 + self.degree

    def local(self, position: ArrayLike) -> tuple[NDArray[np.int64], Field]:
        """(n, degree + 1) coefficient indices and basis values; positions outside continue the outermost polynomial."""
        at, knots, table = np.asarray(position, dtype=np.float64).ravel(), np.array(self.knots), _pieces(self)
        first = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, len(knots) - 2)
        first = first.astype(np.int64)
        value = piecewise(table, first, (at - knots[first]) / np.diff(knots)[first])
        return first[:, None] + np.arange(self.degree + 1), value

    def roughness(self, order: int) -> Field:
        """(size, size) sum of squared differences of an order of neighbouring coefficients, in units of the knots' own distance there.

        The derivative's coefficients (de Boor, A Practical Guide to Splines, chapter X) times the local distance of knots to that power:
        polynomials of lower degree cost nothing, and where knots are closer the spline may bend as much from knot to knot as elsewhere.
        """
        return _roughness(self, order)


def towards_start(end: float, intervals: int, halvings: int, degree: int) -> KnotSpline:
    """Spline over ``[0, end]`` with equidistant knots, the first interval halved repeatedly towards 0."""
    spacing = end / intervals
    first = [0.0, *(spacing * 0.5**number for number in range(halvings, 0, -1))]
    return KnotSpline((*first, *(spacing * number for number in range(1, intervals + 1))), degree)


def _extended(spline: KnotSpline) -> Field:
    knots, degree = np.array(spline.knots), spline.degree
    before = knots[0] - (knots[1] - knots[0]) * np.arange(degree, 0, -1)
    return np.concatenate((before, knots, knots[-1] + (knots[-1] - knots[-2]) * np.arange(1, degree + 1)))


@lru_cache(maxsize=16)
def _pieces(spline: KnotSpline) -> Field:
    """(intervals, degree + 1, degree + 1): ``[i, k, j]`` is the coefficient of f^k of basis function j on interval i."""
    knots, count = np.array(spline.knots), spline.degree + 1
    basis, width = BSpline(_extended(spline), np.eye(spline.size), spline.degree), np.diff(knots)
    at = np.arange(len(width))[:, None] + np.arange(count)
    values = [basis(knots[:-1], nu=power) * (width**power / math.factorial(power))[:, None] for power in range(count)]
    table = np.stack([np.take_along_axis(value, at, axis=1) for value in values], axis=1)
    table.setflags(write=False)
    return table


@lru_cache(maxsize=16)
def _roughness(spline: KnotSpline, order: int) -> Field:
    knots, degree, rows = _extended(spline), spline.degree, np.eye(spline.size)
    for step in range(order):
        reach = degree - step
        begin = np.arange(step + 1, step + 1 + len(rows) - 1)
        rows = np.diff(rows, axis=0) * (reach / (knots[begin + reach] - knots[begin]))[:, None]
    if order:
        begin = np.arange(order, order + len(rows))
        local = (knots[begin + degree + 1 - order] - knots[begin]) / (degree + 1 - order)
        rows = rows * (local**order)[:, None]
    table = rows.T @ rows
    table.setflags(write=False)
    return table
