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


def refine_parameters(having: HyperparameterGrid, heard: Sequence[CandidateEvidence]) -> tuple[CandidateEvidence, ...]:
    """With families that are tried at one value alone, and have others, asked about those too, where there is anything to be heard.

    The distortion's affine part is not known, and a drift of the distortion that had another was called a drift of the magnification first.
    """
    return tuple(parallel_map(lambda one: replace(one, refinement_gain=_between(having, one)), heard))


def _between(having: HyperparameterGrid, one: CandidateEvidence) -> float:
    if not one.family.nonlinear_parameters or len(one.projected_fields) > 1 or one.log_factor <= CANDIDATE_LOG_FACTOR:
        return 0.0
    return max(refined(having, one).log_factor - one.log_factor, 0.0)


def add_effect(
    having: HyperparameterGrid,
    named: Sequence[SelectedEffect],
    best: CandidateEvidence,
    p_value: float,
    rivals: Sequence[CandidateEvidence],
    unnamed: float,
) -> tuple[HyperparameterGrid, tuple[SelectedEffect, ...]]:
    """The baseline and its effects with another one.

    Args:
        having: the baseline with those before.
        named: those.
        best: what is added, not refined yet.
        p_value: its.
        rivals: its.
        unnamed: see `SelectedEffect`.
    """
    one = refined(having, best)
    after = build_grid(having.design.with_effects(one.baseline_effect))
    gain = max(best.log_factor, one.log_factor)
    room = gain - (after.evidence - having.evidence)
    return after, (*named, SelectedEffect(one, gain, room, p_value, tuple(rivals), unnamed))


def remove_unnecessary(
    bare: HyperparameterGrid, having: HyperparameterGrid, named: tuple[SelectedEffect, ...]
) -> tuple[HyperparameterGrid, tuple[SelectedEffect, ...]]:
    """The baseline and its effects without those that are not loud beside all others, one at a time.

    What was added first had to do for all. A rotation that drifts and a bending were called a drift of the distortion, then bending and
    rotation came in beside it, and nothing was left for it to explain.
    """
    while len(named) > 1:
        # The last was loud beside all before it.
        without = [
            rebuild_baseline(bare, [other for other in named if other is not one], named[0].unnamed_log_factor) for one in named[:-1]
        ]
        total = having.evidence + sum(one.occam_factor for one in named)
        left = [one.evidence + sum(other.occam_factor for other in rest) for one, rest in without]
        place = int(np.argmax(left))
        if total - left[place] >= SIGNIFICANT_LOG_FACTOR:
            break
        having, named = without[place]
    return having, named


def reselect_effects(
    bare: HyperparameterGrid,
    having: HyperparameterGrid,
    named: tuple[SelectedEffect, ...],
    families: Sequence[EffectClass],
    kept: Mapping[str, CandidateProjection],
) -> tuple[HyperparameterGrid, tuple[SelectedEffect, ...]]:
    """The baseline and its effects, each heard once more beside the others: another name may do better there, or as well.

    What was named first was heard where the others were still hidden: a rotation that drifts was called a drift of the distortion, which
    took a part of a hidden bending too, and beside the bending it explained all that the rotation would have. Where the name stays, what is
    not linear in it is refined beside the others: a drift of the distortion had got its affine part where a jump was hidden, and what that
    left wrong took a third name, with a logarithm of the Bayes factor of 38.

    Args:
        bare: the baseline without effects.
        having: with them.
        named: they; the last was heard beside all others.
        families: that are asked, those without a name among them.
        kept: their laws.
    """
    for family in [one.refined.family for one in named[:-1]]:
        one = next(each for each in named if each.refined.family is family)
        before, rest = rebuild_baseline(bare, [other for other in named if other is not one], named[0].unnamed_log_factor)
        others = [each for each in families if each not in {other.refined.family for other in rest}]
        heard = refine_parameters(before, score_candidates(before, others, kept))
        candidates = [each for each in heard if each.family not in UNNAMED_CLASSES]
        best = max(candidates, key=lambda each: each.log_factor)
        rivals = [each for each in candidates if each is not best and each.log_factor > best.log_factor - MIN_LOG_ODDS]
        if best.family is family and not family.nonlinear_parameters:
            named = tuple(replace(each, rivals=tuple(rivals)) if each is one else each for each in named)
            continue
        unnamed = max(each.log_factor for each in heard if each.family in UNNAMED_CLASSES)
        having, named = add_effect(before, rest, best, one.p_value, rivals, unnamed)
        if best.family is not family:
            break
    return having, named


def rebuild_baseline(
    bare: HyperparameterGrid, named: Sequence[SelectedEffect], unnamed: float
) -> tuple[HyperparameterGrid, tuple[SelectedEffect, ...]]:
    """Effects added anew in their order; what has no name was heard at the beginning, and not beside just these."""
    having, found = bare, list[SelectedEffect]()
    for one in named:
        before, having = having, build_grid(having.design.with_effects(one.refined.baseline_effect))
        first = -math.inf if found else unnamed
        found.append(replace(one, log_bayes_factor=having.evidence - before.evidence + one.occam_factor, unnamed_log_factor=first))
    return having, tuple(found)
