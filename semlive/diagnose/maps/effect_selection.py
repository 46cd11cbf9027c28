"""Effects that were given a name, in the baseline beside each other; none stays that the others can do without."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from semlive.diagnose.baseline.baseline import HyperparameterGrid, build_grid
from semlive.diagnose.baseline.bayes_factor import CandidateEvidence, score_candidates
from semlive.diagnose.baseline.projection import CandidateProjection
from semlive.diagnose.maps.refinement import RefinedEffect, refined
from semlive.diagnose.maps.unnamed_fields import UNNAMED_CLASSES
from semlive.diagnose.parallel import parallel_map
from semlive.model.effects import EffectClass

# Logarithm of the Bayes factor from which on an effect counts. Among 199 draws of the null the largest of all families was 5.2, the 99th
# percentile 2.7.
SIGNIFICANT_LOG_FACTOR = 7.0
SIGNIFICANCE_LEVEL = 0.01  # of nulls may be as loud
CANDIDATE_LOG_FACTOR = 2.0  # logarithm of a Bayes factor that one null in fifty reaches
MIN_LOG_ODDS = math.log(20.0)  # rivals that are not so much less likely would do as well


@dataclass(frozen=True, slots=True, eq=False)
class SelectedEffect:
    """An effect that was added, and what was said of it when it was.

    Attributes:
        refined: the likeliest law.
        log_bayes_factor: logarithm of the Bayes factor against the baseline that had the effects before it.
        occam_factor: the part of it, negative, that comes from what other sizes and values there might have been.
        p_value: share of nulls that ask for an effect as loudly.
        rivals: that would do nearly as well.
        unnamed_log_factor: logarithm of the Bayes factor of the loudest of what has no name.
    """

    refined: RefinedEffect
    log_bayes_factor: float
    occam_factor: float
    p_value: float
    rivals: tuple[CandidateEvidence, ...]
    unnamed_log_factor: float

    @property
    def names(self) -> tuple[str, ...]:
        """That the effect has by its parameters, the likeliest first."""
        return self.refined.family.alias_rule(self.refined.parameters) or (self.refined.family.name,)


def refine_parameters(baseline_with_effects: HyperparameterGrid, candidates: Sequence[CandidateEvidence]) -> tuple[CandidateEvidence, ...]:
    """With families that are tried at one value alone, and have others, asked about those too, where there is anything to be heard.

    The distortion's affine part is not known, and a drift of the distortion that had another was called a drift of the magnification first.
    """
    return tuple(parallel_map(lambda candidate: replace(candidate, refinement_gain=_between(baseline_with_effects, candidate)), candidates))


def _between(baseline_with_effects: HyperparameterGrid, candidate: CandidateEvidence) -> float:
    if not candidate.family.nonlinear_parameters or len(candidate.projected_fields) > 1 or candidate.log_factor <= CANDIDATE_LOG_FACTOR:
        return 0.0
    return max(refined(baseline_with_effects, candidate).log_factor - candidate.log_factor, 0.0)


def add_effect(
    baseline_with_effects: HyperparameterGrid,
    effects: Sequence[SelectedEffect],
    best: CandidateEvidence,
    p_value: float,
    rivals: Sequence[CandidateEvidence],
    unnamed: float,
) -> tuple[HyperparameterGrid, tuple[SelectedEffect, ...]]:
    """The baseline and its effects with another one.

    Args:
        baseline_with_effects: the baseline with those before.
        effects: those.
        best: what is added, not refined yet.
        p_value: its.
        rivals: its.
        unnamed: see `SelectedEffect`.
    """
    effect = refined(baseline_with_effects, best)
    after = build_grid(baseline_with_effects.design.with_effects(effect.baseline_effect))
    gain = max(best.log_factor, effect.log_factor)
    room = gain - (after.evidence - baseline_with_effects.evidence)
    return after, (*effects, SelectedEffect(effect, gain, room, p_value, tuple(rivals), unnamed))


def remove_unnecessary(
    baseline: HyperparameterGrid, baseline_with_effects: HyperparameterGrid, effects: tuple[SelectedEffect, ...]
) -> tuple[HyperparameterGrid, tuple[SelectedEffect, ...]]:
    """The baseline and its effects without those that are not loud beside all others, one at a time.

    What was added first had to do for all. A rotation that drifts and a bending were called a drift of the distortion, then bending and
    rotation came in beside it, and nothing was left for it to explain.
    """
    while len(effects) > 1:
        # The last was loud beside all before it.
        without = [
            rebuild_baseline(baseline, [other for other in effects if other is not value], effects[0].unnamed_log_factor)
            for value in effects[:-1]
        ]
        total = baseline_with_effects.evidence + sum(effect.occam_factor for effect in effects)
        residual = [value.evidence + sum(other.occam_factor for other in remaining) for value, remaining in without]
        place = int(np.argmax(residual))
        if total - residual[place] >= SIGNIFICANT_LOG_FACTOR:
            break
        baseline_with_effects, effects = without[place]
    return baseline_with_effects, effects


def reselect_effects(
    baseline: HyperparameterGrid,
    baseline_with_effects: HyperparameterGrid,
    effects: tuple[SelectedEffect, ...],
    families: Sequence[EffectClass],
    projections: Mapping[str, CandidateProjection],
) -> tuple[HyperparameterGrid, tuple[SelectedEffect, ...]]:
    """The baseline and its effects, each heard once more beside the others: another name may do better there, or as well.

    What was named first was heard where the others were still hidden: a rotation that drifts was called a drift of the distortion, which
    took a part of a hidden bending too, and beside the bending it explained all that the rotation would have. Where the name stays, what is
    not linear in it is refined beside the others: a drift of the distortion had got its affine part where a jump was hidden, and what that
    left wrong took a third name, with a logarithm of the Bayes factor of 38.

    Args:
        baseline: the baseline without effects.
        baseline_with_effects: with them.
        effects: they; the last was heard beside all others.
        families: that are asked, those without a name among them.
        projections: their laws.
    """
    for family in [effect.refined.family for effect in effects[:-1]]:
        effect = next(each for each in effects if each.refined.family is family)
        before, remaining = rebuild_baseline(baseline, [other for other in effects if other is not effect], effects[0].unnamed_log_factor)
        other_families = [each for each in families if each not in {other.refined.family for other in remaining}]
        scored = refine_parameters(before, score_candidates(before, other_families, projections))
        candidates = [each for each in scored if each.family not in UNNAMED_CLASSES]
        best = max(candidates, key=lambda each: each.log_factor)
        rivals = [each for each in candidates if each is not best and each.log_factor > best.log_factor - MIN_LOG_ODDS]
        if best.family is family and not family.nonlinear_parameters:
            effects = tuple(replace(each, rivals=tuple(rivals)) if each is effect else each for each in effects)
            continue
        unnamed = max(each.log_factor for each in scored if each.family in UNNAMED_CLASSES)
        baseline_with_effects, effects = add_effect(before, remaining, best, effect.p_value, rivals, unnamed)
        if best.family is not family:
            break
    return baseline_with_effects, effects


def rebuild_baseline(
    baseline: HyperparameterGrid, effects: Sequence[SelectedEffect], unnamed: float
) -> tuple[HyperparameterGrid, tuple[SelectedEffect, ...]]:
    """Effects added anew in their order; what has no name was heard at the beginning, and not beside just these."""
    baseline_with_effects, found = baseline, list[SelectedEffect]()
    for effect in effects:
        before, baseline_with_effects = (
            baseline_with_effects,
            build_grid(baseline_with_effects.design.with_effects(effect.refined.baseline_effect)),
        )
        first = -math.inf if found else unnamed
        found.append(
            replace(
                effect, log_bayes_factor=baseline_with_effects.evidence - before.evidence + effect.occam_factor, unnamed_log_factor=first
            )
        )
    return baseline_with_effects, tuple(found)
