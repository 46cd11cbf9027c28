"""Uniform B-splines in one dimension: local rows of the design matrix and roughness matrices."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass, replace
from functools import cache, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from semlive.kernels.splines.spline_columns import evaluate_piecewise
from semlive.model.walks import Gap, differences_across


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
        gaps: stretches of knots without data whose coefficients are left out: for each, the index of the first coefficient after it and
            the number of coefficients left out so far. Elsewhere the spline is that on all knots.
    """

    origin: float
    spacing: float
    intervals: int
    degree: int = 3
    gaps: tuple[Gap, ...] = ()

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return self.intervals + self.degree - self._left_out(len(self.gaps))

    def until(self, position: float) -> UniformSpline:
        """The same spline, lengthened to reach `position`."""
        needed = self._needed(position)
        return self if needed <= self.intervals else replace(self, intervals=needed)

    def after_gap(self, position: float, least: int) -> UniformSpline:
        """The spline continued at `position`, without the coefficients between; itself if these are at most `least`."""
        first = math.floor((position - self.origin) / self.spacing)
        left_out = first - self.intervals - self.degree
        if left_out <= least:
            return self
        return replace(self, intervals=first + 1, gaps=(*self.gaps, (self.size, self._left_out(len(self.gaps)) + left_out)))

    def shortened(self, position: float) -> UniformSpline:
        """The spline as it was when it reached `position`; at least one interval."""
        return self.of_intervals(self._needed(position))

    def of_intervals(self, intervals: int) -> UniformSpline:
        """The spline of the first intervals, at least one, or of those before the gap that begins there."""
        intervals = max(min(intervals, self.intervals), 1)
        count = bisect_left(self.gaps, intervals, key=sum)
        if count < len(self.gaps):
            intervals = min(intervals, self.gaps[count][0] + self._left_out(count) - self.degree)
        return replace(self, intervals=intervals, gaps=self.gaps[:count])

    def has(self, begin: float, end: float) -> bool:
        """Whether no coefficient with influence between two positions is left out."""
        first, last = math.floor((begin - self.origin) / self.spacing), self._needed(end) + self.degree
        count = bisect_right(self.gaps, first, key=sum)
        return count == len(self.gaps) or last <= self.gaps[count][0] + self._left_out(count)

    def first_at(self, position: float) -> int:
        """Index of the first coefficient with influence at a position or later."""
        interval = max(math.floor((position - self.origin) / self.spacing), 0)
        count = bisect_right(self.gaps, interval, key=sum)
        index = interval - self._left_out(count)
        return index if count == len(self.gaps) else min(index, self.gaps[count][0])

    def place(self, index: NDArray[np.int64]) -> NDArray[np.int64]:
        """Indices that coefficients would have without gaps."""
        if not self.gaps:
            return index
        begins, left_out = np.array(self.gaps, dtype=np.int64).T
        return index + np.concatenate((np.zeros(1, dtype=np.int64), left_out))[np.searchsorted(begins, index, side="right")]

    def gaps_within(self, first: int, stop: int, since: int = 0) -> list[Gap]:
        """The gaps that end at a coefficient ``first <= i < stop``: that coefficient, counted from `since`, and how many are left out."""
        begin, end = bisect_left(self.gaps, (first, 0)), bisect_left(self.gaps, (stop, 0))
        return [(self.gaps[at][0] - since, self.gaps[at][1] - self._left_out(at)) for at in range(begin, end)]

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
        return _roughness(self.size, order, tuple(self.gaps_within(0, self.size)))

    def _needed(self, position: float) -> int:
        return math.ceil((position - self.origin) / self.spacing)

    def _left_out(self, count: int) -> int:
        return self.gaps[count - 1][1] if count else 0

    def _local(self, position: ArrayLike, derivative: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        at = np.ascontiguousarray(position, dtype=np.float64).ravel()
        table = _polynomials(self.degree, derivative)
        index, value = self._on_stretches(at, table) if self.gaps else self._on_stretch(at, table, 0)
        return index, value / self.spacing**derivative if derivative else value

    def _on_stretches(self, at: NDArray[np.float64], table: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Positions within a gap continue the polynomial of the stretch that is closer."""
        begins, left_out = np.array(self.gaps, dtype=np.int64).T
        ends = begins - self.degree + np.concatenate((np.zeros(1, dtype=np.int64), left_out[:-1]))
        stretch = np.searchsorted(self.origin + 0.5 * self.spacing * (ends + begins + left_out), at, side="right")
        index, value = np.empty((len(at), table.shape[1]), dtype=np.int64), np.empty((len(at), table.shape[1]))
        for number in np.unique(stretch):
            own = stretch == number
            index[own], value[own] = self._on_stretch(at[own], table, int(number))
        return index, value

    def _on_stretch(
        self, at: NDArray[np.float64], table: NDArray[np.float64], number: int
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """On the stretch before a gap, or after the last one."""
        last = number == len(self.gaps)
        begin, before = sum(self.gaps[number - 1]) if number else 0, self._left_out(number)
        end = self.intervals if last else self.gaps[number][0] + before - self.degree
        index, value = evaluate_piecewise(at, self.origin + begin * self.spacing, self.spacing, end - begin, table)
        return index + (begin - before) if number else index, value


@cache
def _polynomials(degree: int, derivative: int) -> NDArray[np.float64]:
    """(degree + 1 - derivative, degree + 1) the basis functions that are not zero on an interval, or their derivatives."""
    table = np.ascontiguousarray(np.polynomial.polynomial.polyder(_cardinal(degree), derivative, axis=0), dtype=np.float64)
    table.setflags(write=False)
    return table


@lru_cache(maxsize=64)
def _roughness(size: int, order: int, gaps: tuple[Gap, ...]) -> NDArray[np.float64]:
    difference = np.diff(np.eye(size), n=order, axis=0)
    for rows, columns, weights in differences_across(order, (1.0,), size, gaps):
        difference[rows] = 0.0
        difference[rows, columns] = weights
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
