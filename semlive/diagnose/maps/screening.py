"""Initial screening of a run: the baseline, and the evidence of every effect class added to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.data.diagnosis.effects import ModelEffect
from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.bayes_factor import CandidateEvidence, project_candidates, score_candidates
from semlive.diagnose.baseline.model_effects import add_model_effects
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.baseline.observation import Observation
from semlive.diagnose.baseline.projection import Projections
from semlive.diagnose.baseline.whitening import Whitener
from semlive.diagnose.maps.effect_selection import refine_parameters
from semlive.model.effects import EffectClass


@dataclass(frozen=True, slots=True, eq=False)
class Screening:
    """Evidence of effect classes added to a baseline with only the given effects.

    Attributes:
        baseline: the baseline.
        model_fields: (f, b, 2, q) displacement of unit amplitudes of each given effect, px.
        projected_candidates: projected basis fields of the classes, for repeated scoring.
        candidates: evidence of each class; classes not observable in this run are left out.
    """

    baseline: HyperparameterGrid
    model_fields: tuple[NDArray[np.float64], ...]
    projected_candidates: Projections
    candidates: tuple[CandidateEvidence, ...]

    @classmethod
    def run(
        cls,
        observation: Observation,
        families: Sequence[EffectClass],
        model_effects: Sequence[ModelEffect],
        whiten: Whitener | None = None,
    ) -> Screening:
        """Score all effect classes.

        Args:
            observation: observation of a run.
            families: effect classes to score.
            model_effects: effects given by the user.
            whiten: correlation of the noise, if it is not to be estimated.

        Raises:
            BadInput: a given effect is unknown or not observable in these data.
        """
        baseline, model_fields = add_model_effects(noise_scaled_baseline(observation, whiten), model_effects)
        projections = project_candidates(baseline, families)
        return cls(baseline, model_fields, projections, refine_parameters(baseline, score_candidates(baseline, families, projections)))

    @property
    def best_log_evidence(self) -> float:
        """Log likelihood of the data with the most likely effect class."""
        return self.baseline.log_evidence + max((candidate.log_factor for candidate in self.candidates), default=0.0)
