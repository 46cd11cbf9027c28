"""Selection of the linearisation point of a run jointly with possible hidden effects.

The estimate selects distortion advection, smoothness, and the distortion before any effect is identified. A tilt with load of 0.16 px gave
an advection coefficient of 0.74 +- 0.02 instead of 0. With advection the residual of the distortion exceeded the tilt, and three wrong
effects were identified.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semlive.data.diagnosis.effects import ModelEffect
from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.model_effects import fitted_amplitudes, interpolate_to_grid, subtract_effects
from semlive.diagnose.baseline.observation import Observation, baseline_solution, make_observation
from semlive.diagnose.maps.screening import Screening
from semlive.diagnose.parallel import parallel_map
from semlive.errors import IllPosed
from semlive.estimate.joint.observations.reformulate import reset_model_selection, with_maps
from semlive.estimate.joint.solution.posterior import Solution
from semlive.model.effects import EffectClass

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class CouplingChoice:
    """A run with the selected distortion advection.

    Attributes:
        observation: observation with that choice.
        screening: all effect classes scored with it if they decided; None if the choice was not in doubt.
    """

    observation: Observation
    screening: Screening | None = None

    @property
    def best_log_evidence(self) -> float:
        """Log likelihood of the data with the most likely effect class; requires the screening."""
        return -np.inf if self.screening is None else self.screening.best_log_evidence


def choose_coupling(observation: Observation, families: Sequence[EffectClass], model_effects: Sequence[ModelEffect] = ()) -> CouplingChoice:
    """Select distortion advection on or off, whichever is more likely jointly with the most significant effect.

    Args:
        observation: observation with the choice of the estimate.
        families: candidate effect classes, including unnamed ones.
        model_effects: effects given by the user.
    """
    alternative = _alternative_observation(observation)
    if alternative is None:
        return CouplingChoice(observation)
    choices = parallel_map(
        lambda candidate: CouplingChoice(candidate, Screening.run(candidate, families, model_effects)), (observation, alternative)
    )
    return max(choices, key=lambda candidate: candidate.best_log_evidence)


def relinearise_with_effects(
    baseline: HyperparameterGrid, fields: Sequence[Array], families: Sequence[EffectClass], model_effects: Sequence[ModelEffect] = ()
) -> CouplingChoice:
    """Estimate again from maps corrected for the effects, and linearise the original maps there.

    Args:
        baseline: the baseline with the effects.
        fields: for each effect, (f, b, 2, q) displacement of unit amplitudes, px.
        families: candidate effect classes, including unnamed ones.
        model_effects: effects given by the user.

    Raises:
        IllPosed: too few data remain without the effects.
    """
    observed = baseline.design.observation
    amplitudes, spans = fitted_amplitudes(baseline), baseline.design.effect_columns(fields, len(model_effects))
    moved = np.sum([field @ amplitudes[own] for field, own in zip(fields, spans, strict=True)], axis=0)
    interpolated = interpolate_to_grid(observed, moved - moved[0], observed.grid)
    chosen, rival = baseline_solution(reset_model_selection(observed.state, lambda candidate: subtract_effects(candidate, interpolated)))
    repeated = make_observation(_with_original_maps(chosen, observed), observed.steps, rival and _with_original_maps(rival, observed))
    return choose_coupling(repeated, families, model_effects)


def _with_original_maps(solution: Solution, observation: Observation) -> Solution:
    """The solution with the original maps."""
    full = {(map_rows.reference, map_rows.current): map_rows.dmap for map_rows in observation.state.rows}
    return replace(solution, state=with_maps(solution.state, lambda candidate: full[candidate.reference, candidate.current]))


def _alternative_observation(observation: Observation) -> Observation | None:
    """Observation with the other distortion advection; None if it is not in doubt or would compare different blocks."""
    if observation.alternative_solution is None:
        return None
    try:
        alternative = make_observation(observation.alternative_solution, observation.steps)
    except IllPosed:
        return None
    return alternative if np.array_equal(alternative.valid_blocks, observation.valid_blocks) else None
