"""The point that a run is linearised about, chosen again beside what may be hidden in it.

The estimate chooses it before anything has a name: whether the drift carries the distortion, how rough drift and distortion are, and the
distortion that a drift of it is made of. A tilt with load of 0.16 px made it 0.74 +- 0.02 of the distortion that was carried, where it was
none; carried, the distortion left more of the maps than the tilt, and three other names were found for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semlive.data.diagnosis import KnownEffect
from semlive.diagnose.baseline import Ladder
from semlive.diagnose.heard import Heard
from semlive.diagnose.known import amplitudes_of, at_points, less
from semlive.diagnose.observation import Observation, first_solution, observe
from semlive.diagnose.side_by_side import side_by_side
from semlive.errors import IllPosed
from semlive.estimate.accumulate import with_maps, with_nothing_chosen
from semlive.estimate.posterior import Solution
from semlive.model.effects import Family

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Coupled:
    """A run with the distortion carried by the drift, or not.

    Attributes:
        observation: about that choice.
        heard: all families beside it, where they decided; None where there was no doubt.
    """

    observation: Observation
    heard: Heard | None = None

    @property
    def loudest(self) -> float:
        """Logarithm of the likelihood of the data beside the family that does most for it, where that was asked."""
        return -np.inf if self.heard is None else self.heard.loudest


def likelier_coupled(observation: Observation, families: Sequence[Family], known: Sequence[KnownEffect] = ()) -> Coupled:
    """The same maps with the distortion carried by the drift, or not: as is likelier beside the loudest of all effects.

    Args:
        observation: as the estimate chose.
        families: that may be hidden, those without a name among them.
        known: effects that are there.
    """
    other = _otherwise(observation)
    if other is None:
        return Coupled(observation)
    both = side_by_side(lambda one: Coupled(one, Heard.of(one, families, known)), (observation, other))
    return max(both, key=lambda one: one.loudest)


def beside(having: Ladder, fields: Sequence[Array], families: Sequence[Family], known: Sequence[KnownEffect] = ()) -> Coupled:
    """The same maps about what is chosen where effects were taken out of them.

    Args:
        having: the baseline with the effects.
        fields: of each effect, (f, b, 2, q) what unit amplitudes move, px.
        families: that may be hidden, those without a name among them.
        known: effects that are there.

    Raises:
        IllPosed: without the effects there is too little left.
    """
    seen = having.design.observation
    amplitudes, spans = amplitudes_of(having), having.design.spans(fields, len(known))
    moved = np.sum([field @ amplitudes[own] for field, own in zip(fields, spans, strict=True)], axis=0)
    taken = at_points(seen, moved - moved[0], seen.grid)
    chosen, other = first_solution(with_nothing_chosen(seen.state, lambda one: less(one, taken)))
    again = observe(_about_the_whole(chosen, seen), seen.steps, other and _about_the_whole(other, seen))
    return likelier_coupled(again, families, known)


def _about_the_whole(solution: Solution, seen: Observation) -> Solution:
    """With the maps as they were seen."""
    whole = {(one.reference, one.current): one.dmap for one in seen.state.rows}
    return replace(solution, state=with_maps(solution.state, lambda one: whole[one.reference, one.current]))


def _otherwise(seen: Observation) -> Observation | None:
    """The same maps with the other coupling; None where there is no doubt, or other blocks would be compared."""
    if seen.other is None:
        return None
    try:
        other = observe(seen.other, seen.steps)
    except IllPosed:
        return None
    return other if np.array_equal(other.used, seen.used) else None
