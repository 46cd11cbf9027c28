"""The baseline: drift, distortion and motion as the estimator has them, effects that were found, and what the data leave of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from semlive.diagnose.observation import Observation
from semlive.diagnose.whiten import Whitener
from semlive.estimate.accumulate import map_columns
from semlive.estimate.evidence import log_belief
from semlive.estimate.prior import Hyper, Smoothness, belief_precision, gauge_precision

Array = NDArray[np.float64]

SMOOTHEST_PX, WIDEST_PX = 3e-4, 100.0  # farther apart, the belief's precision has no Cholesky factor in double precision
ROUGHEST_PX = 1.0  # of a drift, from knot to knot, as the estimator has it: with 75 px one followed what a bending had left of the noise
ANY_DISTORTION = 10.0
STILL_RAD = 1e-9  # a specimen that turns with each move is an effect with a name of its own
BELIEF = 4.0  # standard deviation of the logarithm about the first choice


@dataclass(frozen=True, slots=True)
class DriftBelief:
    """How the drift may go.

    Attributes:
        by: its typical bend, in that of the first choice; 0 where it is as smooth as any.
        wander_px: what a random walk beside that adds from knot to knot.
    """

    by: float
    wander_px: float = 0.0


# The smoothness that the first solution chose was chosen with the effect in the data: an unnamed jump makes the drift rough, and a rough
# drift hides the jump. So every question is put to smoother and rougher drifts too, and the likeliest answer counts.
BENDING = tuple(DriftBelief(by) for by in (0.01, 0.1, 1.0, 10.0, 100.0))
# Bends of one size are no random walk: in runs whose drift wandered by 0.01 px/s^0.5 a walk beside a smooth drift was likelier by a
# logarithm of 130 to 150, and without it swings of 61 to 62 s were named in it that only held-out pairs rejected.
WANDERING = tuple(DriftBelief(0.0, wander_px) for wander_px in (0.0, 0.01, 0.03, 0.1, 0.3, 1.0))
DRIFTS = (*BENDING, *WANDERING)
DISTORTION_RUNGS = (0.3, 1.0, 3.0)
STANDING = 1e-6  # what holds a walk as a whole, in what holds its steps
HOPELESS = 40.0  # logarithm of the odds against a drift that could follow more, and explains less: an effect helps it less than others


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """An effect that is in the baseline.

    Attributes:
        field: (f, b, 2, q) whitened columns.
        size_px: standard deviation of their amplitudes before the data.
    """

    field: Array
    size_px: float


Moving = tuple[tuple[NDArray[np.int64], Array], ...]


@dataclass(frozen=True, slots=True, eq=False)
class Design:
    """The baseline's columns, whitened; those of effects that were found come last.

    Attributes:
        observation: what they are for.
        whiten: the noise.
        columns: for x and for y, (f b, m) columns.
        own: for x and for y, of each frame which of the baseline's columns move it, and (b, k) these with their mean over the frames.
        index: for x and for y, (m,) the parameters that they belong to.
        kept: (p,) joint parameters of the estimator that the baseline has.
        normal: (p + r, p + r) A^T A, r being the number of the effects' amplitudes.
        sizes_px: (r,) of the effects' amplitudes.
    """

    observation: Observation
    whiten: Whitener
    columns: tuple[Array, Array]
    own: tuple[Moving, Moving]
    index: tuple[NDArray[np.int64], NDArray[np.int64]]
    kept: NDArray[np.int64]
    normal: Array
    sizes_px: Array

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self.normal)

    def transposed(self, white: Array) -> Array:
        """(p + r, q) A^T times whitened fields (f, b, 2, q)."""
        total = np.zeros((self.size, white.shape[-1]))
        for axis in (0, 1):
            total[self.index[axis]] += self.along(axis, white[:, :, axis])
        return total

    def along(self, axis: int, white: Array) -> Array:
        """(m, q) columns of one axis times whitened fields (f, b, q).

        Whitened fields have no mean over the frames, so the columns' own need not be taken away, and most columns of the drift move three
        frames of thirty: a third of the time.
        """
        columns, own = self.columns[axis], self.own[axis]
        total = np.zeros((columns.shape[1], white.shape[-1]))
        for frame, (at, block) in enumerate(own):
            total[at] += block.T @ white[frame]
        effects = columns[:, columns.shape[1] - len(self.sizes_px) :]
        total[columns.shape[1] - len(self.sizes_px) :] += effects.T @ white.reshape(len(columns), -1)
        return total

    def times(self, parameters: Array) -> Array:
        """(f, b, 2, q) A times parameters (p + r, q)."""
        f, b = self.observation.frames, self.observation.blocks
        parts = [(self.columns[axis] @ parameters[self.index[axis]]).reshape(f, b, 1, -1) for axis in (0, 1)]
        return np.concatenate(parts, axis=2)

    def rescaled(self, by: float) -> Design:
        """The same where noise is larger by a factor."""
        columns = self.columns[0] / by, self.columns[1] / by
        own = [tuple((at, block / by) for at, block in one) for one in self.own]
        whiten = replace(self.whiten, sigma_px=self.whiten.sigma_px * by)
        return replace(self, whiten=whiten, columns=columns, own=(own[0], own[1]), normal=self.normal / by**2)

    def having(self, found: Found) -> Design:
        """The same with an effect more."""
        q = found.field.shape[-1]
        place = self.size + np.arange(q)
        flat = [np.ascontiguousarray(found.field[:, :, axis].reshape(-1, q)) for axis in (0, 1)]
        normal = np.zeros((self.size + q,) * 2)
        normal[: self.size, : self.size] = self.normal
        cross = self.transposed(found.field)
        normal[: self.size, self.size :], normal[self.size :, : self.size] = cross, cross.T
        normal[self.size :, self.size :] = sum(one.T @ one for one in flat)
        columns = [np.concatenate((one, more), axis=1) for one, more in zip(self.columns, flat, strict=True)]
        index = [np.concatenate((one, place)) for one in self.index]
        sizes = np.concatenate((self.sizes_px, np.full(q, found.size_px)))
        return replace(self, columns=(columns[0], columns[1]), index=(index[0], index[1]), normal=normal, sizes_px=sizes)


def design(observation: Observation, whiten: Whitener) -> Design:
    """Columns of an observation, linearised about its first solution."""
    state, layout = observation.state, observation.state.layout
    dropped = np.zeros(layout.size, dtype=np.bool_)
    for change in state.raster:
        dropped[layout.part(change.name)] = True  # what the raster does is to be named
    kept = np.flatnonzero(~dropped)
    place = np.full(layout.size, -1)
    place[kept] = np.arange(len(kept))
    told = [map_columns(state, one, state.about) for one in observation.rows]
    columns, index, moving = [], [], list[Moving]()
    for axis in (0, 1):
        touched = np.unique(np.concatenate([one[axis][0] for one in told]))
        touched = touched[~dropped[touched]]
        at = np.full(layout.size, -1)
        at[touched] = np.arange(len(touched))
        dense = np.zeros((observation.frames, observation.blocks, len(touched)))
        for frame, one in enumerate(told):
            own, value = one[axis]
            inside = at[own] >= 0
            dense[frame + 1][:, at[own[inside]]] = value[np.ix_(observation.used, inside)]
        columns.append(whiten(dense).reshape(-1, len(touched)))
        index.append(place[touched])
        there = [np.flatnonzero(one.any(axis=0)) for one in dense]
        moving.append(tuple((at, whiten.inverse @ one[:, at] / whiten.sigma_px) for at, one in zip(there, dense, strict=True)))
    normal = np.zeros((len(kept), len(kept)))
    for axis in (0, 1):
        normal[np.ix_(index[axis], index[axis])] += columns[axis].T @ columns[axis]
    return Design(observation, whiten, (columns[0], columns[1]), (moving[0], moving[1]), (index[0], index[1]), kept, normal, np.zeros(0))


@dataclass(frozen=True, slots=True, eq=False)
class Rung:
    """A baseline with one smoothness.

    Attributes:
        hyper: the smoothness.
        prior: (p + r, p + r) precision before the data.
        factor: Cholesky factor of the posterior precision.
        evidence: logarithm of the likelihood of the data, up to a constant that all rungs share.
        room: the part of it, negative, that comes from what else there might have been.
        pull: (p + r,) what residuals and belief ask for at the first solution.
        asked: (p + r,) the same, half solved.
        belief: of the drift, and the roughness of the distortion in that of the first choice; None of runs that were joined.
    """

    hyper: Hyper
    prior: Array
    factor: tuple[Array, bool]
    evidence: float
    room: float
    pull: Array
    asked: Array
    belief: tuple[DriftBelief, float] | None = None

    def half(self, right: Array) -> Array:
        """(p + r, ...) inverse of the factor times (p + r, ...): products of two such are those of a solution with one right side."""
        return np.asarray(solve_triangular(self.factor[0], right, lower=True, check_finite=False))

    def solve(self, right: Array) -> Array:
        """(p + r, q) posterior covariance times (p + r, q)."""
        return np.asarray(cho_solve(self.factor, right, check_finite=False))


@dataclass(frozen=True, slots=True, eq=False)
class Ladder:
    """The baseline against the data.

    Attributes:
        design: the columns.
        left: (f, b, 2) whitened, what the first solution leaves of the data.
        rungs: the drift that is smoothest first.
    """

    design: Design
    left: Array
    rungs: tuple[Rung, ...]

    @property
    def best(self) -> Rung:
        """The likeliest."""
        return max(self.rungs, key=lambda one: one.evidence)

    @property
    def evidence(self) -> float:
        """Logarithm of the likelihood summed over the rungs."""
        return float(np.logaddexp.reduce([one.evidence for one in self.rungs]))

    def residual(self) -> Array:
        """(f, b, 2) whitened, what the likeliest baseline leaves."""
        step = self.best.solve(self.best.pull[:, None])
        return self.left - self.design.times(step)[..., 0]


def ladder(columns: Design) -> Ladder:
    """For each smoothness of the drift the baseline with the likeliest of the distortion's, but for those that have no hope."""
    tries = _Tries.of(columns)
    plain = [(one, tries.rung(one, 1.0)) for one in _different(columns)]
    best = max((rung for _, rung in plain), key=lambda one: one.evidence)
    kept = [(one, rung) for one, rung in plain if rung.evidence > best.evidence - HOPELESS or rung.room > best.room]
    rungs = [max((rung, *tries.bent(one)), key=lambda one: one.evidence) for one, rung in kept]
    return Ladder(columns, tries.left, tuple(rungs))


def likeliest(columns: Design) -> Ladder:
    """A ladder of one rung: the likeliest smoothness of the drift, and then of the distortion."""
    tries = _Tries.of(columns)
    found = {one: tries.rung(one, 1.0) for one in _different(columns)}
    best = max(found, key=lambda one: found[one].evidence)
    return Ladder(columns, tries.left, (max((found[best], *tries.bent(best)), key=lambda one: one.evidence),))


def as_believed(columns: Design) -> Ladder:
    """A ladder of one rung: as smooth as the first solution has it."""
    tries = _Tries.of(columns)
    return Ladder(columns, tries.left, (tries.rung(DriftBelief(1.0), 1.0),))


def as_smooth(columns: Design, like: Ladder) -> Ladder:
    """A ladder of one rung: as smooth as another's likeliest.

    Raises:
        ValueError: the other is of runs that were joined.
    """
    if like.best.belief is None:
        raise ValueError("runs that were joined have no smoothness of one run")
    tries = _Tries.of(columns)
    return Ladder(columns, tries.left, (tries.rung(*like.best.belief),))


def with_any_distortion(columns: Design) -> Ladder:
    """A ladder of one rung: the likeliest smoothness of the drift, with a distortion far rougher than what was chosen.

    A distortion is no draw of what is believed of it: of five pairs one in five was found loud by a few of its terms.
    """
    tries = _Tries.of(columns)
    return Ladder(columns, tries.left, (max((tries.rung(one, ANY_DISTORTION) for one in BENDING), key=lambda one: one.evidence),))


@dataclass(frozen=True, slots=True, eq=False)
class _Tries:
    """What all smoothnesses have in common."""

    columns: Design
    gauge: Array
    near: Array
    left: Array
    pull: Array
    power: float

    @classmethod
    def of(cls, columns: Design) -> _Tries:
        near = np.concatenate((columns.observation.solution.mean[columns.kept], np.zeros(columns.size - len(columns.kept))))
        left = columns.whiten(columns.observation.disparity_px) - columns.times(near[:, None])[..., 0]
        gauge = gauge_precision(columns.observation.state)[np.ix_(columns.kept, columns.kept)]
        return cls(columns, gauge, near, left, columns.transposed(left[..., None])[:, 0], float(np.sum(left**2)))

    def rung(self, drift: DriftBelief, also: float) -> Rung:
        hyper, prior = _believed(self.columns, self.gauge, drift, also)
        believed = log_belief(np.array([drift.by or 1.0]), (1.0, BELIEF)) + log_belief(np.array([also]), (1.0, BELIEF))
        found = rung(self.columns.normal, prior, self.pull, self.power, self.near, hyper, float(believed[0]))
        return replace(found, belief=(drift, also))

    def bent(self, drift: DriftBelief) -> list[Rung]:
        """With other smoothnesses of the distortion than the first choice."""
        return [self.rung(drift, also) for also in DISTORTION_RUNGS if also != 1.0]


def _believed(columns: Design, gauge: Array, drift: DriftBelief, also: float) -> tuple[Hyper, Array]:
    state, first, p = columns.observation.state, columns.observation.solution.hyper, len(columns.kept)
    hyper = replace(
        first,
        noise_scale=1.0,
        rotation_rad=STILL_RAD,
        raster_px=(0.0, 0.0),
        drift=_drift_of(first.drift, drift),
        distortion=_scaled(first.distortion, also),
    )
    prior = np.zeros((columns.size,) * 2)
    prior[:p, :p] = belief_precision(state, hyper)[np.ix_(columns.kept, columns.kept)]
    prior[np.arange(p), np.arange(p)] += WIDEST_PX**-2.0
    if drift.wander_px:
        _walk(columns, prior, drift.wander_px)
    prior[:p, :p] += gauge
    more = np.arange(p, columns.size)
    prior[more, more] = columns.sizes_px**-2.0
    return hyper if drift.by else replace(hyper, drift=_scaled(first.drift, 1.0)), prior


def _different(columns: Design) -> list[DriftBelief]:
    """Beliefs that differ, the first choice's own smoothness before others: nothing can be smoother than the smoothest."""
    first = columns.observation.solution.hyper.drift
    by_kind = {}
    for one in sorted(DRIFTS, key=lambda one: abs(math.log(one.by or 1.0))):
        by_kind.setdefault((_drift_of(first, one), one.wander_px), one)
    return list(by_kind.values())


def _drift_of(first: Sequence[Smoothness], drift: DriftBelief) -> tuple[Smoothness, Smoothness]:
    if not drift.by:
        return Smoothness(3, SMOOTHEST_PX), Smoothness(3, SMOOTHEST_PX)
    one, two = (replace(kind, size_px=min(kind.size_px, ROUGHEST_PX)) for kind in _scaled(first, drift.by))
    return one, two


def _walk(columns: Design, prior: Array, wander_px: float) -> None:
    """Let the drift of a prior (p + r, p + r) walk at random, too: covariances add up."""
    state = columns.observation.state
    assert state.drift is not None  # there are pairs
    steps = state.drift.roughness(1)
    walk = np.linalg.inv(steps + STANDING * np.eye(len(steps))) * wander_px**2
    start = state.layout.part("drift").start
    for axis in (0, 1):
        at = np.searchsorted(columns.kept, start + axis + 2 * np.arange(len(steps)))
        loose = np.linalg.inv(np.linalg.inv(prior[np.ix_(at, at)]) + walk)
        prior[np.ix_(at, at)] = 0.5 * (loose + loose.T)


def rung(normal: Array, prior: Array, pull: Array, power: float, near: Array, hyper: Hyper, believed: float) -> Rung:
    """A baseline of p parameters, by what it left at a first solution.

    Args:
        normal: (p, p) A^T A.
        prior: (p, p) precision before the data.
        pull: (p,) A^T times what the first solution left, whitened.
        power: sum of the squares of what it left.
        near: (p,) that solution.
        hyper: its smoothness.
        believed: logarithm of how much that smoothness is believed in.
    """
    factor = cho_factor(normal + prior, lower=True, check_finite=False)
    held = prior @ near
    whole = pull - held
    asked = np.asarray(solve_triangular(factor[0], whole, lower=True, check_finite=False))
    volume = _half_log_det(prior) - float(np.sum(np.log(np.diag(factor[0]))))
    fit = power + float(near @ held) - float(asked @ asked)
    return Rung(hyper, prior, factor, volume - 0.5 * fit + believed, volume, whole, asked)


def _half_log_det(precision: Array) -> float:
    return float(np.sum(np.log(np.diag(cho_factor(precision, lower=True, check_finite=False)[0]))))


def _scaled(kinds: Sequence[Smoothness], by: float) -> tuple[Smoothness, Smoothness]:
    """Without a liking for any period: what swings is to be named."""
    one, two = (replace(kind, size_px=max(kind.size_px * by, SMOOTHEST_PX), swing_knots=0.0) for kind in kinds)
    return one, two
