"""The search: effects are added one at a time, the loudest first, until what is left is quiet."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.bayes_factor import CandidateEvidence, NullDraws, project_candidates, score_candidates, with_draws
from semlive.diagnose.baseline.projection import CandidateProjection
from semlive.diagnose.maps.effect_selection import (
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
from semlive.diagnose.maps.spline_resolution import FINE_DISTORTION, FINE_DRIFT, add_fine_scale_terms, fine_scale_candidates
from semlive.diagnose.maps.unnamed_fields import UNNAMED_CLASSES
from semlive.model.effects import EffectClass

MAX_EFFECTS = 3
ALL_UNNAMED_CLASSES = (*UNNAMED_CLASSES, FINE_DISTORTION, FINE_DRIFT)
"""What is nobody's name: fields and courses without one, and the baseline's own splines."""


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """How far it got.

    Attributes:
        bare: the baseline without effects.
        baseline_with_effects: with those that were named.
        effects: they.
        initial_screening: all that was heard before any was named.
        excluded: families that are not asked again.
        fine_scale_candidates: what of the baseline may still be finer than its splines.
        underresolved_splines: names of those of its splines that are too coarse; what they left is in the baseline.
        residual_significant: whether what is left is.
    """

    bare: HyperparameterGrid
    baseline_with_effects: HyperparameterGrid
    effects: tuple[SelectedEffect, ...]
    initial_screening: tuple[CandidateEvidence, ...]
    excluded: tuple[EffectClass, ...]
    fine_scale_candidates: tuple[EffectClass, ...]
    underresolved_splines: tuple[str, ...]
    residual_significant: bool


def search(begun: Screening, dictionary: Sequence[EffectClass], null: NullDraws, seed: int) -> Search:
    """All that can be named.

    Args:
        begun: the dictionary, and what has no name, beside the baseline with effects that are known.
        dictionary: the effects that have a name.
        null: draws of the baseline.
        seed: of further draws.
    """
    bare, fine = begun.baseline, fine_scale_candidates(begun.baseline)
    kept = project_candidates(bare, fine, begun.projected_candidates)
    heard = with_draws(bare, (*begun.candidates, *refine_parameters(bare, score_candidates(bare, fine, kept))), null, kept)
    now = Search(bare, bare, (), heard, (), fine, (), residual_significant=True)
    while True:
        loudest = max(heard, key=lambda one: one.log_factor)
        p_value = _p_value(heard, loudest.log_factor) if loudest.log_factor >= SIGNIFICANT_LOG_FACTOR else 1.0
        now = replace(now, residual_significant=p_value <= SIGNIFICANCE_LEVEL)
        if now.residual_significant and loudest.family in now.fine_scale_candidates:
            now = _without_coarse(now, loudest)
        else:
            best = max((one for one in heard if one.family not in ALL_UNNAMED_CLASSES), key=lambda one: one.log_factor, default=None)
            if not now.residual_significant or best is None or best.log_factor < SIGNIFICANT_LOG_FACTOR or len(now.effects) == MAX_EFFECTS:
                return now
            now = _with_effect(now, heard, best, p_value, dictionary, kept)
        heard = _heard(now, dictionary, kept, (null.noise[0].shape[1], seed))


def _heard(
    now: Search, dictionary: Sequence[EffectClass], kept: Mapping[str, CandidateProjection], draws: tuple[int, int]
) -> tuple[CandidateEvidence, ...]:
    """What is left to be tried; against so many draws, with a seed, where anything is loud: what is left is quiet nearly always."""
    families = (*(one for one in dictionary if one not in now.excluded), *UNNAMED_CLASSES, *now.fine_scale_candidates)
    heard = refine_parameters(now.baseline_with_effects, score_candidates(now.baseline_with_effects, families, kept))
    if max(one.log_factor for one in heard) < SIGNIFICANT_LOG_FACTOR:
        return heard
    null = NullDraws.of(now.baseline_with_effects, draws[0], draws[1] + len(now.effects) + len(now.underresolved_splines))
    return with_draws(now.baseline_with_effects, heard, null, kept)


def _without_coarse(now: Search, fine: CandidateEvidence) -> Search:
    """The splines' own, before anything that has a name."""
    bare = add_fine_scale_terms(now.bare, fine)
    having, named = rebuild_baseline(bare, now.effects, now.effects[0].unnamed_log_factor if now.effects else -math.inf)
    left = tuple(one for one in now.fine_scale_candidates if one is not fine.family)
    return replace(
        now,
        bare=bare,
        baseline_with_effects=having,
        effects=named,
        fine_scale_candidates=left,
        underresolved_splines=(*now.underresolved_splines, fine.family.name),
    )


def _with_effect(
    now: Search,
    heard: Sequence[CandidateEvidence],
    best: CandidateEvidence,
    p_value: float,
    dictionary: Sequence[EffectClass],
    kept: Mapping[str, CandidateProjection],
) -> Search:
    candidates = [one for one in heard if one.family not in ALL_UNNAMED_CLASSES]
    rivals = tuple(one for one in candidates if one is not best and one.log_factor > best.log_factor - MIN_LOG_ODDS)
    unnamed = max(one.log_factor for one in heard if one.family in UNNAMED_CLASSES)
    having, named = add_effect(now.baseline_with_effects, now.effects, best, p_value, rivals, unnamed)
    having, named = remove_unnecessary(now.bare, having, named)
    having, named = reselect_effects(now.bare, having, named, (*dictionary, *UNNAMED_CLASSES), kept)
    tried = (*now.excluded, best.family, *(one.refined.family for one in named))
    return replace(now, baseline_with_effects=having, effects=named, excluded=tried)


def _p_value(heard: Sequence[CandidateEvidence], loudest: float) -> float:
    null = np.max([one.null for one in heard], axis=0)
    return (1.0 + float(np.sum(null >= loudest))) / (1.0 + len(null))
