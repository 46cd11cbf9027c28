"""Choices of a long run: smoothness of what lives in time, from all pairs, given what they share.

The marginal likelihood over all parameters needs all pairs in one matrix. After dozens of pairs distortion, scan axes and noise of frame 0
are known better than any pair knows its own drift. Taken as known, they leave a band: drift, raster and motions by their time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded

from semlive.data.drift import TermTest
from semlive.estimate.border import MOTION, NOISE, SHIFT, Border, Codes, Matrix, Strand, Vector, joint_of, strands
from semlive.estimate.evidence import CANDIDATES, DRIFT_ORDERS, log_belief
from semlive.estimate.piece import piece
from semlive.estimate.prior import Hyper, Smoothness, gauge_of_motions
from semlive.estimate.state import EstimatorState, MapRows
from semlive.estimate.terms import DECISIVE, RASTER_CANDIDATES


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """What the data say of everything that lives in time, given the border.

    Attributes:
        state: the data.
        border: what is taken as known.
        near: (n,) joint parameters from which solutions are steps, the border's at their estimate.
        codes: (m,) latest first: the start of the run is pinned by frame 0 and the end is free, so pivots stay large.
        precision: (w + 1, m) lower band of the data's precision and of the beliefs about motions.
        pull: (m,) what both ask for.
    """

    state: EstimatorState
    border: Border
    near: Vector
    codes: Codes
    precision: Matrix
    pull: Vector

    def place(self, codes: Codes) -> NDArray[np.int64]:
        """Where codes lie; -1 for those of the border."""
        order = np.argsort(self.codes)
        return np.where(self.border.place(codes) < 0, order[np.minimum(np.searchsorted(self.codes[order], codes), len(order) - 1)], -1)


def rechosen(
    state: EstimatorState, hyper: Hyper, terms: tuple[TermTest, ...], near: Vector, noise_px: Vector
) -> tuple[Hyper, tuple[TermTest, ...]]:
    """Smoothness of the drift and terms of the raster, chosen anew from all pairs; all else as it was.

    Args:
        state: the data, linearised about `near`.
        hyper: chosen before.
        terms: tested before.
        near: (n,) estimate of the joint parameters.
        noise_px: (2 blocks,) estimate of the noise of frame 0, first x, then y.
    """
    band = banded(state, hyper, near, noise_px)
    for axis in (0, 1):
        hyper = _climbed(band, hyper, axis)
    tests = {one.name: one for one in terms}
    for number, change in enumerate(state.raster):
        sizes = [0.0, *(float(one) for one in RASTER_CANDIDATES)]
        options = [replace(hyper, raster_px=tuple(size if i == number else one for i, one in enumerate(hyper.raster_px))) for size in sizes]
        scores = np.array([score(band, one) for one in options])
        best = int(np.argmax(scores[1:])) + 1
        gain = float(scores[best] - scores[0])
        hyper = options[best if gain > DECISIVE else 0]
        if change.name in tests:
            tests[change.name] = replace(tests[change.name], used=gain > DECISIVE, evidence=gain)
    return hyper, tuple(tests.values())


def banded(state: EstimatorState, hyper: Hyper, near: Vector, noise_px: Vector) -> Band:
    """All pairs of a state, at the noise scale and with the beliefs about motions of `hyper`."""
    border, weight = Border.of(state), hyper.noise_scale**-2.0
    codes = _in_order(state, hyper, border)
    empty = Band(state, border, near, codes, np.zeros((1, len(codes))), np.zeros(len(codes)))
    maps: dict[int, list[MapRows]] = {}
    for rows in state.rows:
        maps.setdefault(rows.current // 2, []).append(rows)
    said = []
    for _, one in sorted(maps.items()):
        told = piece(state, one, border, near, None, 0.0)
        pull = told.pull - told.to_border[:, border.part(NOISE)] @ noise_px
        said.append((empty.place(told.codes), weight * told.own, weight * pull))
    width = max((int(np.ptp(at)) for at, _, _ in said if at.size), default=0)
    for strand in strands(state, hyper, border):
        at = empty.place(strand.codes(strand.first, strand.spline.size))
        width = max(width, int((at[:-3] - at[3:]).max(initial=0)))
    precision, pull = np.zeros((width + 1, len(codes))), np.zeros(len(codes))
    for at, own, asked in said:
        lower = at[:, None] >= at[None, :]
        precision[(at[:, None] - at[None, :])[lower], np.broadcast_to(at, own.shape)[lower]] += own[lower]
        pull[at] += asked
    motion = (MOTION << SHIFT) | np.arange(state.motions.size, dtype=np.int64)
    at, believed = empty.place(motion), gauge_of_motions(state, hyper.rotation_rad)
    precision[0, at] += believed
    pull[at] -= believed * near[joint_of(state.layout, motion)]
    return replace(empty, precision=precision, pull=pull)


def believing(band: Band, hyper: Hyper) -> tuple[Matrix, Vector, float]:
    """A band's precision and pull with what is believed of drift and raster, and the logarithm of how likely `near` is by that."""
    precision, pull, total = band.precision.copy(), band.pull.copy(), 0.0
    for strand in strands(band.state, hyper, band.border):
        codes = strand.codes(0, strand.spline.size)
        value = band.near[joint_of(band.state.layout, codes)]
        own, cost = _belief(strand, value)
        begin, asked = strand.first, strand.asked(strand.first, strand.spline.size, value[strand.since(strand.first) :])
        at = band.place(codes[begin:][::-1])
        for lag in range(len(own)):
            count = own.shape[1] - lag
            precision[at[lag:] - at[:count], at[:count]] += own[lag, :count]
        pull[at] -= asked[begin - strand.since(begin) :][::-1]
        total += _log_determinant(strand) - cost
    return precision, pull, total


def score(band: Band, hyper: Hyper) -> float:
    """Logarithm of the marginal likelihood, up to what all candidates have in common."""
    precision, pull, total = believing(band, hyper)
    try:
        factor = cholesky_banded(precision, lower=True, check_finite=False)
    except LinAlgError:  # stiffer than a double can tell beside what is free
        return -np.inf
    fit = float(pull @ cho_solve_banded((factor, True), pull, check_finite=False))
    return 0.5 * (total + fit - 2.0 * float(np.log(factor[0]).sum()))


def _belief(strand: Strand, value: Vector) -> tuple[Matrix, float]:
    """Lower band of a strand's belief about its knots outside the border, latest first, and its cost at values of all knots."""
    first = strand.first
    own = _band(strand.differences, strand.each, strand.spline.size, first)
    for lag in range(len(own)):
        own[lag, : own.shape[1] - lag] = own[lag, : own.shape[1] - lag][::-1].copy()
    cost = strand.each * float(value[first:] @ value[first:])
    for order, weight in strand.differences:
        cost += weight * float(np.sum(np.diff(value[max(first - order, 0) :], n=order) ** 2))
    return own, cost


def _log_determinant(strand: Strand) -> float:
    """Of the precision of a strand's belief about its knots outside the border.

    Differences of the lowest order are as good unknowns as the knots themselves (each knot brings one, with coefficient 1), and far better
    to factor: thousands of knots free at one end span more than the decades of a double.
    """
    least = 0 if strand.each else min(order for order, _ in strand.differences)
    own = _band(tuple((order - least, weight) for order, weight in strand.differences), strand.each, strand.spline.size, strand.first)
    return 2.0 * float(np.log(cholesky_banded(own, lower=True, check_finite=False)[0]).sum())


def _band(differences: tuple[tuple[int, float], ...], each: float, size: int, first: int) -> Matrix:
    """(order + 1, size - first) lower band of what differences of a series, and its values, cost, those before `first` given."""
    own = np.zeros((max((order for order, _ in differences), default=0) + 1, size))
    own[0] += each
    for order, weight in differences:
        sign = [(-1.0) ** (order - i) * math.comb(order, i) for i in range(order + 1)]
        begin = max(first - order, 0)
        for later in range(order + 1):
            for earlier in range(later + 1):
                own[later - earlier, begin + earlier : size - order + earlier] += weight * sign[later] * sign[earlier]
    return own[:, first:]


def _climbed(band: Band, hyper: Hyper, axis: int) -> Hyper:
    """The likeliest smoothness of one component of the drift: from size to size as long as it becomes likelier, for each order."""
    known: dict[tuple[int, int], tuple[float, Hyper]] = {}

    def at(order: int, number: int) -> tuple[float, Hyper]:
        if (order, number) not in known:
            kinds = tuple(Smoothness(order, float(CANDIDATES[number])) if i == axis else one for i, one in enumerate(hyper.drift))
            option = replace(hyper, drift=(kinds[0], kinds[1]))
            believed = float(log_belief(CANDIDATES[number : number + 1], DRIFT_ORDERS[order])[0])
            known[order, number] = score(band, option) + believed, option
        return known[order, number]

    start = int(np.argmin(np.abs(np.log(CANDIDATES / max(hyper.drift[axis].size_px, CANDIDATES[0])))))
    for order in DRIFT_ORDERS:
        number = start
        while True:
            near = [one for one in (number - 1, number, number + 1) if 0 <= one < len(CANDIDATES)]
            best = max(near, key=lambda one: at(order, one)[0])
            if best == number:
                break
            number = best
    return max(known.values(), key=lambda one: one[0])[1]


def _in_order(state: EstimatorState, hyper: Hyper, border: Border) -> Codes:
    codes, times = [], []
    for strand in strands(state, hyper, border):
        knots = np.arange(strand.first, strand.spline.size)
        codes.append(strand.codes(strand.first, strand.spline.size))
        times.append(strand.spline.origin + (knots - 0.5 * strand.spline.degree) * strand.spline.spacing)
    start = {when.frame // 2: when.start_s for when in state.frames}
    count = [kind.value for kind in state.motions.kinds]
    codes.append((MOTION << SHIFT) | np.arange(sum(count), dtype=np.int64))
    times.append(np.repeat([start[pair] for pair in state.motions.pairs], count))
    return np.concatenate(codes)[np.argsort(-np.concatenate(times), kind="stable")]
