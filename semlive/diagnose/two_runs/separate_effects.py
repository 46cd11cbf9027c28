"""Effects whose amplitudes belong to each run: their evidence is the sum over the runs, their size the largest in any run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from semlive.data.diagnosis.two_runs import SharedEffect
from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.bayes_factor import CandidateEvidence, score_candidates
from semlive.diagnose.maps.refinement import refined
from semlive.model.effects import EFFECT_CLASSES, TWO_RUN_EFFECT_CLASSES


@dataclass(frozen=True, slots=True, eq=False)
class SeparateEvidence:
    """Evidence for an effect class from separate runs.

    Attributes:
        log_factor: log Bayes factor, summed over the runs.
        candidates: the runs that observe the effect, each with its evidence.
    """

    log_factor: float
    candidates: tuple[tuple[HyperparameterGrid, CandidateEvidence], ...]

    def effect(self) -> SharedEffect:
        """The effect with its largest size in any run; its parameters differ between the runs."""
        name = self.candidates[0][1].family.name
        return SharedEffect(name, (name,), max(refined(run, candidate).peak_px for run, candidate in self.candidates), ())


def separate_evidence(runs: Sequence[HyperparameterGrid]) -> dict[str, SeparateEvidence]:
    """Evidence for all effect classes without common amplitudes, by name."""
    shared = {family.name for family in TWO_RUN_EFFECT_CLASSES}
    families, total = [family for family in EFFECT_CLASSES if family.name not in shared], dict[str, SeparateEvidence]()
    for run in runs:
        for candidate in score_candidates(run, families):
            before = total.get(candidate.family.name, SeparateEvidence(0.0, ()))
            candidates = (*before.candidates, (run, candidate))
            total[candidate.family.name] = SeparateEvidence(before.log_factor + candidate.log_factor, candidates)
    return total
