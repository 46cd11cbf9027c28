"""The baseline: drift, distortion and motion as the estimator has them, effects that were found, and what the data leave of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semlive.diagnose.belief import BENDING, Beliefs, DriftBelief
from semlive.diagnose.observation import Observation
from semlive.diagnose.side_by_side import side_by_side
from semlive.diagnose.whiten import Whitener
from semlive.estimate.accumulate import map_columns
from semlive.estimate.arrow import Factor, Sides, factored
from semlive.estimate.evidence import log_belief
from semlive.estimate.prior import Hyper

Array = NDArray[np.float64]

ANY_DISTORTION = 10.0
BELIEF = 4.0  # standard deviation of the logarithm about the first choice
DISTORTION_RUNGS = (0.3, 1.0, 3.0)
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
        beliefs: what may be believed of the baseline's own parameters.
    """

    observation: Observation
    whiten: Whitener
    columns: tuple[Array, Array]
    own: tuple[Moving, Moving]
    index: tuple[NDArray[np.int64], NDArray[np.int64]]
    kept: NDArray[np.int64]
    normal: Array
    sizes_px: Array
    beliefs: Beliefs

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self.normal)

    def transposed(self, white: Array) -> Array:
        """(p + r, q) A^T times whitened fields (f, b, 2, q)."""
        total = np.zeros((self.size, white.shape[-1]))
        for axis in (0, 1):
            total[self.index[axis]] += self.along(axis, np.moveaxis(white[:, :, axis], -1, 0))
        return total

    def along(self, axis: int, rows: Array) -> Array:
        """(m, q) columns of one axis times whitened fields (q, f, b).

        Whitened fields have no mean over the frames, so the columns' own need not be taken away, and most columns of the drift move three
        frames of thirty: a third of the time.
        """
        columns, own = self.columns[axis], self.own[axis]
        total = np.zeros((columns.shape[1], len(rows)))
        for frame, (at, block) in enumerate(own):
            total[at] += block.T @ rows[:, frame].T
        effects = columns[:, columns.shape[1] - len(self.sizes_px) :]
        total[columns.shape[1] - len(self.sizes_px) :] += effects.T @ rows.reshape(len(rows), len(columns)).T
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

    def spans(self, fields: Sequence[Array], known: int) -> tuple[slice, ...]:
        """Where the amplitudes of effects (f, b, 2, q) are among all: the first `known` came first, the others last.

        What was added since a spline of the baseline was too coarse lies between.
        """
        widths = [one.shape[-1] for one in fields]
        between, ends = len(self.sizes_px) - sum(widths), np.cumsum(widths).tolist()
        starts = [end - width + (0 if place < known else between) for place, (end, width) in enumerate(zip(ends, widths, strict=True))]
        return tuple(slice(start, start + width) for start, width in zip(starts, widths, strict=True))

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
    both, own = (columns[0], columns[1]), (moving[0], moving[1])
    beliefs = Beliefs.of(observation, kept)
    return Design(observation, whiten, both, own, (index[0], index[1]), kept, normal, np.zeros(0), beliefs)


@dataclass(frozen=True, slots=True, eq=False)
class Rung:
    """A baseline with one smoothness.

    Attributes:
        hyper: the smoothness.
        prior: (p + r, p + r) precision before the data.
        factor: of the posterior precision.
        evidence: logarithm of the likelihood of the data, up to a constant that all rungs share.
        room: the part of it, negative, that comes from what else there might have been.
        pull: (p + r,) what residuals and belief ask for at the first solution.
        asked: (p + r,) the same, half solved.
        belief: of the drift, and the roughness of the distortion in that of the first choice; None of runs that were joined.
    """

    hyper: Hyper
    prior: Array
    factor: Factor
    evidence: float
    room: float
    pull: Array
    asked: Array
    belief: tuple[DriftBelief, float] | None = None

    def half(self, right: Array) -> Array:
        """(p + r, ...) inverse of the factor times (p + r, ...): products of two such are those of a solution with one right side."""
        return self.factor.half(right)

    def solve(self, right: Array) -> Array:
        """(p + r, q) posterior covariance times (p + r, q)."""
        return self.factor.solve(right)


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

    @property
    def likelihood(self) -> float:
        """The same in px and not in units of the noise: to be set beside that of the same maps about another solution."""
        whiten, f = self.design.whiten, self.design.observation.frames
        volume = len(whiten.factor) * np.log(whiten.sigma_px) + np.sum(np.log(np.diag(whiten.factor)))
        return float(self.evidence - 2.0 * (f - 1) * volume)

    def residual(self) -> Array:
        """(f, b, 2) whitened, what the likeliest baseline leaves."""
        step = self.best.solve(self.best.pull[:, None])
        return self.left - self.design.times(step)[..., 0]


def ladder(columns: Design) -> Ladder:
    """For each smoothness of the drift the baseline with the likeliest of the distortion's, but for those that have no hope."""
    tries = _Tries.of(columns)
    plain = side_by_side(lambda one: (one, tries.rung(one, 1.0)), columns.beliefs.different())
    best = max((rung for _, rung in plain), key=lambda one: one.evidence)
    kept = [(one, rung) for one, rung in plain if rung.evidence > best.evidence - HOPELESS or rung.room > best.room]
    rungs = side_by_side(lambda both: max((both[1], *tries.bent(both[0])), key=lambda one: one.evidence), kept)
    return Ladder(columns, tries.left, tuple(rungs))


def likeliest(columns: Design) -> Ladder:
    """A ladder of one rung: the likeliest smoothness of the drift, and then of the distortion."""
    tries = _Tries.of(columns)
    found = dict(side_by_side(lambda one: (one, tries.rung(one, 1.0)), columns.beliefs.different()))
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
    near: Array
    left: Array
    pull: Array
    power: float

    @classmethod
    def of(cls, columns: Design) -> _Tries:
        near = np.concatenate((columns.observation.solution.mean[columns.kept], np.zeros(columns.size - len(columns.kept))))
        left = columns.whiten(columns.observation.disparity_px) - columns.times(near[:, None])[..., 0]
        return cls(columns, near, left, columns.transposed(left[..., None])[:, 0], float(np.sum(left**2)))

    def rung(self, drift: DriftBelief, also: float) -> Rung:
        columns, belief = self.columns, self.columns.beliefs.belief(drift, also)
        prior = _beside(belief.precision, columns.sizes_px) if columns.sizes_px.size else belief.precision
        volume, own = belief.half_log_det - float(np.sum(np.log(columns.sizes_px))), columns.beliefs.sides
        where = replace(own, shared=np.concatenate((own.shared, np.arange(len(columns.kept), columns.size))))
        believed = log_belief(np.array([drift.by or 1.0]), (1.0, BELIEF)) + log_belief(np.array([also]), (1.0, BELIEF))
        found = rung(columns.normal, (prior, volume), self.pull, self.power, self.near, belief.hyper, float(believed[0]), where)
        return replace(found, belief=(drift, also))

    def bent(self, drift: DriftBelief) -> list[Rung]:
        """With other smoothnesses of the distortion than the first choice."""
        return [self.rung(drift, also) for also in DISTORTION_RUNGS if also != 1.0]


def _beside(precision: Array, sizes_px: Array) -> Array:
    """(p + r, p + r) precision before the data of the baseline's own parameters, and of amplitudes of effects."""
    p, r = len(precision), len(sizes_px)
    total = np.zeros((p + r, p + r))
    total[:p, :p] = precision
    total[range(p, p + r), range(p, p + r)] = sizes_px**-2.0
    return total


def rung(
    normal: Array, prior: tuple[Array, float], pull: Array, power: float, near: Array, hyper: Hyper, believed: float, where: Sides
) -> Rung:
    """A baseline of p parameters, by what it left at a first solution.

    Args:
        normal: (p, p) A^T A.
        prior: (p, p) precision before the data, and half the logarithm of its determinant.
        pull: (p,) A^T times what the first solution left, whitened.
        power: sum of the squares of what it left.
        near: (p,) that solution.
        hyper: its smoothness.
        believed: logarithm of how much that smoothness is believed in.
        where: which parameters act along x or along y alone.
    """
    factor = factored(normal + prior[0], where, 0.0)
    held = prior[0] @ near
    whole = pull - held
    asked = factor.half(whole)
    volume = prior[1] - factor.half_log_det
    fit = power + float(near @ held) - float(asked @ asked)
    return Rung(hyper, prior[0], factor, volume - 0.5 * fit + believed, volume, whole, asked)
