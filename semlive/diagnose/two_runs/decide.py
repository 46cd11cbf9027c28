"""Comparison of two runs with different scan times: scan effects change with the scan, the distortion does not.

The baselines of both runs are joined with a common distortion; all other parameters are separate. Effects have the same nonlinear
parameters and the same amplitudes in both runs.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semlive.data.diagnosis.effects import Outcome, ParameterEstimate
from semlive.data.diagnosis.two_runs import SharedEffect, TwoRunVerdict
from semlive.diagnose.baseline.baseline import HyperparameterGrid, HyperparameterPoint, build_grid, evaluate_point, point_like
from semlive.diagnose.baseline.bayes_factor import ProjectedField, sizes_of
from semlive.diagnose.baseline.design_matrix import BaselineEffect
from semlive.diagnose.baseline.observation import sample_within_blocks
from semlive.diagnose.maps.adequacy import negligible_px
from semlive.diagnose.maps.effect_selection import MIN_LOG_ODDS, SIGNIFICANT_LOG_FACTOR
from semlive.diagnose.maps.parameter_search import optimise_parameters, parameter_uncertainty
from semlive.diagnose.maps.refinement import reported_parameters
from semlive.diagnose.two_runs.scan_rotation import analyse_scan_rotation, same_scan_times, scan_times_s
from semlive.diagnose.two_runs.separate_effects import separate_evidence
from semlive.errors import IllPosed
from semlive.estimate.joint.elimination.arrowhead import ComponentBlocks, factorise
from semlive.model.effects import TWO_RUN_EFFECT_CLASSES, BasisField, EffectClass, RunGeometry
from semlive.model.effects.effect_class import Values

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class JointBaseline:
    """Runs with a common distortion.

    Attributes:
        runs: baselines of the runs, with one point each.
        scenes: for each run, geometries of its frames and of frame 0 at the sample positions within blocks.
        residuals: for each run, (f, b, 2) whitened residual of its first solution with the distortion of the first run.
        place: for each run, (p_i,) indices of its parameters among the p parameters of all runs.
        point: posterior of the joint baseline.
    """

    runs: tuple[HyperparameterGrid, ...]
    scenes: tuple[tuple[tuple[RunGeometry, RunGeometry], ...], ...]
    residuals: tuple[Array, ...]
    place: tuple[NDArray[np.int64], ...]
    point: HyperparameterPoint

    def projected(self, basis_fields: Sequence[BasisField]) -> ProjectedField:
        """Project a basis field, given for each run, on the data of all runs."""
        q = basis_fields[0].field_px.shape[-1]
        alone, gradient, shared = np.zeros((q, q)), np.zeros(q), np.zeros((len(self.point.prior), q))
        for run, residual, place, basis_field in zip(self.runs, self.residuals, self.place, basis_fields, strict=True):
            white = run.design.whiten(basis_field.field_px)
            flat = white.reshape(-1, q)
            alone, gradient = alone + flat.T @ flat, gradient + flat.T @ residual.ravel()
            shared[place] += run.design.transposed(white)
        half = self.point.half(shared)
        values, vectors = np.linalg.eigh(alone - half.T @ half)
        gradient = vectors.T @ (gradient - half.T @ self.point.half_solved_gradient)
        return ProjectedField(np.clip(values, 0.0, None)[None], vectors[None], gradient[None])


def join_runs(runs: Sequence[HyperparameterGrid]) -> JointBaseline:
    """Join runs with a common distortion; its prior is that of the run with the largest joint evidence."""
    alone = [HyperparameterGrid(run.design, run.whitened_residual, (run.best,)) for run in runs]
    return max((_joined(alone, prior_run) for prior_run in range(len(alone))), key=lambda candidate: candidate.point.evidence)


def _joined(runs: Sequence[HyperparameterGrid], prior_run: int) -> JointBaseline:
    distortion_parameters = [_distortion(run) for run in runs]
    place, size = [], len(distortion_parameters[0])
    for run, own in zip(runs, distortion_parameters, strict=True):
        at = np.full(run.design.size, -1)
        at[own] = np.arange(len(own))
        separate = np.flatnonzero(at < 0)
        at[separate] = size + np.arange(len(separate))
        place.append(at)
        size += len(separate)
    normal, prior, first_solution, gradient, power, residual = (
        np.zeros((size, size)),
        np.zeros((size, size)),
        np.zeros(size),
        np.zeros(size),
        0.0,
        [],
    )
    starts = [_first(run) for run in runs]
    for number, (run, at, own, start) in enumerate(zip(runs, place, distortion_parameters, starts, strict=True)):
        step = np.zeros(run.design.size)
        step[own] = starts[0][distortion_parameters[0]] - start[own]
        residual.append(run.whitened_residual - run.design.apply(step[:, None])[..., 0])
        normal[np.ix_(at, at)] += run.design.normal_matrix
        own_prior = run.best.prior.copy()
        if number != prior_run:
            own_prior[np.ix_(own, own)] = 0.0
        prior[np.ix_(at, at)] += own_prior
        first_solution[at] = start + step
        gradient[at] += run.design.transposed(residual[-1][..., None])[:, 0]
        power += float(np.sum(residual[-1] ** 2))
    sides = [(at, run.best.factor.sides) for run, at in zip(runs, place, strict=True)]
    each = [[at[own] for own in (*where.own, where.shared)] for at, where in sides]
    where = ComponentBlocks(*(np.unique(np.concatenate(value)) for value in zip(*each, strict=True)))
    believed = prior, factorise(prior, where, 0.0).half_log_det
    both = evaluate_point(normal, believed, gradient, power, first_solution, runs[prior_run].best.hyper, 0.0, where)
    scenes = tuple(sample_within_blocks(run.design.observation) for run in runs)
    return JointBaseline(tuple(runs), scenes, tuple(residual), tuple(place), both)


def _distortion(run: HyperparameterGrid) -> NDArray[np.int64]:
    part = run.design.observation.state.layout.part("distortion")
    return np.flatnonzero((run.design.parameter_indices >= part.start) & (run.design.parameter_indices < part.stop))


def _first(run: HyperparameterGrid) -> Array:
    mean = run.design.observation.solution.mean[run.design.parameter_indices]
    return np.concatenate((mean, np.zeros(run.design.size - len(mean))))


@dataclass(frozen=True, slots=True, eq=False)
class _JointObjective:
    """Objective of an effect class over all runs."""

    joined: JointBaseline
    family: EffectClass
    size_px: float

    def grid(self) -> Iterable[Values]:
        return self.family.grid(self.joined.runs[0].design.observation.geometry)

    def basis_fields(self, values: Values) -> list[BasisField] | None:
        """Basis fields of each run relative to frame 0, with common physical amplitudes; None if a run does not observe the effect."""
        like = self.family.basis_field(self.joined.scenes[0][0][0], values)
        each = [] if like is None else [relative_to_reference(self.family, scenes, values, like) for scenes in self.joined.scenes]
        observed = [value for value in each if value is not None]
        return observed if like is not None and len(observed) == len(each) else None

    def evaluate(self, values: Values) -> ProjectedField | None:
        basis_fields = self.basis_fields(values)
        return None if basis_fields is None else self.joined.projected(basis_fields)


def relative_to_reference(
    family: EffectClass, scenes: Sequence[tuple[RunGeometry, RunGeometry]], values: Values, like: BasisField
) -> BasisField | None:
    """Basis field relative to frame 0, averaged over blocks; None if it is not observable.

    Args:
        family: the effect class.
        scenes: geometries of every frame and of frame 0, at each sample position within blocks.
        values: nonlinear parameters.
        like: basis field that defines the scale of the amplitudes.
    """
    basis_fields = [[family.basis_field(scene, values) for scene in both] for both in scenes]
    observed = [(now.rescaled_to(like), second.rescaled_to(like)) for now, second in basis_fields if now is not None and second is not None]
    if len(observed) < len(scenes):
        return None
    return replace(like, field_px=np.mean([now.field_px - second.field_px for now, second in observed], axis=0))


@dataclass(frozen=True, slots=True, eq=False)
class _JointEvidence:
    """Evidence for an effect class, with its most likely basis field and the joint baseline."""

    joined: JointBaseline
    family: EffectClass
    log_factor: float
    values: dict[str, float]
    size_px: float


def compare_runs(runs: Sequence[HyperparameterGrid]) -> TwoRunVerdict:
    """Identify the effect common to runs with different scans; several effects if the scan of the second run was rotated.

    Args:
        runs: baselines of the runs, with the given effects.

    Raises:
        IllPosed: the runs cannot be joined, or have equal scan times.
    """
    by_turn = analyse_scan_rotation(runs)
    if by_turn is not None:
        return by_turn
    _require_comparable(runs)
    joint = join_runs(runs)
    separate_log_odds = sum(join_runs([run]).point.evidence for run in runs) - joint.point.evidence
    screening = [
        _with_refitted_smoothness(tested, runs)
        for family in TWO_RUN_EFFECT_CLASSES
        if (tested := _joint_evidence(joint, family)) is not None
    ]
    separate = separate_evidence(runs)
    evidence = {name: item.log_factor for name, item in separate.items()} | {item.family.name: item.log_factor for item in screening}
    ranked = tuple(sorted(evidence.items(), key=lambda item: -item[1]))
    effect, largest, rivals = None, 0.0, ranked
    while effect is None and rivals and rivals[0][1] >= SIGNIFICANT_LOG_FACTOR:
        (name, largest), *rest = rivals
        found = next((_shared_effect(item) for item in screening if item.family.name == name), None) or separate[name].effect()
        negligible = max(negligible_px(name, run.design.observation.geometry) for run in runs)
        effect, rivals = found if found.peak_px > negligible else None, tuple(rest)
    if effect is None:
        return TwoRunVerdict(
            Outcome.UNKNOWN if separate_log_odds > SIGNIFICANT_LOG_FACTOR else Outcome.NONE, None, (), ranked, separate_log_odds
        )
    names = (*effect.aliases, *(name for name, factor in rivals if factor > largest - MIN_LOG_ODDS))
    if separate_log_odds > largest + SIGNIFICANT_LOG_FACTOR:
        return TwoRunVerdict(Outcome.UNKNOWN, effect, (), ranked, separate_log_odds)
    if len(names) > 1:
        return TwoRunVerdict(Outcome.AMBIGUOUS, effect, names, ranked, separate_log_odds)
    return TwoRunVerdict(Outcome.IDENTIFIED, effect, (), ranked, separate_log_odds, (effect,))


def _require_comparable(runs: Sequence[HyperparameterGrid]) -> None:
    states = [run.design.observation.state for run in runs]
    if any(state.distortion != states[0].distortion or state.grid != states[0].grid for state in states[1:]):
        raise IllPosed(
            "the runs have different grids or frame sizes: their distortions cannot be compared; replay one run with the grid of the other"
        )
    times = scan_times_s(runs)
    if same_scan_times(times):
        raise IllPosed(
            f"the runs have equal scan times, dwell {times[0, 0]:g} s and rows of {times[0, 1]:g} s: they separate no effects; "
            "record the second with half or twice the dwell, or with the scan rotated by 90 degrees and with moves along both axes"
        )


def _joint_evidence(joint: JointBaseline, family: EffectClass) -> _JointEvidence | None:
    """Evidence for an effect class from all runs: mean over basis fields and sizes, and the most likely of them."""
    sizes, tried = sizes_of(family), []
    for values in _JointObjective(joint, family, 0.0).grid():
        evaluated = _JointObjective(joint, family, 0.0).evaluate(values)
        if evaluated is not None:
            tried.append((dict(values), evaluated.log_factor(sizes)[0]))
    if not tried:
        return None
    each = np.stack([factors for _, factors in tried])
    basis_field, size = np.unravel_index(int(np.argmax(each)), each.shape)
    factor = float(np.logaddexp.reduce(each, axis=None)) - math.log(each.size)
    return _JointEvidence(joint, family, factor, tried[int(basis_field)][0], float(sizes[int(size)]))


def _with_refitted_smoothness(screening: _JointEvidence, runs: Sequence[HyperparameterGrid]) -> _JointEvidence:
    """Evidence with the smoothness of the drift selected jointly with the effect, if that is more likely.

    The drift that is most likely without the effect absorbs a part of it: the log Bayes factor of a row time error of 0.4 was 29 instead of
    110, and separate runs, which use all smoothness values, gave an oscillation or a ramp in 4 of 10 cases.
    """
    basis_fields = _JointObjective(screening.joined, screening.family, screening.size_px).basis_fields(screening.values)
    assert basis_fields is not None  # it was observable on the grid
    grids = []
    for run, basis_field in zip(runs, basis_fields, strict=True):
        baseline_with_effects = build_grid(
            run.design.with_effects(BaselineEffect(run.design.whiten(basis_field.field_px), screening.size_px))
        )
        grids.append(point_like(run.design, baseline_with_effects))
    joined = join_runs(grids)
    repeated = _joint_evidence(joined, screening.family)
    assert repeated is not None
    evidence_loss = min(joined.point.evidence - screening.joined.point.evidence, 0.0)
    return max((screening, replace(repeated, log_factor=repeated.log_factor + evidence_loss)), key=lambda candidate: candidate.log_factor)


def _shared_effect(screening: _JointEvidence) -> SharedEffect:
    gradient = _JointObjective(screening.joined, screening.family, screening.size_px)
    values = optimise_parameters(
        gradient, {nonlinear_parameter.name: 0.0 for nonlinear_parameter in screening.family.nonlinear_parameters} | screening.values
    )
    basis_fields, against = gradient.basis_fields(values), gradient.evaluate(values)
    assert basis_fields is not None  # it was observable on the grid
    assert against is not None
    mean, covariance = against.amplitudes(0, screening.size_px)
    sigmas, follows = parameter_uncertainty(gradient, values, mean)
    own = [
        ParameterEstimate(nonlinear_parameter.name, values[nonlinear_parameter.name], sigma, nonlinear_parameter.unit)
        for nonlinear_parameter, sigma in zip(screening.family.nonlinear_parameters, sigmas, strict=True)
    ]
    parameters = (*reported_parameters(basis_fields[0], mean, covariance + follows), *own)
    peak_px = max(
        _largest_px(screening.family, run.design.observation.geometry, values, basis_fields[0], mean) for run in screening.joined.runs
    )
    return SharedEffect(screening.family.name, screening.family.alias_rule(parameters) or (screening.family.name,), peak_px, parameters)


def _largest_px(family: EffectClass, scene: RunGeometry, values: Values, like: BasisField, amplitudes: Array) -> float:
    basis_field = family.basis_field(scene, values)
    return 0.0 if basis_field is None else float(np.max(np.hypot(*np.moveaxis(basis_field.rescaled_to(like).field_px @ amplitudes, -1, 0))))
