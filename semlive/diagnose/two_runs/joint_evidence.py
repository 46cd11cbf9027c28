"""Evidence for one effect class from all joined runs.

Effects have the same nonlinear parameters and the same physical amplitudes in all runs. Where the pixel sizes differ, the amplitude of a
deflection is the same on the specimen or the same in pixels of the scan generator; both are tried.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from semlive.diagnose.baseline.baseline import HyperparameterGrid, build_grid, point_like
from semlive.diagnose.baseline.bayes_factor import ProjectedField, sizes_of
from semlive.diagnose.baseline.design_matrix import BaselineEffect
from semlive.diagnose.maps.effect_selection import MIN_LOG_ODDS
from semlive.diagnose.maps.parameter_search import optimise_parameters
from semlive.diagnose.two_runs.join import JointBaseline, join_runs
from semlive.model.effects import TWO_TERM_CLASSES, BasisField, EffectClass, RunGeometry
from semlive.model.effects.effect_class import Values

AMPLITUDE_POWER = "amplitude_power"
"""Power of the inverse pixel size that amplitudes in px follow: 0 for the scan generator, 1 for the specimen."""
FIELD_GROUP = "G4"
"""Group of the deflections whose amplitudes follow one of these powers."""


@dataclass(frozen=True, slots=True, eq=False)
class JointObjective:
    """Objective of an effect class over all runs."""

    joined: JointBaseline
    family: EffectClass
    size_px: float

    @property
    def sums(self) -> None:
        """None: no class that two runs share is linear in its parameters."""
        return

    def grid(self) -> Iterable[Values]:
        """Values of the grid of the first run; with several pixel sizes, with each power of the amplitude."""
        values = self.family.grid(self.joined.runs[0].design.observation.geometry)
        if self.family.group != FIELD_GROUP or len({run.design.observation.geometry.pixel_ratio for run in self.joined.runs}) == 1:
            return values
        return ({**value, AMPLITUDE_POWER: power} for value in values for power in (0.0, 1.0))

    def basis_fields(self, values: Values) -> list[BasisField] | None:
        """Basis fields of each run relative to frame 0, with common physical amplitudes; None if a run does not observe the effect."""
        like = self.family.basis_field(self.joined.scenes[0][0][0], values)
        each = [] if like is None else [relative_to_reference(self.family, scenes, values, like) for scenes in self.joined.scenes]
        observed = [value for value in each if value is not None]
        if like is None or len(observed) < len(each):
            return None
        power = values.get(AMPLITUDE_POWER, 0.0)
        return [
            replace(value, field_px=value.field_px * scenes[0][0].pixel_ratio ** -power) if power else value
            for value, scenes in zip(observed, self.joined.scenes, strict=True)
        ]

    def evaluate(self, values: Values) -> ProjectedField | None:
        """Basis field at parameter values, projected on the data of all runs; None if it is not observable."""
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
class JointEvidence:
    """Evidence for an effect class, with its most likely basis field and the joint baseline."""

    joined: JointBaseline
    family: EffectClass
    log_factor: float
    values: dict[str, float]
    size_px: float


def joint_evidence(joint: JointBaseline, family: EffectClass) -> JointEvidence | None:
    """Evidence for an effect class from all runs: mean over basis fields and sizes, and the most likely of them."""
    sizes, tried = sizes_of(family), []
    for values in JointObjective(joint, family, 0.0).grid():
        evaluated = JointObjective(joint, family, 0.0).evaluate(values)
        if evaluated is not None:
            tried.append((dict(values), evaluated.log_factor(sizes)[0]))
    if not tried:
        return None
    each = np.stack([factors for _, factors in tried])
    basis_field, size = np.unravel_index(int(np.argmax(each)), each.shape)
    factor = float(np.logaddexp.reduce(each, axis=None)) - math.log(each.size)
    return JointEvidence(joint, family, factor, tried[int(basis_field)][0], float(sizes[int(size)]))


def with_refitted_smoothness(screening: JointEvidence, runs: Sequence[HyperparameterGrid]) -> JointEvidence:
    """Evidence with the smoothness of the drift selected jointly with the effect, if that is more likely.

    The drift that is most likely without the effect absorbs a part of it: the log Bayes factor of a row time error of 0.4 was 29 instead of
    110, and separate runs, which use all smoothness values, gave an oscillation or a ramp in 4 of 10 cases.
    """
    basis_fields = JointObjective(screening.joined, screening.family, screening.size_px).basis_fields(screening.values)
    assert basis_fields is not None  # it was observable on the grid
    grids = []
    for run, basis_field in zip(runs, basis_fields, strict=True):
        baseline_with_effects = build_grid(
            run.design.with_effects(BaselineEffect(run.design.whiten(basis_field.field_px), screening.size_px))
        )
        grids.append(point_like(run.design, baseline_with_effects))
    joined = join_runs(grids)
    repeated = joint_evidence(joined, screening.family)
    assert repeated is not None
    evidence_loss = min(joined.point.evidence - screening.joined.point.evidence, 0.0)
    return max((screening, replace(repeated, log_factor=repeated.log_factor + evidence_loss)), key=lambda candidate: candidate.log_factor)


def refined(candidate: JointEvidence) -> JointEvidence:
    """Evidence with the most likely constants between the values of the grid; the prior of the constants is that of the grid."""
    objective = JointObjective(candidate.joined, candidate.family, candidate.size_px)
    on_grid = objective.evaluate(candidate.values)
    if on_grid is None or not candidate.family.nonlinear_parameters:
        return candidate
    values, optimum = _optimum(objective, candidate.values)
    gain = optimum - _mean_over_sizes(on_grid, candidate.family)
    return replace(candidate, log_factor=candidate.log_factor + gain, values=values) if gain > 0.0 else candidate


def with_second_term(single: JointEvidence) -> JointEvidence | None:
    """Settling with two exponentials, if it is more likely than with one by odds of 20; None if not, and for all other classes.

    Both are compared at their most likely constants, because two terms of a coarse grid describe one between grid values. The second
    constant costs a factor of as many values as the grid of the first has.
    """
    family = TWO_TERM_CLASSES.get(single.family.name)
    if family is None:
        return None
    objective, first = JointObjective(single.joined, family, single.size_px), JointObjective(single.joined, single.family, single.size_px)
    size, power = np.array([single.size_px]), single.values.get(AMPLITUDE_POWER, 0.0)
    scored = [
        (float(projected.log_factor(size)[0, 0]), dict(values))
        for values in objective.grid()
        if values.get(AMPLITUDE_POWER, 0.0) == power and (projected := objective.evaluate(values)) is not None
    ]
    best, start = max(scored, key=lambda entry: entry[0])
    on_grid = first.evaluate(single.values)
    assert on_grid is not None  # it was observable on the grid
    if best < float(on_grid.log_factor(size)[0, 0]):
        return None
    (_, one), (values, two) = _optimum(first, single.values), _optimum(objective, start)
    gain = two - one - math.log(sum(1 for _ in first.grid()))
    return JointEvidence(single.joined, family, single.log_factor + gain, values, single.size_px) if gain > MIN_LOG_ODDS else None


def _optimum(objective: JointObjective, start: Values) -> tuple[dict[str, float], float]:
    """Most likely parameters near a start, and their log Bayes factor, mean over the sizes."""
    values = optimise_parameters(objective, start)
    projected = objective.evaluate(values)
    assert projected is not None  # it was observable at the start
    return values, _mean_over_sizes(projected, objective.family)


def _mean_over_sizes(projected: ProjectedField, family: EffectClass) -> float:
    """Log Bayes factor, mean over the sizes of a class."""
    factors = projected.log_factor(sizes_of(family))[0]
    return float(np.logaddexp.reduce(factors)) - math.log(len(factors))
