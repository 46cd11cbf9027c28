"""Stepwise search: effects are added one at a time, the most significant first, until the residual is consistent with noise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.bayes_factor import CandidateEvidence, NullDraws, project_candidates, score_candidates, with_draws
from semlive.diagnose.baseline.projection import Projections
from semlive.diagnose.maps.effect_selection import (
    CERTAIN_LOG_FACTOR,
    MIN_LOG_ODDS,
    SIGNIFICANCE_LEVEL,
    SIGNIFICANT_LOG_FACTOR,
    SelectedEffect,
    add_effect,
    rebuild_baseline,
    refine_parameters,
    remove_unnecessary,
    reselect_effects,
)
from semlive.diagnose.maps.screening import Screening
from semlive.diagnose.maps.spline_resolution import FINE_SCALE_CLASSES, add_fine_scale_terms, fine_scale_candidates, has_room_for_terms
from semlive.diagnose.maps.unnamed_fields import UNNAMED_CLASSES
from semlive.model.effects import EffectClass
from semlive.model.effects.maps.image_motion import DRIFT_JUMP, THERMAL_OSCILLATION

MAX_EFFECTS = 3  # several of one class count once
MAX_WORK_PER_FRAME = 2.2e10
"""Multiplications of all searches of a verdict, for each frame, about: 45 s of two cores for 15 pairs. Three searches for two effects need
up to 1.8e10, two searches for three effects 1.5e10. With 1.8e10 the third search for two effects, which was expected to need more than it
did, was omitted, and the verdict was UNKNOWN with two wrong effects."""
# A drift that wanders has local rises, and the priors of the drift have few shapes. In runs of an independent generator four jumps that
# were not there had 7 to 17, and two oscillations next to another effect 9. Of the blind set at twice the limit, 25 true jumps have at
# least 23, and at eight times 17 oscillations next to another effect at least 75.
MIN_JUMP_LOG_FACTOR = 15.0
EVALUATIONS = 25  # of a basis field, in the refinement of an effect, for each nonlinear parameter
FEW_COLUMNS_FACTOR = 8.0  # time of a multiplication with the few columns of one field, relative to that with many: it reads all data
ALL_UNNAMED_CLASSES = (*UNNAMED_CLASSES, *FINE_SCALE_CLASSES)
"""Candidates that are not reported as effects: unnamed fields, and terms of the baseline finer than its splines."""


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """State of the search.

    Attributes:
        baseline: the baseline without effects.
        baseline_with_effects: the baseline with the selected effects.
        effects: the selected effects.
        initial_screening: evidence of all candidates before the first selection.
        excluded: effect classes that were selected, once for each time; none is tested again beyond its largest number.
        fine_scale_candidates: candidates for components of the baseline finer than its splines.
        underresolved_splines: names of splines that are too coarse; their residual has been added to the baseline.
        remaining: the most likely class in the remaining residual, if it is significant; else None.
        work: number of multiplications of the verdict so far, earlier searches and screenings included, about.
        truncated: whether the next round, another search, or terms finer than the splines were omitted at `MAX_WORK_PER_FRAME` or
            `MAX_PARAMETERS`.
    """

    baseline: HyperparameterGrid
    baseline_with_effects: HyperparameterGrid
    effects: tuple[SelectedEffect, ...]
    initial_screening: tuple[CandidateEvidence, ...]
    excluded: tuple[EffectClass, ...]
    fine_scale_candidates: tuple[EffectClass, ...]
    underresolved_splines: tuple[str, ...]
    remaining: CandidateEvidence | None
    work: float
    truncated: bool = False

    def allows(self, further_work: float) -> bool:
        """Whether further work is within the limit of a verdict."""
        return self.work + further_work <= MAX_WORK_PER_FRAME * self.baseline.design.observation.frames


def search(screening: Screening, dictionary: Sequence[EffectClass], null: NullDraws, seed: int, earlier_work: float = 0.0) -> Search:
    """Identify effects until none is significant.

    Args:
        screening: evidence of the dictionary and of unnamed fields with the baseline and the given effects.
        dictionary: the named effect classes.
        null: null draws of the baseline.
        seed: seed of further draws.
        earlier_work: number of multiplications of the earlier searches of the same verdict.
    """
    baseline, fine_scale = screening.baseline, fine_scale_candidates(screening.baseline)
    projections = project_candidates(baseline, fine_scale, screening.projected_candidates)
    candidates = (*screening.candidates, *refine_parameters(baseline, score_candidates(baseline, fine_scale, projections)))
    if _needs_draws(candidates):
        candidates = with_draws(baseline, candidates, null, projections)
    work = earlier_work + _scoring_work(baseline, candidates)
    state = Search(baseline, baseline, (), candidates, (), fine_scale, (), remaining=None, work=work)
    while True:
        ranked = [candidate for candidate in candidates if not _may_be_wandering_drift(candidate, state.effects)]
        most_significant = max(ranked, key=lambda candidate: candidate.log_factor)
        p_value = _p_value(candidates, most_significant.log_factor, draws=null.noise[0].shape[1])
        state = replace(state, remaining=most_significant if p_value <= SIGNIFICANCE_LEVEL else None)
        fine = state.remaining is not None and most_significant.family in state.fine_scale_candidates
        if fine and not has_room_for_terms(state.baseline):
            return replace(state, truncated=True)
        if fine:
            state = _without_coarse(state, most_significant)
            state = replace(state, work=state.work + _scoring_work(state.baseline_with_effects, candidates))
        else:
            best = max(
                (candidate for candidate in ranked if candidate.family not in ALL_UNNAMED_CLASSES),
                key=lambda candidate: candidate.log_factor,
                default=None,
            )
            if state.remaining is None or best is None or best.log_factor < SIGNIFICANT_LOG_FACTOR or is_full(state.effects):
                return state
            predicted = _round_work(state, candidates, best)
            if not state.allows(predicted):
                return replace(state, truncated=True)
            state = _with_effect(replace(state, work=state.work + predicted), candidates, best, p_value, dictionary, projections)
        candidates = _score_remaining(state, dictionary, projections, (null.noise[0].shape[1], seed))


def _may_be_wandering_drift(candidate: CandidateEvidence, effects: Sequence[SelectedEffect]) -> bool:
    """Whether a jump, or an oscillation next to other effects, is so weak that a drift that wanders may be it (`MIN_JUMP_LOG_FACTOR`)."""
    name = candidate.family.name
    weak = candidate.log_factor < MIN_JUMP_LOG_FACTOR
    return weak and (name == DRIFT_JUMP.name or (name == THERMAL_OSCILLATION.name and bool(effects)))


def is_full(effects: Sequence[SelectedEffect]) -> bool:
    """Whether the effects are of as many classes as a verdict may contain."""
    return len({effect.refined.family for effect in effects}) == MAX_EFFECTS


def _round_work(state: Search, candidates: Sequence[CandidateEvidence], best: CandidateEvidence) -> float:
    """Multiplications of the next round, about: all candidates are scored and an effect is refined, again for each effect so far."""
    design = state.baseline_with_effects.design
    columns = best.projected_fields[best.best[0]].columns * len(best.family.nonlinear_parameters)
    columns += sum(len(effect.refined.amplitudes) * len(effect.refined.family.nonlinear_parameters) for effect in state.effects)
    refinement = FEW_COLUMNS_FACTOR * EVALUATIONS * columns * design.size * design.observation.frames * design.observation.blocks
    return _scoring_work(state.baseline_with_effects, candidates) * (1.0 + len(state.effects)) + refinement


def _scoring_work(grid: HyperparameterGrid, candidates: Sequence[CandidateEvidence]) -> float:
    """Multiplications for scoring the candidates, about: every column of every candidate is solved at every point."""
    columns = sum(field.columns for candidate in candidates for field in candidate.projected_fields)
    return float(len(grid.points) * grid.design.size**2 * columns)


def _score_remaining(
    state: Search, dictionary: Sequence[EffectClass], projections: Projections, draws: tuple[int, int]
) -> tuple[CandidateEvidence, ...]:
    """Score the remaining candidates; null draws are computed only where the p-value requires them."""
    remaining = (family for family in dictionary if state.excluded.count(family) < family.max_count)
    families = (*remaining, *UNNAMED_CLASSES, *state.fine_scale_candidates)
    candidates = refine_parameters(state.baseline_with_effects, score_candidates(state.baseline_with_effects, families, projections))
    if not _needs_draws(candidates):
        return candidates
    null = NullDraws.of(state.baseline_with_effects, draws[0], draws[1] + len(state.effects) + len(state.underresolved_splines))
    return with_draws(state.baseline_with_effects, candidates, null, projections)


def _needs_draws(candidates: Sequence[CandidateEvidence]) -> bool:
    """Whether the p-value of the most likely class requires draws of the null."""
    return SIGNIFICANT_LOG_FACTOR <= max(candidate.log_factor for candidate in candidates) < CERTAIN_LOG_FACTOR


def _without_coarse(state: Search, fine: CandidateEvidence) -> Search:
    """Add fine-scale terms of the splines before any named effect."""
    baseline = add_fine_scale_terms(state.baseline, state.baseline_with_effects, fine)
    baseline_with_effects, effects = rebuild_baseline(
        baseline, state.effects, state.effects[0].unnamed_log_factor if state.effects else -math.inf
    )
    residual = tuple(
        fine_scale_candidate for fine_scale_candidate in state.fine_scale_candidates if fine_scale_candidate is not fine.family
    )
    return replace(
        state,
        baseline=baseline,
        baseline_with_effects=baseline_with_effects,
        effects=effects,
        fine_scale_candidates=residual,
        underresolved_splines=(*state.underresolved_splines, fine.family.name),
    )


def _with_effect(
    state: Search,
    scored: Sequence[CandidateEvidence],
    best: CandidateEvidence,
    p_value: float,
    dictionary: Sequence[EffectClass],
    projections: Projections,
) -> Search:
    candidates = [candidate for candidate in scored if candidate.family not in ALL_UNNAMED_CLASSES]
    rivals = tuple(candidate for candidate in candidates if candidate is not best and candidate.log_factor > best.log_factor - MIN_LOG_ODDS)
    unnamed = max(candidate.log_factor for candidate in scored if candidate.family in UNNAMED_CLASSES)
    baseline_with_effects, effects = add_effect(state.baseline_with_effects, state.effects, best, p_value, rivals, unnamed)
    baseline_with_effects, effects = remove_unnecessary(state.baseline, baseline_with_effects, effects)
    baseline_with_effects, effects = reselect_effects(
        state.baseline, baseline_with_effects, effects, (*dictionary, *UNNAMED_CLASSES), projections
    )
    tried = (*state.excluded, best.family)
    tried = (*tried, *(effect.refined.family for effect in effects if effect.refined.family not in tried))
    return replace(state, baseline_with_effects=baseline_with_effects, effects=effects, excluded=tried)


def _p_value(candidates: Sequence[CandidateEvidence], most_significant: float, draws: int) -> float:
    """Fraction of draws of the null in which a class is as significant, the data included; 1 if it is not significant by itself."""
    if most_significant < SIGNIFICANT_LOG_FACTOR:
        return 1.0
    if most_significant >= CERTAIN_LOG_FACTOR:
        return 1.0 / (1.0 + draws)
    null = np.max([candidate.null for candidate in candidates], axis=0)
    return (1.0 + float(np.sum(null >= most_significant))) / (1.0 + draws)
