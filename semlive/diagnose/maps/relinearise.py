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

from semlive.data.diagnosis import ModelEffect
from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.model_effects import fitted_amplitudes, interpolate_to_grid, subtract_effects
from semlive.diagnose.baseline.observation import Observation, baseline_solution, make_observation
from semlive.diagnose.maps.screening import Screening
from semlive.diagnose.parallel import parallel_map
from semlive.errors import IllPosed
from semlive.estimate.joint.observations.normal_equations import reset_model_selection, with_maps
from semlive.estimate.joint.solution.posterior import Solution
from semlive.model.effects import EffectClass

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class CouplingChoice:
    """A run with the distortion carried by the drift, or not.

    Attributes:
        observation: about that choice.
        screening: all families beside it, where they decided; None where there was no doubt.
    """

    observation: Observation
    screening: Screening | None = None

    @property
    def best_log_evidence(self) -> float:
        """Logarithm of the likelihood of the data beside the family that does most for it, where that was asked."""
        return -np.inf if self.screening is None else self.screening.best_log_evidence


def choose_coupling(observation: Observation, families: Sequence[EffectClass], model_effects: Sequence[ModelEffect] = ()) -> CouplingChoice:
    """The same maps with the distortion carried by the drift, or not: as is likelier beside the loudest of all effects.

    Args:
        observation: as the estimate chose.
        families: that may be hidden, those without a name among them.
        model_effects: effects that are there.
    """
    other = _otherwise(observation)
    if other is None:
        return CouplingChoice(observation)
    both = parallel_map(
        lambda candidate: CouplingChoice(candidate, Screening.run(candidate, families, model_effects)), (observation, other)
    )
    return max(both, key=lambda candidate: candidate.best_log_evidence)


def relinearise_with_effects(
    baseline: HyperparameterGrid, fields: Sequence[Array], families: Sequence[EffectClass], model_effects: Sequence[ModelEffect] = ()
) -> CouplingChoice:
    """The same maps about what is chosen where effects were taken out of them.

    Args:
        baseline: with the effects.
        fields: of each effect, (f, b, 2, q) what unit amplitudes move, px.
        families: that may be hidden, those without a name among them.
        model_effects: effects that are there.

    Raises:
        IllPosed: without the effects there is too little left.
    """
    observed = baseline.design.observation
    amplitudes, spans = fitted_amplitudes(baseline), baseline.design.effect_columns(fields, len(model_effects))
    moved = np.sum([field @ amplitudes[own] for field, own in zip(fields, spans, strict=True)], axis=0)
    interpolated = interpolate_to_grid(observed, moved - moved[0], observed.grid)
    chosen, rival = baseline_solution(reset_model_selection(observed.state, lambda candidate: subtract_effects(candidate, interpolated)))
    repeated = make_observation(_about_the_whole(chosen, observed), observed.steps, rival and _about_the_whole(rival, observed))
    return choose_coupling(repeated, families, model_effects)


def _about_the_whole(solution: Solution, observation: Observation) -> Solution:
    """With the maps as they were seen."""
    full = {(map_rows.reference, map_rows.current): map_rows.dmap for map_rows in observation.state.rows}
    return replace(solution, state=with_maps(solution.state, lambda candidate: full[candidate.reference, candidate.current]))


def _otherwise(observation: Observation) -> Observation | None:
    """The same maps with the other coupling; None where there is no doubt, or other blocks would be compared."""
    if observation.alternative_solution is None:
        return None
    try:
        other = make_observation(observation.alternative_solution, observation.steps)
    except IllPosed:
        return None
    return other if np.array_equal(other.valid_blocks, observation.valid_blocks) else None
