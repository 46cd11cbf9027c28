"""The search: effects are added one at a time, the loudest first, until what is left is quiet."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from semlive.diagnose.baseline import Ladder
from semlive.diagnose.evidence import NullDraws, Weighed, kept_for, weigh, with_draws
from semlive.diagnose.heard import Heard
from semlive.diagnose.named import LOUD, ODDS, RARE, Named, chained, needed, reconsidered, with_one_more, with_values_between
from semlive.diagnose.prepared import Prepared
from semlive.diagnose.resolution import FINE_DISTORTION, FINE_DRIFT, finer, with_more
from semlive.diagnose.unknown import UNNAMED
from semlive.model.effects import Family

MOST = 3
NAMELESS = (*UNNAMED, FINE_DISTORTION, FINE_DRIFT)
"""What is nobody's name: fields and courses without one, and the baseline's own splines."""


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """How far it got.

    Attributes:
        bare: the baseline without effects.
        having: with those that were named.
        named: they.
        first: all that was heard before any was named.
        tried: families that are not asked again.
        fine: what of the baseline may still be finer than its splines.
        coarse: names of those of its splines that are too coarse; what they left is in the baseline.
        loud: whether what is left is.
    """

    bare: Ladder
    having: Ladder
    named: tuple[Named, ...]
    first: tuple[Weighed, ...]
    tried: tuple[Family, ...]
    fine: tuple[Family, ...]
    coarse: tuple[str, ...]
    loud: bool


def searched(begun: Heard, dictionary: Sequence[Family], null: NullDraws, seed: int) -> Search:
    """All that can be named.

    Args:
        begun: the dictionary, and what has no name, beside the baseline with effects that are known.
        dictionary: the effects that have a name.
        null: draws of the baseline.
        seed: of further draws.
    """
    bare, fine = begun.bare, finer(begun.bare)
    kept = kept_for(bare, fine, begun.kept)
    heard = with_draws(bare, (*begun.families, *with_values_between(bare, weigh(bare, fine, kept))), null, kept)
    now = Search(bare, bare, (), heard, (), fine, (), loud=True)
    while True:
        loudest = max(heard, key=lambda one: one.log_factor)
        p_value = _p_value(heard, loudest.log_factor) if loudest.log_factor >= LOUD else 1.0
        now = replace(now, loud=p_value <= RARE)
        if now.loud and loudest.family in now.fine:
            now = _without_coarse(now, loudest)
        else:
            best = max((one for one in heard if one.family not in NAMELESS), key=lambda one: one.log_factor, default=None)
            if not now.loud or best is None or best.log_factor < LOUD or len(now.named) == MOST:
                return now
            now = _with_effect(now, heard, best, p_value, dictionary, kept)
        heard = _heard(now, dictionary, kept, (null.noise[0].shape[1], seed))


def _heard(now: Search, dictionary: Sequence[Family], kept: Mapping[str, Prepared], draws: tuple[int, int]) -> tuple[Weighed, ...]:
    """What is left to be tried; against so many draws, with a seed, where anything is loud: what is left is quiet nearly always."""
    families = (*(one for one in dictionary if one not in now.tried), *UNNAMED, *now.fine)
    heard = with_values_between(now.having, weigh(now.having, families, kept))
    if max(one.log_factor for one in heard) < LOUD:
        return heard
    null = NullDraws.of(now.having, draws[0], draws[1] + len(now.named) + len(now.coarse))
    return with_draws(now.having, heard, null, kept)


def _without_coarse(now: Search, fine: Weighed) -> Search:
    """The splines' own, before anything that has a name."""
    bare = with_more(now.bare, fine)
    having, named = chained(bare, now.named, now.named[0].unnamed if now.named else -math.inf)
    left = tuple(one for one in now.fine if one is not fine.family)
    return replace(now, bare=bare, having=having, named=named, fine=left, coarse=(*now.coarse, fine.family.name))


def _with_effect(
    now: Search, heard: Sequence[Weighed], best: Weighed, p_value: float, dictionary: Sequence[Family], kept: Mapping[str, Prepared]
) -> Search:
    candidates = [one for one in heard if one.family not in NAMELESS]
    rivals = tuple(one for one in candidates if one is not best and one.log_factor > best.log_factor - ODDS)
    unnamed = max(one.log_factor for one in heard if one.family in UNNAMED)
    having, named = with_one_more(now.having, now.named, best, p_value, rivals, unnamed)
    having, named = needed(now.bare, having, named)
    having, named = reconsidered(now.bare, having, named, (*dictionary, *UNNAMED), kept)
    tried = (*now.tried, best.family, *(one.refined.family for one in named))
    return replace(now, having=having, named=named, tried=tried)


def _p_value(heard: Sequence[Weighed], loudest: float) -> float:
    null = np.max([one.null for one in heard], axis=0)
    return (1.0 + float(np.sum(null >= loudest))) / (1.0 + len(null))
