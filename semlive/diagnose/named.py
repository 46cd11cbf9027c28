"""Effects that were given a name, in the baseline beside each other; none stays that the others can do without."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from semlive.diagnose.baseline import Ladder, ladder
from semlive.diagnose.evidence import Weighed, weigh
from semlive.diagnose.prepared import Prepared
from semlive.diagnose.refine import Refined, refined
from semlive.diagnose.side_by_side import side_by_side
from semlive.diagnose.unknown import UNNAMED
from semlive.model.effects import Family

# Logarithm of the Bayes factor from which on an effect counts. Among 199 draws of the null the largest of all families was 5.2, the 99th
# percentile 2.7.
LOUD = 7.0
RARE = 0.01  # of nulls may be as loud
HEARD = 2.0  # logarithm of a Bayes factor that one null in fifty reaches
ODDS = math.log(20.0)  # rivals that are not so much less likely would do as well


@dataclass(frozen=True, slots=True, eq=False)
class Named:
    """An effect that was added, and what was said of it when it was.

    Attributes:
        refined: the likeliest law.
        gain: logarithm of the Bayes factor against the baseline that had the effects before it.
        room: the part of it, negative, that comes from what other sizes and values there might have been.
        p_value: share of nulls that ask for an effect as loudly.
        rivals: that would do nearly as well.
        unnamed: logarithm of the Bayes factor of the loudest of what has no name.
    """

    refined: Refined
    gain: float
    room: float
    p_value: float
    rivals: tuple[Weighed, ...]
    unnamed: float

    @property
    def names(self) -> tuple[str, ...]:
        """That the effect has by its parameters, the likeliest first."""
        return self.refined.family.told(self.refined.parameters) or (self.refined.family.name,)


def with_values_between(having: Ladder, heard: Sequence[Weighed]) -> tuple[Weighed, ...]:
    """With families that are tried at one value alone, and have others, asked about those too, where there is anything to be heard.

    The distortion's affine part is not known, and a drift of the distortion that had another was called a drift of the magnification first.
    """
    return tuple(side_by_side(lambda one: replace(one, between=_between(having, one)), heard))


def _between(having: Ladder, one: Weighed) -> float:
    if not one.family.thetas or len(one.laws) > 1 or one.log_factor <= HEARD:
        return 0.0
    return max(refined(having, one).log_factor - one.log_factor, 0.0)


def with_one_more(
    having: Ladder, named: Sequence[Named], best: Weighed, p_value: float, rivals: Sequence[Weighed], unnamed: float
) -> tuple[Ladder, tuple[Named, ...]]:
    """The baseline and its effects with another one.

    Args:
        having: the baseline with those before.
        named: those.
        best: what is added, not refined yet.
        p_value: its.
        rivals: its.
        unnamed: see `Named`.
    """
    one = refined(having, best)
    after = ladder(having.design.having(one.found))
    gain = max(best.log_factor, one.log_factor)
    room = gain - (after.evidence - having.evidence)
    return after, (*named, Named(one, gain, room, p_value, tuple(rivals), unnamed))


def needed(bare: Ladder, having: Ladder, named: tuple[Named, ...]) -> tuple[Ladder, tuple[Named, ...]]:
    """The baseline and its effects without those that are not loud beside all others, one at a time.

    What was added first had to do for all. A rotation that drifts and a bending were called a drift of the distortion, then bending and
    rotation came in beside it, and nothing was left for it to explain.
    """
    while len(named) > 1:
        # The last was loud beside all before it.
        without = [chained(bare, [other for other in named if other is not one], named[0].unnamed) for one in named[:-1]]
        total = having.evidence + sum(one.room for one in named)
        left = [one.evidence + sum(other.room for other in rest) for one, rest in without]
        place = int(np.argmax(left))
        if total - left[place] >= LOUD:
            break
        having, named = without[place]
    return having, named


def reconsidered(
    bare: Ladder, having: Ladder, named: tuple[Named, ...], families: Sequence[Family], kept: Mapping[str, Prepared]
) -> tuple[Ladder, tuple[Named, ...]]:
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
        before, rest = chained(bare, [other for other in named if other is not one], named[0].unnamed)
        others = [each for each in families if each not in {other.refined.family for other in rest}]
        heard = with_values_between(before, weigh(before, others, kept))
        candidates = [each for each in heard if each.family not in UNNAMED]
        best = max(candidates, key=lambda each: each.log_factor)
        rivals = [each for each in candidates if each is not best and each.log_factor > best.log_factor - ODDS]
        if best.family is family and not family.thetas:
            named = tuple(replace(each, rivals=tuple(rivals)) if each is one else each for each in named)
            continue
        unnamed = max(each.log_factor for each in heard if each.family in UNNAMED)
        having, named = with_one_more(before, rest, best, one.p_value, rivals, unnamed)
        if best.family is not family:
            break
    return having, named


def chained(bare: Ladder, named: Sequence[Named], unnamed: float) -> tuple[Ladder, tuple[Named, ...]]:
    """Effects added anew in their order; what has no name was heard at the beginning, and not beside just these."""
    having, found = bare, list[Named]()
    for one in named:
        before, having = having, ladder(having.design.having(one.refined.found))
        first = -math.inf if found else unnamed
        found.append(replace(one, gain=having.evidence - before.evidence + one.room, unnamed=first))
    return having, tuple(found)
