"""Selection of identified effects, fitted jointly with the baseline; effects that become insignificant are removed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from semlive.diagnose.baseline.baseline import HyperparameterGrid, build_grid
from semlive.diagnose.baseline.bayes_factor import CandidateEvidence, score_candidates
from semlive.diagnose.baseline.projection import Projections
from semlive.diagnose.maps.refinement import RefinedEffect, refined
from semlive.diagnose.maps.unnamed_fields import UNNAMED_CLASSES
from semlive.diagnose.parallel import parallel_map
from semlive.model.effects import EffectClass

# Smallest log Bayes factor of a significant effect. Over 199 draws of the null the maximum of all classes was 5.2 and the 99th percentile
# 2.7.
SIGNIFICANT_LOG_FACTOR = 7.0
CERTAIN_LOG_FACTOR = 30.0
"""Log Bayes factor that no null draw reaches: its mean over the null is 1, so that by Markov's inequality one of 300 draws of 60 classes
exceeds it with a probability below 2e-9. The draws take a tenth of the time of a verdict.
"""
SIGNIFICANCE_LEVEL = 0.01  # largest p-value of a significant effect
CANDIDATE_LOG_FACTOR = 2.0  # log Bayes factor that one null draw in fifty reaches
MIN_LOG_ODDS = math.log(20.0)  # candidates within this of the best explain the data equally well


@dataclass(frozen=True, slots=True, eq=False)
class SelectedEffect:
    """A selected effect and its statistics at the time of selection.

    Attributes:
        refined: the most likely basis field with refined parameters.
        log_bayes_factor: log Bayes factor against the baseline with the effects selected before.
        occam_factor: the Occam factor, the negative part of it due to the range of possible sizes and parameters.
        p_value: fraction of null draws with an effect at least as significant.
        rivals: alternative effects that are nearly as likely.
        unnamed_log_factor: log Bayes factor of the most likely unnamed field.
    """

    refined: RefinedEffect
    log_bayes_factor: float
    occam_factor: float
    p_value: float
    rivals: tuple[CandidateEvidence, ...]
    unnamed_log_factor: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effect by its parameters, the most likely first."""
        return self.refined.family.alias_rule(self.refined.parameters) or (self.refined.family.name,)


def refine_parameters(baseline_with_effects: HyperparameterGrid, candidates: Sequence[CandidateEvidence]) -> tuple[CandidateEvidence, ...]:
    """Score candidates with a single grid value also at other parameter values, if they are significant.

    The affine part of the distortion is unknown. A distortion drift with another affine part was at first identified as a drift of the
    magnification.
    """
    return tuple(parallel_map(lambda candidate: replace(candidate, refinement_gain=_between(baseline_with_effects, candidate)), candidates))


def _between(baseline_with_effects: HyperparameterGrid, candidate: CandidateEvidence) -> float:
    if not candidate.family.nonlinear_parameters or len(candidate.values) > 1 or candidate.log_factor <= CANDIDATE_LOG_FACTOR:
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
    """Add an effect to the baseline.

    Args:
        baseline_with_effects: the baseline with the effects selected before.
        effects: the effects selected before.
        best: the candidate to add, not yet refined.
        p_value: its p-value.
        rivals: its rivals.
        unnamed: log Bayes factor of the most likely unnamed field, see `SelectedEffect`.
    """
    effect = refined(baseline_with_effects, best)
    after = build_grid(baseline_with_effects.design.with_effects(effect.baseline_effect))
    gain = max(best.log_factor, effect.log_factor)
    occam_factor = gain - (after.evidence - baseline_with_effects.evidence)
    return after, (*effects, SelectedEffect(effect, gain, occam_factor, p_value, tuple(rivals), unnamed))


def remove_unnecessary(
    baseline: HyperparameterGrid, baseline_with_effects: HyperparameterGrid, effects: tuple[SelectedEffect, ...]
) -> tuple[HyperparameterGrid, tuple[SelectedEffect, ...]]:
    """Remove, one at a time, effects that are not significant when fitted jointly with all others (backward elimination).

    The first selected effect absorbs the effects not yet selected. A raster rotation drift together with bending was identified as a drift
    of the distortion; after bending and rotation had been added, the distortion drift explained nothing.
    """
    while len(effects) > 1:
        # The last effect was significant jointly with all before it.
        without = [
            rebuild_baseline(baseline, [retained for retained in effects if retained is not value], effects[0].unnamed_log_factor)
            for value in effects[:-1]
        ]
        total = baseline_with_effects.evidence + sum(effect.occam_factor for effect in effects)
        residual = [value.evidence + sum(retained.occam_factor for retained in remaining) for value, remaining in without]
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
    projections: Projections,
) -> tuple[HyperparameterGrid, tuple[SelectedEffect, ...]]:
    """Score each selected effect again jointly with the others; replace it if another effect is more likely.

    The first effect is selected while the others are still missing from the model. A raster rotation drift was identified as a distortion
    drift, which absorbed a part of the bending as well; jointly with bending it explained the rotation completely. If the effect is
    confirmed, its nonlinear parameters are refined jointly with the others. A distortion drift whose affine part was fitted with a hidden
    jump otherwise caused a third effect with a log Bayes factor of 38. An effect that is no longer significant is removed: a spot
    fitted to a part of three charged spots had a log Bayes factor of 3 after the others were selected.

    Args:
        baseline: the baseline without effects.
        baseline_with_effects: the baseline with the effects.
        effects: the effects; the last one was already scored jointly with all others.
        families: candidate effect classes, including unnamed ones.
        projections: their projected basis fields.
    """
    for original in [effect.refined for effect in effects[:-1]]:
        effect, family = next(each for each in effects if each.refined is original), original.family
        before, remaining = rebuild_baseline(
            baseline, [retained for retained in effects if retained is not effect], effects[0].unnamed_log_factor
        )
        taken = [retained.refined.family for retained in remaining]
        other_families = [each for each in families if taken.count(each) < each.max_count]
        scored = refine_parameters(before, score_candidates(before, other_families, projections))
        candidates = [each for each in scored if each.family not in UNNAMED_CLASSES]
        best = max(candidates, key=lambda each: each.log_factor)
        rivals = [each for each in candidates if each is not best and each.log_factor > best.log_factor - MIN_LOG_ODDS]
        if best.family is family and not family.nonlinear_parameters:
            effects = tuple(replace(each, rivals=tuple(rivals)) if each is effect else each for each in effects)
            continue
        unnamed = max(each.log_factor for each in scored if each.family in UNNAMED_CLASSES)
        after, replaced = add_effect(before, remaining, best, effect.p_value, rivals, unnamed)
        if replaced[-1].log_bayes_factor < SIGNIFICANT_LOG_FACTOR:
            return reselect_effects(baseline, before, remaining, families, projections)
        baseline_with_effects, effects = after, replaced
        if best.family is not family:
            break
    return baseline_with_effects, effects


def rebuild_baseline(
    baseline: HyperparameterGrid, effects: Sequence[SelectedEffect], unnamed: float
) -> tuple[HyperparameterGrid, tuple[SelectedEffect, ...]]:
    """Add effects to the baseline again in their order. The factor `unnamed` of unnamed fields is not computed again."""
    baseline_with_effects, rebuilt = baseline, list[SelectedEffect]()
    for effect in effects:
        before, baseline_with_effects = (
            baseline_with_effects,
            build_grid(baseline_with_effects.design.with_effects(effect.refined.baseline_effect)),
        )
        first = -math.inf if rebuilt else unnamed
        rebuilt.append(
            replace(
                effect, log_bayes_factor=baseline_with_effects.evidence - before.evidence + effect.occam_factor, unnamed_log_factor=first
            )
        )
    return baseline_with_effects, tuple(rebuilt)
