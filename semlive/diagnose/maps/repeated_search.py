"""Searches of the maps for effects, repeated at another linearisation point and with other noise where the first result requires it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semlive.data.diagnosis.effects import DomainTest, ModelEffect
from semlive.data.diagnosis.misfit_reason import MisfitCriterion, MisfitReason
from semlive.data.diagnosis.verdict import AdequacyTest
from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.bayes_factor import NullDraws
from semlive.diagnose.baseline.observation import Observation
from semlive.diagnose.baseline.unequal_noise import unequal_noise
from semlive.diagnose.fit_tests.adequacy import adequacy_of_design, negligible_px
from semlive.diagnose.fit_tests.domain_tests import run_domain_tests
from semlive.diagnose.maps.effect_selection import MIN_LOG_ODDS, SIGNIFICANT_LOG_FACTOR, SelectedEffect
from semlive.diagnose.maps.refinement import RefinedEffect, refit_jointly
from semlive.diagnose.maps.relinearise import CouplingChoice, choose_coupling, relinearise_with_effects
from semlive.diagnose.maps.screening import Screening
from semlive.diagnose.maps.search import Search, is_full, search
from semlive.diagnose.maps.time_course_test import alternative_time_course_odds
from semlive.diagnose.maps.unnamed_fields import UNNAMED_CLASSES
from semlive.errors import IllPosed
from semlive.model.effects import EffectClass
from semlive.model.effects.maps.image_field import DISTORTION_SCALE_DRIFT

Array = NDArray[np.float64]
MAX_REPEATED_PARAMETERS = 1_500  # of a baseline: two searches of a run with 1,682 needed 2.6 GB and 100 s of processor time
MIN_COURSE_CHANGE = 0.1  # of the noise of a block


def repeated_search(
    observation: Observation, families: Sequence[EffectClass], model_effects: Sequence[ModelEffect], draws: tuple[int, int]
) -> SearchResult:
    """Search the maps for effects; repeat the search where its result may depend on the linearisation point or the noise.

    Args:
        observation: observation of a run.
        families: the named effect classes that may be found.
        model_effects: effects already in the model.
        draws: number and seed of the null draws.

    Raises:
        IllPosed: the data are too few to identify an effect.
        BadInput: a given effect is unknown or not observable in these data.
    """
    result = SearchResult.run(choose_coupling(observation, (*families, *UNNAMED_CLASSES), model_effects), families, model_effects, draws)
    if result.needs_second_pass:
        result = _second_pass(result, families, model_effects, draws)
    if result.effects or result.residual_significant:
        result = _with_unequal_noise(result, families, model_effects, draws)
    elif result.search.underresolved_splines and observation.geometry.composed.any():
        result = _with_shared_noise(result, families, model_effects, draws)
    return _without_negligible(result, model_effects)


@dataclass(frozen=True, slots=True, eq=False)
class SearchResult:
    """Result of a search at one linearisation point.

    Attributes:
        domain_tests: tests of the model in each domain, before any effect was added.
        search: the final state of the search.
        baseline_with_effects: the baseline with all effects.
        effects: the identified effects, fitted jointly.
        fields: for each effect, given ones first, (f, b, 2, q) displacement of unit amplitudes, px.
        unexplained: why something in the data is not explained: a residual, or an effect with another time course than its basis field.
        searches: number of searches of the verdict so far.
    """

    domain_tests: tuple[DomainTest, ...]
    search: Search
    baseline_with_effects: HyperparameterGrid
    effects: tuple[SelectedEffect, ...]
    fields: tuple[Array, ...]
    unexplained: tuple[MisfitReason, ...]
    searches: int = 1

    @classmethod
    def run(
        cls,
        run: CouplingChoice,
        families: Sequence[EffectClass],
        model_effects: Sequence[ModelEffect],
        draws: tuple[int, int],
        earlier: SearchResult | None = None,
    ) -> SearchResult:
        """Search for effects with the given number and seed of null draws, after an earlier search or as the first one."""
        screening = run.screening or Screening.run(run.observation, (*families, *UNNAMED_CLASSES), model_effects)
        null = NullDraws.of(screening.baseline, *draws)
        earlier_work, searches = (earlier.search.work, earlier.searches) if earlier else (0.0, 0)
        tests, final = run_domain_tests(screening.baseline, null), search(screening, families, null, draws[1], earlier_work)
        effects = _refit_jointly(final.baseline_with_effects, final.effects)
        residual = final.remaining
        unexplained = () if residual is None else (MisfitReason(MisfitCriterion.RESIDUAL, residual.family.name, residual.log_factor),)
        return cls(
            tests,
            final,
            final.baseline_with_effects,
            effects,
            (*screening.model_fields, *(effect.refined.field_px for effect in effects)),
            unexplained or _more_likely_alternatives(final.baseline, final.baseline_with_effects, effects),
            searches + 1,
        )

    @property
    def residual_significant(self) -> bool:
        """Whether something in the data is not explained."""
        return bool(self.unexplained)

    @property
    def allows_another_search(self) -> bool:
        """Whether another search with the average work of those so far, and its memory next to that of this one, are within the limits."""
        fits = self.baseline_with_effects.design.size <= MAX_REPEATED_PARAMETERS
        return fits and self.search.allows(self.search.work / self.searches)

    def truncated(self) -> SearchResult:
        """The same result, marked as without a search that its criteria require."""
        return replace(self, search=replace(self.search, truncated=True))

    def after(self, other: SearchResult) -> SearchResult:
        """The same result with the work of a later search, whose result was less likely."""
        return replace(self, searches=other.searches, search=replace(self.search, work=other.search.work))

    @property
    def best_log_evidence(self) -> float:
        """Log likelihood of the data with the effects, or with the most likely class of the first screening, unnamed ones included."""
        first = max((candidate.log_factor for candidate in self.search.initial_screening), default=0.0)
        return max(self.baseline_with_effects.log_evidence, self.search.baseline.log_evidence + first)

    @property
    def needs_second_pass(self) -> bool:
        """Whether the effects may have biased the earlier selections, so that further effects compensate the error.

        A distortion that scales biases the estimated distortion, which is its own basis field: with an affine part of 6 px only a third to
        three quarters of the estimate was distortion.
        """
        scales = any(effect.refined.family is DISTORTION_SCALE_DRIFT for effect in self.effects)
        return bool(self.effects) and not self.search.truncated and (self.residual_significant or is_full(self.effects) or scales)


def _second_pass(
    result: SearchResult, families: Sequence[EffectClass], model_effects: Sequence[ModelEffect], draws: tuple[int, int]
) -> SearchResult:
    """Search at the linearisation point selected without the effects, if it differs and the data are more likely there."""
    try:
        repeated = relinearise_with_effects(result.baseline_with_effects, result.fields, (*families, *UNNAMED_CLASSES), model_effects)
    except IllPosed:
        return result
    before, observed = result.baseline_with_effects.design.observation, repeated.observation
    if not np.array_equal(observed.valid_blocks, before.valid_blocks):
        return result
    same_advection = observed.state.distortion.carried == before.state.distortion.carried
    if same_advection and not any(_prediction_changes(effect.refined, observed, result.baseline_with_effects) for effect in result.effects):
        return result
    if not result.allows_another_search:
        return result.truncated()
    other = SearchResult.run(repeated, families, model_effects, draws, result)
    more_likely = other.baseline_with_effects.log_evidence > result.baseline_with_effects.log_evidence
    return other if more_likely else result.after(other)


def _with_unequal_noise(
    result: SearchResult, families: Sequence[EffectClass], model_effects: Sequence[ModelEffect], draws: tuple[int, int]
) -> SearchResult:
    """Search with noise that differs between frames and places, if the data are more likely so than with effects and equal noise.

    Effects that the baseline lacks make its noise unequal, in 10 of 19 runs of one noise with one effect at four times the detection limit.
    With the effects it was equal in all 19, and the further search, two fifths of the processor time of the verdict, was never more likely.
    """
    noise = unequal_noise(result.search.baseline)
    explained = result.effects and not result.residual_significant
    if noise is None or result.search.truncated or (explained and unequal_noise(result.baseline_with_effects) is None):
        return result
    if not result.allows_another_search:
        return result.truncated()
    observation = result.search.baseline.design.observation
    screening = Screening.run(observation, (*families, *UNNAMED_CLASSES), model_effects, noise.whiten)
    other = SearchResult.run(CouplingChoice(observation, screening), families, model_effects, draws, result)
    return other if other.best_log_evidence - noise.parameter_penalty > result.best_log_evidence else result.after(other)


def _with_shared_noise(
    result: SearchResult, families: Sequence[EffectClass], model_effects: Sequence[ModelEffect], draws: tuple[int, int]
) -> SearchResult:
    """The search with the noise that composed maps share with their first frames, if nothing is beyond it; else the given result.

    In 68 of 100 runs of composed maps without an effect, the spline of the distortion was too coarse for such noise.
    """
    other = _with_unequal_noise(result, families, model_effects, draws)
    test = None if other.effects or other.residual_significant else residual_adequacy(other, model_effects)
    return other if test is not None and test.passed else result


def _without_negligible(result: SearchResult, model_effects: Sequence[ModelEffect]) -> SearchResult:
    """The result without effects if all of them are negligible, and the residual without them passes the test of adequacy."""
    scene = result.search.baseline.design.observation.geometry
    if not result.effects or any(effect.refined.peak_px > negligible_px(effect.refined.family.name, scene) for effect in result.effects):
        return result
    baseline = result.search.baseline
    plain = replace(result, baseline_with_effects=baseline, effects=(), fields=result.fields[: len(model_effects)], unexplained=())
    test = residual_adequacy(plain, model_effects)
    return plain if test is not None and test.passed else result


def residual_adequacy(result: SearchResult, model_effects: Sequence[ModelEffect]) -> AdequacyTest | None:
    """Test of the residual with all effects; None where a spline is too coarse, which the verdict states, or without a factor."""
    if result.search.underresolved_splines:
        return None
    columns = result.search.baseline.design
    sizes_px = [*(effect.size_px for effect in model_effects), *(effect.refined.baseline_effect.size_px for effect in result.effects)]
    try:
        return adequacy_of_design(columns.without_effects(), tuple(zip(result.fields, sizes_px, strict=True))).test
    except np.linalg.LinAlgError:
        return None


def _prediction_changes(effect: RefinedEffect, observation: Observation, baseline_with_effects: HyperparameterGrid) -> bool:
    """Whether the prediction of an effect differs at another linearisation point by more than a fraction of the noise."""
    basis_field = effect.family.basis_field(observation.geometry, dict(effect.values))
    if basis_field is None:
        return True
    change = (basis_field.field_px - effect.field_px) @ effect.amplitudes
    return float(np.sqrt(np.mean((change - change[0]) ** 2))) > MIN_COURSE_CHANGE * baseline_with_effects.design.whiten.sigma_px


def _refit_jointly(baseline_with_effects: HyperparameterGrid, effects: Sequence[SelectedEffect]) -> tuple[SelectedEffect, ...]:
    """Effects with jointly refitted amplitudes; selected effects are removed from the lists of rivals."""
    families = {effect.refined.family for effect in effects}
    refitted = zip(effects, refit_jointly(baseline_with_effects, [effect.refined for effect in effects]), strict=True)
    return tuple(
        replace(value, refined=refit, rivals=tuple(o for o in value.rivals if o.family not in families)) for value, refit in refitted
    )


def _more_likely_alternatives(
    baseline: HyperparameterGrid, baseline_with_effects: HyperparameterGrid, effects: Sequence[SelectedEffect]
) -> tuple[MisfitReason, ...]:
    """Whether an unnamed field, in any round, or another time course is more likely than the named effects; empty if not."""
    remaining_factors = np.cumsum([effect.log_bayes_factor for effect in reversed(effects)])[::-1]
    for effect, total in zip(effects, remaining_factors, strict=True):
        if effect.unnamed_log_factor > total + MIN_LOG_ODDS:
            return (MisfitReason(MisfitCriterion.UNNAMED_FIELD, effect.names[0], float(effect.unnamed_log_factor - total)),)
    odds = alternative_time_course_odds(baseline_with_effects, baseline.design, [effect.refined for effect in effects])
    return (MisfitReason(MisfitCriterion.TIME_COURSE, value=float(odds)),) if odds > SIGNIFICANT_LOG_FACTOR else ()
