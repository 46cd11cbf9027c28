"""A run before anything in it is named: its baseline, and every family heard beside that."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.data.diagnosis import ModelEffect
from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.bayes_factor import CandidateEvidence, project_candidates, score_candidates
from semlive.diagnose.baseline.model_effects import add_model_effects
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.baseline.observation import Observation
from semlive.diagnose.baseline.projection import CandidateProjection
from semlive.diagnose.maps.effect_selection import refine_parameters
from semlive.model.effects import EffectClass


@dataclass(frozen=True, slots=True, eq=False)
class Screening:
    """Families beside a baseline that has nothing but what was known.

    Attributes:
        baseline: that baseline.
        model_fields: (f, b, 2, q) what unit amplitudes of each known effect move, px.
        projected_candidates: the families' laws, ready to be asked again.
        candidates: what each says; those that cannot be seen here are left out.
    """

    baseline: HyperparameterGrid
    model_fields: tuple[NDArray[np.float64], ...]
    projected_candidates: Mapping[str, CandidateProjection]
    candidates: tuple[CandidateEvidence, ...]

    @classmethod
    def run(cls, observation: Observation, families: Sequence[EffectClass], model_effects: Sequence[ModelEffect]) -> Screening:
        """Hear them.

        Raises:
            BadInput: a known effect has no such name, or cannot be in these data.
        """
        baseline, already = add_model_effects(noise_scaled_baseline(observation), model_effects)
        projections = project_candidates(baseline, families)
        return cls(baseline, already, projections, refine_parameters(baseline, score_candidates(baseline, families, projections)))

    @property
    def best_log_evidence(self) -> float:
        """Logarithm of the likelihood of the data beside the family that does most for it."""
        return self.baseline.log_evidence + max((candidate.log_factor for candidate in self.candidates), default=0.0)
