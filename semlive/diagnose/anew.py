"""The point that a run is linearised about, chosen again beside what may be hidden in it.

The estimate chooses it before anything has a name: whether the drift carries the distortion, how rough drift and distortion are, and the
distortion that a drift of it is made of. A tilt with load of 0.16 px made it 0.74 +- 0.02 of the distortion that was carried, where it was
none; carried, the distortion left more of the maps than the tilt, and three other names were found for it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

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
from semlive.estimate.terms import COUPLING_SIGMAS
from semlive.model.effects import Family

Array = NDArray[np.float64]
NOTHING: Mapping[int, Array] = MappingProxyType({})


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


def likelier_coupled(
    observation: Observation, families: Sequence[Family], known: Sequence[KnownEffect] = (), taken: Mapping[int, Array] = NOTHING
) -> Coupled:
    """The same maps with the distortion carried by the drift, or not: as is likelier beside the loudest of all effects.

    Args:
        observation: as the estimate chose.
        families: that may be hidden, those without a name among them.
        known: effects that are there.
        taken: by the number of each frame (ny, nx, 2) what was taken out of its map, px, for that choice.
    """
    if not _doubtful(observation.solution):
        return Coupled(observation)

    def as_chosen() -> Coupled | None:
        return Coupled(observation, Heard.of(observation, families, known))

    def otherwise() -> Coupled | None:
        try:
            other = _chosen(observation, taken, not observation.state.distortion.carried)
        except IllPosed:
            return None
        return Coupled(other, Heard.of(other, families, known)) if np.array_equal(other.used, observation.used) else None

    both = side_by_side(lambda hear: hear(), (as_chosen, otherwise))
    return max((one for one in both if one is not None), key=lambda one: one.loudest)


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
    return likelier_coupled(_chosen(seen, taken, None), families, known, taken)


def _chosen(seen: Observation, taken: Mapping[int, Array], carried: bool | None) -> Observation:
    """About what is chosen from maps without what is taken out of them."""
    solution = first_solution(with_nothing_chosen(seen.state, lambda one: less(one, taken)), carried)
    if taken:
        whole = {(one.reference, one.current): one.dmap for one in seen.state.rows}
        solution = replace(solution, state=with_maps(solution.state, lambda one: whole[one.reference, one.current]))
    return observe(solution, seen.steps)


def _doubtful(solution: Solution) -> bool:
    """Whether the maps ask for another share of the distortion to be carried than was chosen: all of it, or nothing."""
    asked = next((one for one in solution.terms if one.name == "coupling"), None)
    return asked is not None and abs(asked.value - float(solution.state.distortion.carried)) > COUPLING_SIGMAS * asked.sigma
