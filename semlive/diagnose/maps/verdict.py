"""The verdict: detected, adequate, unique, useful; in this order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semlive.data.diagnosis import Diagnosis, DomainTest, ExperimentProposal, HeldOutMisfit, IdentifiedEffect, ModelEffect, Outcome
from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.bayes_factor import CandidateEvidence, NullDraws, overlap
from semlive.diagnose.baseline.observation import Observation
from semlive.diagnose.baseline.strain_attenuation import MAX_ATTENUATION, strain_attenuation
from semlive.diagnose.maps.cross_validation import held_out_misfit
from semlive.diagnose.maps.domain_tests import run_domain_tests
from semlive.diagnose.maps.effect_selection import MIN_LOG_ODDS, SIGNIFICANT_LOG_FACTOR, SelectedEffect
from semlive.diagnose.maps.figure_data import figure_data
from semlive.diagnose.maps.refinement import RefinedEffect, refit_jointly
from semlive.diagnose.maps.relinearise import CouplingChoice, choose_coupling, relinearise_with_effects
from semlive.diagnose.maps.screening import Screening
from semlive.diagnose.maps.search import ALL_UNNAMED_CLASSES, MAX_EFFECTS, Search, search
from semlive.diagnose.maps.time_course_test import alternative_time_course_odds
from semlive.diagnose.maps.unnamed_fields import UNNAMED_CLASSES
from semlive.errors import IllPosed
from semlive.model.effects import EFFECT_CLASSES, EffectClass

Array = NDArray[np.float64]
DRAWS = 299
# Most of a gap; see `_useful`.
MIN_EXPLAINED_FRACTION = 0.5
MIN_COURSE_CHANGE = 0.1  # of a block's noise


def diagnose(
    observation: Observation,
    seed: int = 0,
    dictionary: Sequence[EffectClass] = EFFECT_CLASSES,
    draws: int = DRAWS,
    known: Sequence[ModelEffect] = (),
) -> Diagnosis:
    """Find where model and data disagree, and what is missing.

    Args:
        observation: of a run.
        seed: of the draws of the null.
        dictionary: the effects that have a name.
        draws: of the null.
        known: effects that the model has already; their amplitudes are refitted, and they are not looked for.

    Raises:
        IllPosed: the data are too few to name anything.
        BadInput: a known effect has no such name, or cannot be in these data.
    """
    families = [one for one in dictionary if one.name not in {item.name for item in known}]
    look = SearchResult.run(choose_coupling(observation, (*families, *UNNAMED_CLASSES), known), families, known, (draws, seed))
    if look.needs_second_pass:
        look = _looked_again(look, families, known, (draws, seed))
    bare, having, named = look.search.bare, look.baseline_with_effects, look.effects
    gap = held_out_misfit(bare, having, seed) if named else None
    shares = strain_attenuation(having, look.fields, len(known))[len(known) :]
    width, height = (2.0 * observation.state.centre_px + 1.0).round().astype(int).tolist()
    verdict = _verdict(named, look.residual_significant, gap, look.domain_tests, bare, shares)
    names, fields = [one.names[0] for one in named], [one.refined.field_px for one in named]
    pictures = figure_data(bare, having, names, fields) if named else None
    shared = _overlaps(bare, named[0].refined, look.search.initial_screening) if named else ()
    verdict = replace(
        verdict,
        figure_data=pictures,
        evidence=_told(look.search.initial_screening),
        overlap=shared,
        coarse=look.search.underresolved_splines,
    )
    return replace(verdict, model_effects=tuple(known), duration_s=observation.geometry.end_s, size_px=(width, height))


@dataclass(frozen=True, slots=True, eq=False)
class SearchResult:
    """What a search about one point of linearisation found.

    Attributes:
        domain_tests: where model and data disagree, before anything was named.
        search: the search.
        baseline_with_effects: the baseline with all effects.
        effects: they, refitted beside each other.
        fields: of each effect, those that were known first, (f, b, 2, q) what unit amplitudes move, px.
        residual_significant: whether something is left, or what was named does not go as its laws say.
    """

    domain_tests: tuple[DomainTest, ...]
    search: Search
    baseline_with_effects: HyperparameterGrid
    effects: tuple[SelectedEffect, ...]
    fields: tuple[Array, ...]
    residual_significant: bool

    @classmethod
    def run(
        cls, run: CouplingChoice, families: Sequence[EffectClass], known: Sequence[ModelEffect], draws: tuple[int, int]
    ) -> SearchResult:
        """Search; so many draws of the null, and the seed of these."""
        begun = run.screening or Screening.run(run.observation, (*families, *UNNAMED_CLASSES), known)
        null = NullDraws.of(begun.baseline, *draws)
        places, found = run_domain_tests(begun.baseline, null), search(begun, families, null, draws[1])
        named = _beside(found.baseline_with_effects, found.effects)
        loud = found.residual_significant or _unlike(found.bare, found.baseline_with_effects, named)
        return cls(places, found, found.baseline_with_effects, named, (*begun.model_fields, *(one.refined.field_px for one in named)), loud)

    @property
    def needs_second_pass(self) -> bool:
        """Whether the effects may have misled the choices that were made without them: one takes other names to mend what went wrong."""
        return bool(self.effects) and (self.residual_significant or len(self.effects) == MAX_EFFECTS)


def _looked_again(
    look: SearchResult, families: Sequence[EffectClass], known: Sequence[ModelEffect], draws: tuple[int, int]
) -> SearchResult:
    """About the point that is chosen without the effects, if that is another for what was named, and the data are likelier there."""
    try:
        again = relinearise_with_effects(look.baseline_with_effects, look.fields, (*families, *UNNAMED_CLASSES), known)
    except IllPosed:
        return look
    before, seen = look.baseline_with_effects.design.observation, again.observation
    if not np.array_equal(seen.valid_blocks, before.valid_blocks):
        return look
    alike = seen.state.distortion.carried == before.state.distortion.carried
    if alike and not any(_moves_otherwise(one.refined, seen, look.baseline_with_effects) for one in look.effects):
        return look
    return max((look, SearchResult.run(again, families, known, draws)), key=lambda one: one.baseline_with_effects.log_evidence)


def _moves_otherwise(one: RefinedEffect, seen: Observation, having: HyperparameterGrid) -> bool:
    """Whether a law says something else of the maps about another point: by more than a part of their noise."""
    law = one.family.law(seen.geometry, dict(one.values))
    if law is None:
        return True
    change = (law.field_px - one.field_px) @ one.amplitudes
    return float(np.sqrt(np.mean((change - change[0]) ** 2))) > MIN_COURSE_CHANGE * having.design.whiten.sigma_px


def _beside(having: HyperparameterGrid, named: Sequence[SelectedEffect]) -> tuple[SelectedEffect, ...]:
    """With amplitudes refitted beside each other; what was named itself is nobody's rival."""
    taken = {one.refined.family for one in named}
    both = zip(named, refit_jointly(having, [one.refined for one in named]), strict=True)
    return tuple(replace(one, refined=refit, rivals=tuple(o for o in one.rivals if o.family not in taken)) for one, refit in both)


def _unlike(bare: HyperparameterGrid, having: HyperparameterGrid, named: Sequence[SelectedEffect]) -> bool:
    """Whether something without a name is likelier than all names from some round on, or another course than that of their laws."""
    gained = np.cumsum([one.log_bayes_factor for one in reversed(named)])[::-1]
    if any(one.unnamed_log_factor > total + MIN_LOG_ODDS for one, total in zip(named, gained, strict=True)):
        return True
    return alternative_time_course_odds(having, bare.design, [one.refined for one in named]) > SIGNIFICANT_LOG_FACTOR


def _told(heard: Sequence[CandidateEvidence]) -> tuple[tuple[str, float], ...]:
    return tuple((one.family.name, one.log_factor) for one in heard)


def _overlaps(bare: HyperparameterGrid, named: RefinedEffect, heard: Sequence[CandidateEvidence]) -> tuple[tuple[str, float], ...]:
    """What other names, each as it is likeliest here, could take over of an effect; the most first."""
    scene, field = bare.design.observation.geometry, named.field_px @ named.amplitudes
    found = []
    for one in heard:
        law = None if one.family is named.family or one.family in ALL_UNNAMED_CLASSES else one.family.law(scene, one.values[one.best[0]])
        if law is not None:
            found.append((one.family.name, overlap(bare, field, law.field_px)))
    return tuple(sorted(found, key=lambda item: -item[1]))


def _verdict(
    named: Sequence[SelectedEffect],
    loud: bool,
    gap: HeldOutMisfit | None,
    places: tuple[DomainTest, ...],
    bare: HyperparameterGrid,
    shares: Sequence[float],
) -> Diagnosis:
    effects = tuple(_found(one, share) for one, share in zip(named, shares, strict=True))
    noise_px = bare.design.whiten.sigma_px
    unsure = next((one for one in named if one.rivals or len(one.names) > 1), None)
    if not named:
        outcome = Outcome.UNKNOWN if loud else Outcome.NONE
    elif loud:  # what was named explains a part at best
        outcome = Outcome.UNKNOWN
    elif gap is not None and not _useful(gap, sum(one.log_bayes_factor for one in named)):
        outcome = Outcome.REJECTED
    else:
        outcome = Outcome.AMBIGUOUS if unsure else Outcome.IDENTIFIED
    if outcome is Outcome.AMBIGUOUS and unsure is not None:
        among = (unsure.refined.family, *(one.family for one in unsure.rivals))
        decides = next((one.discriminating_experiment for one in among if one.discriminating_experiment), "more pairs")
        names = (*unsure.names, *(one.family.name for one in unsure.rivals))
        return Diagnosis(outcome, effects, names, _group(among), ExperimentProposal(names, decides), gap, places, noise_px)
    return Diagnosis(outcome, effects, (), _group([one.refined.family for one in named]), None, gap, places, noise_px)


def _found(one: SelectedEffect, share: float) -> IdentifiedEffect:
    family, refined = one.refined.family, one.refined
    return IdentifiedEffect(
        one.names[0],
        refined.parameters,
        refined.peak_px,
        one.log_bayes_factor,
        one.p_value,
        family.strain_like or share > MAX_ATTENUATION,
        ModelEffect(family.name, refined.values, refined.baseline_effect.size_px),
        tuple(refined.amplitudes.tolist()),
        tuple(tuple(row) for row in refined.covariance.tolist()),
        share,
    )


def _group(families: Sequence[EffectClass]) -> str | None:
    return next((one.group for one in families if one.group), None)


def _useful(gap: HeldOutMisfit, log_factor: float) -> bool:
    """With what held-out pairs say against them effects would still be loud, and nothing says that most of their gap stays open.

    At twice the least effect that can be detected a real one gains 1.5 +- 1 standard errors on held-out pairs or, where they leave little
    of it to be seen, nothing: creep with a logarithm of the Bayes factor of 43 was rejected for a loss of 1.2.
    """
    return log_factor + min(gap.log_odds, 0.0) > SIGNIFICANT_LOG_FACTOR and gap.closure_interval[1] > MIN_EXPLAINED_FRACTION
