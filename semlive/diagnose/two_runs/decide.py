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

from semlive.data.diagnosis import Outcome, ParameterEstimate, SharedEffect, TwoRunVerdict
from semlive.diagnose.baseline.baseline import (
    BaselineEffect,
    HyperparameterGrid,
    HyperparameterPoint,
    build_grid,
    evaluate_point,
    point_like,
)
from semlive.diagnose.baseline.bayes_factor import ProjectedField, score_candidates, sizes_of
from semlive.diagnose.baseline.observation import sample_within_blocks
from semlive.diagnose.maps.effect_selection import MIN_LOG_ODDS, SIGNIFICANT_LOG_FACTOR
from semlive.diagnose.maps.refinement import optimise_parameters, parameter_uncertainty, reported_parameters
from semlive.diagnose.two_runs.scan_rotation import analyse_scan_rotation, same_scan_times, scan_times_s
from semlive.errors import IllPosed
from semlive.estimate.joint.elimination.arrowhead import ComponentBlocks, factorise
from semlive.model.effects import EFFECT_CLASSES, TWO_RUN_EFFECT_CLASSES, BasisField, EffectClass, RunGeometry
from semlive.model.effects.effect_class import Values

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class JointBaseline:
    """Runs with one distortion between them.

    Attributes:
        runs: their baselines, of one rung each.
        scenes: of each run what its frames saw, and where frame 0 had seen it, at the places that stand for all of a block.
        left: of each run (f, b, 2) whitened, what the first run's distortion and the run's own first solution leave.
        place: of each run (p_i,), which of the p parameters of all runs its own are.
        rung: all of it against all data.
    """

    runs: tuple[HyperparameterGrid, ...]
    scenes: tuple[tuple[tuple[RunGeometry, RunGeometry], ...], ...]
    left: tuple[Array, ...]
    place: tuple[NDArray[np.int64], ...]
    rung: HyperparameterPoint

    def projected(self, laws: Sequence[BasisField]) -> ProjectedField:
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
        pull = vectors.T @ (asked - half.T @ self.rung.half_solved_gradient)
        return ProjectedField(np.clip(values, 0.0, None)[None], vectors[None], pull[None])


def join_runs(runs: Sequence[HyperparameterGrid]) -> JointBaseline:
    """Runs with one distortion, as smooth as that run has it which makes all data likeliest."""
    alone = [HyperparameterGrid(one.design, one.whitened_residual, (one.best,)) for one in runs]
    return max((_joined(alone, believed_by) for believed_by in range(len(alone))), key=lambda one: one.rung.evidence)


def _joined(runs: Sequence[HyperparameterGrid], believed_by: int) -> JointBaseline:
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
        left.append(one.whitened_residual - one.design.apply(step[:, None])[..., 0])
        normal[np.ix_(at, at)] += one.design.normal_matrix
        own_prior = one.best.prior.copy()
        if number != believed_by:
            own_prior[np.ix_(own, own)] = 0.0
        prior[np.ix_(at, at)] += own_prior
        near[at] = start + step
        pull[at] += one.design.transposed(left[-1][..., None])[:, 0]
        power += float(np.sum(left[-1] ** 2))
    told = [(at, one.best.factor.sides) for one, at in zip(runs, place, strict=True)]
    each = [[at[own] for own in (*where.own, where.shared)] for at, where in told]
    where = ComponentBlocks(*(np.unique(np.concatenate(one)) for one in zip(*each, strict=True)))
    believed = prior, factorise(prior, where, 0.0).half_log_det
    both = evaluate_point(normal, believed, pull, power, near, runs[believed_by].best.hyper, 0.0, where)
    scenes = tuple(sample_within_blocks(one.design.observation) for one in runs)
    return JointBaseline(tuple(runs), scenes, tuple(left), tuple(place), both)


def _distortion(run: HyperparameterGrid) -> NDArray[np.int64]:
    part = run.design.observation.state.layout.part("distortion")
    return np.flatnonzero((run.design.parameter_indices >= part.start) & (run.design.parameter_indices < part.stop))


def _first(run: HyperparameterGrid) -> Array:
    mean = run.design.observation.solution.mean[run.design.parameter_indices]
    return np.concatenate((mean, np.zeros(run.design.size - len(mean))))


@dataclass(frozen=True, slots=True, eq=False)
class _Shared:
    """A family's laws against all runs."""

    joined: JointBaseline
    family: EffectClass
    size_px: float

    def grid(self) -> Iterable[Values]:
        return self.family.grid(self.joined.runs[0].design.observation.geometry)

    def laws(self, values: Values) -> list[BasisField] | None:
        """Of each run what changes from frame 0 on, with amplitudes that mean the same in all; None where a run cannot show the effect."""
        like = self.family.law(self.joined.scenes[0][0][0], values)
        each = [] if like is None else [relative_to_reference(self.family, scenes, values, like) for scenes in self.joined.scenes]
        seen = [one for one in each if one is not None]
        return seen if like is not None and len(seen) == len(each) else None

    def evaluate(self, values: Values) -> ProjectedField | None:
        laws = self.laws(values)
        return None if laws is None else self.joined.projected(laws)


def relative_to_reference(
    family: EffectClass, scenes: Sequence[tuple[RunGeometry, RunGeometry]], values: Values, like: BasisField
) -> BasisField | None:
    """What a law moves from frame 0 on, as blocks show it; None where it cannot be seen.

    Args:
        family: whose law it is.
        scenes: what every frame saw and where frame 0 had seen it, at each of the places that stand for all of a block.
        values: of what is not linear.
        like: a law whose amplitudes it gets.
    """
    told = [[family.law(scene, values) for scene in both] for both in scenes]
    seen = [(now.rescaled_to(like), then.rescaled_to(like)) for now, then in told if now is not None and then is not None]
    if len(seen) < len(scenes):
        return None
    return replace(like, field_px=np.mean([now.field_px - then.field_px for now, then in seen], axis=0))


@dataclass(frozen=True, slots=True, eq=False)
class _Heard:
    """A family, its likeliest law, and the runs as smooth as they are where it is heard."""

    joined: JointBaseline
    family: EffectClass
    log_factor: float
    values: dict[str, float]
    size_px: float


def compare_runs(runs: Sequence[HyperparameterGrid]) -> TwoRunVerdict:
    """Which effect runs with different scans show, if any; several where the second run's scan was turned.

    Args:
        runs: their baselines, with the effects that are known in them.

    Raises:
        IllPosed: the runs cannot be joined, or were scanned alike.
    """
    by_turn = analyse_scan_rotation(runs)
    if by_turn is not None:
        return by_turn
    _fit_each_other(runs)
    both = join_runs(runs)
    apart = sum(join_runs([one]).rung.evidence for one in runs) - both.rung.evidence
    heard = [_as_smooth_beside(one, runs) for family in TWO_RUN_EFFECT_CLASSES if (one := _heard(both, family)) is not None]
    evidence = _run_by_run(runs) | {one.family.name: one.log_factor for one in heard}
    told = tuple(sorted(evidence.items(), key=lambda item: -item[1]))
    loudest = told[0][1]
    if loudest < SIGNIFICANT_LOG_FACTOR:
        return TwoRunVerdict(Outcome.UNKNOWN if apart > SIGNIFICANT_LOG_FACTOR else Outcome.NONE, None, (), told, apart)
    effects = [_decided(one) for one in heard if one.family.name == told[0][0]] or [SharedEffect(told[0][0], (told[0][0],), 0.0, ())]
    names = (*effects[0].aliases, *(name for name, factor in told[1:] if factor > loudest - MIN_LOG_ODDS))
    if apart > loudest + SIGNIFICANT_LOG_FACTOR:
        return TwoRunVerdict(Outcome.UNKNOWN, effects[0], (), told, apart)
    if len(names) > 1:
        return TwoRunVerdict(Outcome.AMBIGUOUS, effects[0], names, told, apart)
    return TwoRunVerdict(Outcome.IDENTIFIED, effects[0], (), told, apart, (effects[0],))


def _fit_each_other(runs: Sequence[HyperparameterGrid]) -> None:
    states = [one.design.observation.state for one in runs]
    if any(one.distortion != states[0].distortion or one.grid != states[0].grid for one in states[1:]):
        raise IllPosed(
            "the runs have points or frames of different sizes: their distortions cannot be compared; replay one with the other's grid"
        )
    times = scan_times_s(runs)
    if same_scan_times(times):
        raise IllPosed(
            f"the runs were scanned alike, dwell {times[0, 0]:g} s and rows of {times[0, 1]:g} s: they decide nothing; "
            "take the second with half or twice the dwell, or turned by 90 degrees and with moves that tell so"
        )


def _heard(both: JointBaseline, family: EffectClass) -> _Heard | None:
    """A family against all runs: the mean over its laws and sizes, and the likeliest of them."""
    sizes, tried = sizes_of(family), []
    for values in _Shared(both, family, 0.0).grid():
        one = _Shared(both, family, 0.0).evaluate(values)
        if one is not None:
            tried.append((dict(values), one.log_factor(sizes)[0]))
    if not tried:
        return None
    each = np.stack([factors for _, factors in tried])
    law, size = np.unravel_index(int(np.argmax(each)), each.shape)
    factor = float(np.logaddexp.reduce(each, axis=None)) - math.log(each.size)
    return _Heard(both, family, factor, tried[int(law)][0], float(sizes[int(size)]))


def _as_smooth_beside(heard: _Heard, runs: Sequence[HyperparameterGrid]) -> _Heard:
    """The same with drifts as smooth as each run has them beside the effect, where it is likelier so.

    The drift that is likeliest without the effect follows a part of it: of a row time that was wrong by 0.4 the logarithm of the Bayes
    factor was 29 so, and is 110; runs by themselves, which ask all smoothnesses, were told to have a swing or a ramp in 4 of 10.
    """
    laws = _Shared(heard.joined, heard.family, heard.size_px).laws(heard.values)
    assert laws is not None  # it was seen on the grid
    beside = []
    for run, law in zip(runs, laws, strict=True):
        having = build_grid(run.design.with_effects(BaselineEffect(run.design.whiten(law.field_px), heard.size_px)))
        beside.append(point_like(run.design, having))
    other = join_runs(beside)
    again = _heard(other, heard.family)
    assert again is not None
    lost = min(other.rung.evidence - heard.joined.rung.evidence, 0.0)
    return max((heard, replace(again, log_factor=again.log_factor + lost)), key=lambda one: one.log_factor)


def _run_by_run(runs: Sequence[HyperparameterGrid]) -> dict[str, float]:
    """All other names: what they gain in each run, where nothing is shared."""
    shared = {one.name for one in TWO_RUN_EFFECT_CLASSES}
    families, total = [one for one in EFFECT_CLASSES if one.name not in shared], dict[str, float]()
    for run in runs:
        for one in score_candidates(run, families):
            total[one.family.name] = total.get(one.family.name, 0.0) + one.log_factor
    return total


def _decided(heard: _Heard) -> SharedEffect:
    asked = _Shared(heard.joined, heard.family, heard.size_px)
    values = optimise_parameters(asked, {one.name: 0.0 for one in heard.family.nonlinear_parameters} | heard.values)
    laws, against = asked.laws(values), asked.evaluate(values)
    assert laws is not None  # it was seen on the grid
    assert against is not None
    mean, covariance = against.amplitudes(0, heard.size_px)
    sigmas, follows = parameter_uncertainty(asked, values, mean)
    own = [
        ParameterEstimate(one.name, values[one.name], sigma, one.unit)
        for one, sigma in zip(heard.family.nonlinear_parameters, sigmas, strict=True)
    ]
    parameters = (*reported_parameters(laws[0], mean, covariance + follows), *own)
    peak_px = max(_largest_px(heard.family, one.design.observation.geometry, values, laws[0], mean) for one in heard.joined.runs)
    return SharedEffect(heard.family.name, heard.family.alias_rule(parameters) or (heard.family.name,), peak_px, parameters)


def _largest_px(family: EffectClass, scene: RunGeometry, values: Values, like: BasisField, amplitudes: Array) -> float:
    law = family.law(scene, values)
    return 0.0 if law is None else float(np.max(np.hypot(*np.moveaxis(law.rescaled_to(like).field_px @ amplitudes, -1, 0))))
