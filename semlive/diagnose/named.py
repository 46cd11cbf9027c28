"""Effects that were given a name, in the baseline beside each other; none stays that the others can do without."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from semlive.diagnose.baseline import Ladder, ladder
from semlive.diagnose.evidence import Weighed
from semlive.diagnose.refine import Refined, refined

# Logarithm of the Bayes factor from which on an effect counts. Among 199 draws of the null the largest of all families was 5.2, the 99th
# percentile 2.7.
LOUD = 7.0


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
        without = [_chained(bare, [other for other in named if other is not one], named[0].unnamed) for one in named[:-1]]
        total = having.evidence + sum(one.room for one in named)
        left = [one.evidence + sum(other.room for other in rest) for one, rest in without]
        place = int(np.argmax(left))
        if total - left[place] >= LOUD:
            break
        having, named = without[place]
    return having, named


def _chained(bare: Ladder, named: Sequence[Named], unnamed: float) -> tuple[Ladder, tuple[Named, ...]]:
    """Effects added anew in their order; what has no name was heard at the beginning, and not beside just these."""
    having, found = bare, list[Named]()
    for one in named:
        before, having = having, ladder(having.design.having(one.refined.found))
        first = -math.inf if found else unnamed
        found.append(replace(one, gain=having.evidence - before.evidence + one.room, unnamed=first))
    return having, tuple(found)
