"""An effect of the dictionary that explains the maps better than the optional terms of the estimate which correct them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from semlive.data.notes import Note, NoteCode, warning
from semlive.data.pair import PairDecision
from semlive.diagnose.baseline.baseline import best_point
from semlive.diagnose.baseline.bayes_factor import score_candidates
from semlive.diagnose.baseline.noise_scale import noise_scaled_design
from semlive.diagnose.baseline.observation import Observation, evaluate_estimate
from semlive.diagnose.maps.effect_selection import SIGNIFICANT_LOG_FACTOR
from semlive.estimate.joint.solution.posterior import Solution
from semlive.model import RasterTerm
from semlive.model.effects import EFFECT_CLASSES

TERM_EFFECTS = {
    RasterTerm.MAGNIFICATION.value: ("magnification_drift", "magnification_frame_instability", "refocus_magnification_step"),
    RasterTerm.ROTATION.value: ("raster_rotation_drift", "stage_yaw"),
}
"""Effects of the dictionary with the displacement field of each raster term: a term is right if one of them is the most likely."""


@dataclass(frozen=True, slots=True)
class TermRival:
    """An effect that explains the maps better than the raster terms of the estimate.

    Attributes:
        terms: names of the terms that the estimate uses.
        effect: name of the effect.
        log_odds: natural logarithm of the odds for the effect, against the most likely effect with the field of one of the terms.
    """

    terms: tuple[str, ...]
    effect: str
    log_odds: float

    @property
    def text(self) -> str:
        """The rival, one clause."""
        terms = " and ".join(term.replace("_", " ") for term in self.terms)
        return (
            f"the estimate corrects a drift of {terms}, but {self.effect} explains the maps better (logarithm of the odds "
            f"{self.log_odds:.0f})"
        )


def rival_of_terms(observation: Observation) -> TermRival | None:
    """The rival of the raster terms that the first solution uses, each effect added to a baseline without these terms; None without one.

    A bending of 0.3 px was taken for a drift of the raster rotation with an evidence of 24 and 26. The odds for the bending are exp(1700);
    where the rotation drifts by 0.3 px, the best other effect is less likely than the drift by exp(-640).

    Args:
        observation: observation of a run.
    """
    used = tuple(term.name for term in observation.solution.terms if term.included and term.name in TERM_EFFECTS)
    if not used:
        return None
    baseline = best_point(noise_scaled_design(observation))  # one smoothness: a live run has less memory than a diagnosis
    scores = {found.family.name: found.log_factor for found in score_candidates(baseline, EFFECT_CLASSES)}
    own = {name for term in used for name in TERM_EFFECTS[term]}
    best = max(scores.keys() - own, key=lambda name: scores[name])
    log_odds = scores[best] - max(scores.get(name, 0.0) for name in own)
    return TermRival(used, best, log_odds) if log_odds > SIGNIFICANT_LOG_FACTOR else None


def rival_after(solution: Solution, decisions: Sequence[PairDecision]) -> TermRival | None:
    """The rival of the terms of an estimate; None without one, with too few pairs or points, or more pairs than one matrix holds.

    Args:
        solution: solution of the joint method after the newest pair.
        decisions: decisions of all pairs.
    """
    return evaluate_estimate(solution, decisions, rival_of_terms)


def rival_notes(rival: TermRival | None) -> tuple[Note, ...]:
    """A warning about a rival; empty without one."""
    if rival is None:
        return ()
    return (warning(NoteCode.TERM_RIVAL, f"{rival.text}: identify the missing effect with `semlive diagnose LOG`"),)
