"""Two runs with different scans: what one takes for distortion moves in the other, and the distortion itself does not.

The baselines of both runs are joined with one distortion for both; everything else is each run's own. What a law says is shared: the
same time constant and the same amplitudes in both.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semlive.data.diagnosis import Decided, Decision, FoundParameter, Outcome
from semlive.diagnose.baseline import Found, Ladder, Rung, as_smooth, ladder, rung
from semlive.diagnose.evidence import Projected, sizes_of, weigh
from semlive.diagnose.named import LOUD, ODDS
from semlive.diagnose.observation import within_blocks
from semlive.diagnose.refine import between, left_open, linear
from semlive.diagnose.turned import scan_times_s, scanned_alike, turned
from semlive.errors import IllPosed
from semlive.estimate.arrow import Sides, factored
from semlive.model.effects import BETWEEN_SCANS, DICTIONARY, Family, Law, Scene
from semlive.model.effects.family import Values

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Joined:
    """Runs with one distortion between them.

    Attributes:
        runs: their baselines, of one rung each.
        scenes: of each run what its frames saw, and where frame 0 had seen it, at the places that stand for all of a block.
        left: of each run (f, b, 2) whitened, what the first run's distortion and the run's own first solution leave.
        place: of each run (p_i,), which of the p parameters of all runs its own are.
        rung: all of it against all data.
    """

    runs: tuple[Ladder, ...]
    scenes: tuple[tuple[tuple[Scene, Scene], ...], ...]
    left: tuple[Array, ...]
    place: tuple[NDArray[np.int64], ...]
    rung: Rung

    def projected(self, laws: Sequence[Law]) -> Projected:
        """A law, as it is in each run, against the data."""
        q = laws[0].field_px.shape[-1]
        alone, asked, shared = np.zeros((q, q)), np.zeros(q), np.zeros((len(self.rung.prior), q))
        for run, left, place, law in zip(self.runs, self.left, self.place, laws, strict=True):
            white = run.design.whiten(law.field_px)
            flat = white.reshape(-1, q)
            alone, asked = alone + flat.T @ flat, asked + flat.T @ left.ravel()
            shared[place] += run.design.transposed(white)
        half = self.rung.half(shared)
        values, vectors = np.linalg.eigh(alone - half.T @ half)
        pull = vectors.T @ (asked - half.T @ self.rung.asked)
        return Projected(np.clip(values, 0.0, None)[None], vectors[None], pull[None])


def joined_runs(runs: Sequence[Ladder]) -> Joined:
    """Runs with one distortion, as smooth as that run has it which makes all data likeliest."""
    alone = [Ladder(one.design, one.left, (one.best,)) for one in runs]
    return max((_joined(alone, believed_by) for believed_by in range(len(alone))), key=lambda one: one.rung.evidence)


def _joined(runs: Sequence[Ladder], believed_by: int) -> Joined:
    bent = [_distortion(one) for one in runs]
    place, size = [], len(bent[0])
    for one, own in zip(runs, bent, strict=True):
        at = np.full(one.design.size, -1)
        at[own] = np.arange(len(own))
        others = np.flatnonzero(at < 0)
        at[others] = size + np.arange(len(others))
        place.append(at)
        size += len(others)
    normal, prior, near, pull, power, left = np.zeros((size, size)), np.zeros((size, size)), np.zeros(size), np.zeros(size), 0.0, []
    starts = [_first(one) for one in runs]
    for number, (one, at, own, start) in enumerate(zip(runs, place, bent, starts, strict=True)):
        step = np.zeros(one.design.size)
        step[own] = starts[0][bent[0]] - start[own]
        left.append(one.left - one.design.times(step[:, None])[..., 0])
        normal[np.ix_(at, at)] += one.design.normal
        own_prior = one.best.prior.copy()
        if number != believed_by:
            own_prior[np.ix_(own, own)] = 0.0
        prior[np.ix_(at, at)] += own_prior
        near[at] = start + step
        pull[at] += one.design.transposed(left[-1][..., None])[:, 0]
        power += float(np.sum(left[-1] ** 2))
    told = [(at, one.best.factor.sides) for one, at in zip(runs, place, strict=True)]
    each = [[at[own] for own in (*where.own, where.shared)] for at, where in told]
    where = Sides(*(np.unique(np.concatenate(one)) for one in zip(*each, strict=True)))
    believed = prior, factored(prior, where, 0.0).half_log_det
    both = rung(normal, believed, pull, power, near, runs[believed_by].best.hyper, 0.0, where)
    scenes = tuple(within_blocks(one.design.observation) for one in runs)
    return Joined(tuple(runs), scenes, tuple(left), tuple(place), both)


def _distortion(run: Ladder) -> NDArray[np.int64]:
    part = run.design.observation.state.layout.part("distortion")
    return np.flatnonzero((run.design.kept >= part.start) & (run.design.kept < part.stop))


def _first(run: Ladder) -> Array:
    mean = run.design.observation.solution.mean[run.design.kept]
    return np.concatenate((mean, np.zeros(run.design.size - len(mean))))


@dataclass(frozen=True, slots=True, eq=False)
class _Shared:
    """A family's laws against all runs."""

    joined: Joined
    family: Family
    size_px: float

    def grid(self) -> Iterable[Values]:
        return self.family.grid(self.joined.runs[0].design.observation.scene)

    def laws(self, values: Values) -> list[Law] | None:
        """Of each run what changes from frame 0 on, with amplitudes that mean the same in all; None where a run cannot show the effect."""
        like = self.family.law(self.joined.scenes[0][0][0], values)
        each = [] if like is None else [since_frame_0(self.family, scenes, values, like) for scenes in self.joined.scenes]
        seen = [one for one in each if one is not None]
        return seen if like is not None and len(seen) == len(each) else None

    def at(self, values: Values) -> Projected | None:
        laws = self.laws(values)
        return None if laws is None else self.joined.projected(laws)


def since_frame_0(family: Family, scenes: Sequence[tuple[Scene, Scene]], values: Values, like: Law) -> Law | None:
    """What a law moves from frame 0 on, as blocks show it; None where it cannot be seen.

    Args:
        family: whose law it is.
        scenes: what every frame saw and where frame 0 had seen it, at each of the places that stand for all of a block.
        values: of what is not linear.
        like: a law whose amplitudes it gets.
    """
    told = [[family.law(scene, values) for scene in both] for both in scenes]
    seen = [(now.meaning(like), then.meaning(like)) for now, then in told if now is not None and then is not None]
    if len(seen) < len(scenes):
        return None
    return replace(like, field_px=np.mean([now.field_px - then.field_px for now, then in seen], axis=0))


@dataclass(frozen=True, slots=True, eq=False)
class _Heard:
    """A family, its likeliest law, and the runs as smooth as they are where it is heard."""

    joined: Joined
    family: Family
    log_factor: float
    values: dict[str, float]
    size_px: float


def decide(runs: Sequence[Ladder]) -> Decision:
    """Which effect runs with different scans show, if any; several where the second run's scan was turned.

    Args:
        runs: their baselines, with the effects that are known in them.

    Raises:
        IllPosed: the runs cannot be joined, or were scanned alike.
    """
    by_turn = turned(runs)
    if by_turn is not None:
        return by_turn
    _fit_each_other(runs)
    both = joined_runs(runs)
    apart = sum(joined_runs([one]).rung.evidence for one in runs) - both.rung.evidence
    heard = [_as_smooth_beside(one, runs) for family in BETWEEN_SCANS if (one := _heard(both, family)) is not None]
    evidence = _run_by_run(runs) | {one.family.name: one.log_factor for one in heard}
    told = tuple(sorted(evidence.items(), key=lambda item: -item[1]))
    loudest = told[0][1]
    if loudest < LOUD:
        return Decision(Outcome.UNKNOWN if apart > LOUD else Outcome.NONE, None, (), told, apart)
    effects = [_decided(one) for one in heard if one.family.name == told[0][0]] or [Decided(told[0][0], (told[0][0],), 0.0, ())]
    names = (*effects[0].names, *(name for name, factor in told[1:] if factor > loudest - ODDS))
    if apart > loudest + LOUD:
        return Decision(Outcome.UNKNOWN, effects[0], (), told, apart)
    if len(names) > 1:
        return Decision(Outcome.AMBIGUOUS, effects[0], names, told, apart)
    return Decision(Outcome.IDENTIFIED, effects[0], (), told, apart, (effects[0],))


def _fit_each_other(runs: Sequence[Ladder]) -> None:
    states = [one.design.observation.state for one in runs]
    if any(one.distortion != states[0].distortion or one.grid != states[0].grid for one in states[1:]):
        raise IllPosed(
            "the runs have points or frames of different sizes: their distortions cannot be compared; replay one with the other's grid"
        )
    times = scan_times_s(runs)
    if scanned_alike(times):
        raise IllPosed(
            f"the runs were scanned alike, dwell {times[0, 0]:g} s and rows of {times[0, 1]:g} s: they decide nothing; "
            "take the second with half or twice the dwell, or turned by 90 degrees and with moves that tell so"
        )


def _heard(both: Joined, family: Family) -> _Heard | None:
    """A family against all runs: the mean over its laws and sizes, and the likeliest of them."""
    sizes, tried = sizes_of(family), []
    for values in _Shared(both, family, 0.0).grid():
        one = _Shared(both, family, 0.0).at(values)
        if one is not None:
            tried.append((dict(values), one.log_factor(sizes)[0]))
    if not tried:
        return None
    each = np.stack([factors for _, factors in tried])
    law, size = np.unravel_index(int(np.argmax(each)), each.shape)
    factor = float(np.logaddexp.reduce(each, axis=None)) - math.log(each.size)
    return _Heard(both, family, factor, tried[int(law)][0], float(sizes[int(size)]))


def _as_smooth_beside(heard: _Heard, runs: Sequence[Ladder]) -> _Heard:
    """The same with drifts as smooth as each run has them beside the effect, where it is likelier so.

    The drift that is likeliest without the effect follows a part of it: of a row time that was wrong by 0.4 the logarithm of the Bayes
    factor was 29 so, and is 110; runs by themselves, which ask all smoothnesses, were told to have a swing or a ramp in 4 of 10.
    """
    laws = _Shared(heard.joined, heard.family, heard.size_px).laws(heard.values)
    assert laws is not None  # it was seen on the grid
    beside = []
    for run, law in zip(runs, laws, strict=True):
        having = ladder(run.design.having(Found(run.design.whiten(law.field_px), heard.size_px)))
        beside.append(as_smooth(run.design, having))
    other = joined_runs(beside)
    again = _heard(other, heard.family)
    assert again is not None
    lost = min(other.rung.evidence - heard.joined.rung.evidence, 0.0)
    return max((heard, replace(again, log_factor=again.log_factor + lost)), key=lambda one: one.log_factor)


def _run_by_run(runs: Sequence[Ladder]) -> dict[str, float]:
    """All other names: what they gain in each run, where nothing is shared."""
    shared = {one.name for one in BETWEEN_SCANS}
    families, total = [one for one in DICTIONARY if one.name not in shared], dict[str, float]()
    for run in runs:
        for one in weigh(run, families):
            total[one.family.name] = total.get(one.family.name, 0.0) + one.log_factor
    return total


def _decided(heard: _Heard) -> Decided:
    asked = _Shared(heard.joined, heard.family, heard.size_px)
    values = between(asked, {one.name: 0.0 for one in heard.family.thetas} | heard.values)
    laws, against = asked.laws(values), asked.at(values)
    assert laws is not None  # it was seen on the grid
    assert against is not None
    mean, covariance = against.amplitudes(0, heard.size_px)
    sigmas, follows = left_open(asked, values, mean)
    own = [FoundParameter(one.name, values[one.name], sigma, one.unit) for one, sigma in zip(heard.family.thetas, sigmas, strict=True)]
    parameters = (*linear(laws[0], mean, covariance + follows), *own)
    peak_px = max(_largest_px(heard.family, one.design.observation.scene, values, laws[0], mean) for one in heard.joined.runs)
    return Decided(heard.family.name, heard.family.told(parameters) or (heard.family.name,), peak_px, parameters)


def _largest_px(family: Family, scene: Scene, values: Values, like: Law, amplitudes: Array) -> float:
    law = family.law(scene, values)
    return 0.0 if law is None else float(np.max(np.hypot(*np.moveaxis(law.meaning(like).field_px @ amplitudes, -1, 0))))
