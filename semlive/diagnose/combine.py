"""Combination of the verdicts of all channels: disparity maps, row registration and intensity."""

from __future__ import annotations

from dataclasses import replace

from semlive.data.diagnosis.channels import IntensityDiagnosis, RowDiagnosis
from semlive.data.diagnosis.effects import HeldOutMisfit, IdentifiedEffect, Outcome
from semlive.data.diagnosis.misfit_reason import MisfitCriterion, MisfitReason
from semlive.data.diagnosis.verdict import AdequacyTest, Diagnosis, ExperimentProposal
from semlive.model.effects.intensity import CHARGING_JUMP
from semlive.model.effects.stage import non_map_effect

_IDENTIFIED_OUTCOMES = (Outcome.IDENTIFIED, Outcome.AMBIGUOUS)
_CHARGING_EFFECTS = ("charging_frame_ramp", "charging_local_lens")
"""Effects of the maps that also change the grey levels."""
_JUMPS = ("drift_jump", "jump_within_pair")
_MAX_DEVIATION_SIGMAS = 3.0  # combined standard uncertainties of two instants
COINCIDENCE_S = 10.0  # time resolution of the maps: a subset of 43 rows takes 4 s at 0.1 s per row


def add_row_verdict(maps: Diagnosis, rows: RowDiagnosis) -> Diagnosis:
    """Combine the verdict of the maps with that of the rows."""
    return _combine(replace(maps, images=replace(maps.images, rows=rows)), rows, rows.gap)


def add_map_wave_verdict(maps: Diagnosis, waves: RowDiagnosis, adequacy: AdequacyTest | None) -> Diagnosis:
    """Combine the verdict of the maps with that of waves in the maps within pairs.

    A residual of the maps in which nothing else was found, and which is noise with the wave, is explained by it.

    Args:
        maps: verdict so far.
        waves: verdict on waves.
        adequacy: test of the residual of the maps with the wave; None if it was not possible, or without a wave.
    """
    explained = maps.outcome is Outcome.UNKNOWN and not maps.effects and adequacy is not None and adequacy.passed
    if waves.outcome is Outcome.IDENTIFIED and explained:
        maps = replace(maps, outcome=Outcome.NONE, adequacy=adequacy, closest=(), outside=None, unexplained=())
    return _combine(maps, waves)


def add_intensity_verdict(verdict: Diagnosis, grey: IntensityDiagnosis) -> Diagnosis:
    """Combine the verdict so far with that of the intensity.

    Unexplained intensity changes are attributed to charging if the maps identified it. A jump of the maps that coincides with a flash is
    attributed to charging.
    """
    verdict = replace(verdict, images=replace(verdict.images, grey=grey))
    if grey.outcome is Outcome.UNKNOWN and {effect.name for effect in verdict.effects} & set(_CHARGING_EFFECTS):
        return _combine(verdict, replace(grey, outcome=Outcome.IDENTIFIED if grey.effects else Outcome.NONE))
    flash = next((effect for effect in grey.effects if effect.name == CHARGING_JUMP.name), None)
    jump = (
        None if flash is None else next((effect for effect in verdict.effects if effect.name in _JUMPS and _coincide(effect, flash)), None)
    )
    if flash is None or jump is None:
        return _combine(verdict, grey)
    verdict = _rename_jump(verdict, jump, flash)
    other_effects = tuple(effect for effect in grey.effects if effect is not flash)
    outcome = Outcome.NONE if not other_effects and grey.outcome is not Outcome.UNKNOWN else grey.outcome
    return _combine(verdict, replace(grey, effects=other_effects, outcome=outcome))


def _combine(maps: Diagnosis, channel: RowDiagnosis | IntensityDiagnosis, gap: HeldOutMisfit | None = None) -> Diagnosis:
    """Combine two channels. Unexplained misfit or a rejected effect of one channel is not compensated by an effect of the other.

    A rejected effect of the rows does not change the effects identified from the maps.
    """
    merged = replace(maps, where=(*maps.where, *channel.where), evidence=(*maps.evidence, *channel.evidence))
    if channel.outcome is Outcome.NONE or (channel.outcome is Outcome.REJECTED and maps.outcome is not Outcome.NONE):
        return merged
    if channel.outcome is Outcome.UNKNOWN and maps.outcome is not Outcome.REJECTED:
        criterion = MisfitCriterion.ROWS if isinstance(channel, RowDiagnosis) else MisfitCriterion.GREY_LEVELS
        return replace(
            merged,
            outcome=Outcome.UNKNOWN,
            effects=(*maps.effects, *channel.effects),
            ambiguous=(),
            experiment=None,
            unexplained=(*maps.unexplained, MisfitReason(criterion)),
        )
    merged = replace(merged, effects=(*maps.effects, *channel.effects))
    if maps.outcome is Outcome.NONE or (maps.outcome is Outcome.IDENTIFIED and channel.outcome in _IDENTIFIED_OUTCOMES):
        outcome = channel.outcome
    else:
        outcome = maps.outcome
    merged = replace(merged, outcome=outcome, gap=maps.gap or gap)
    first = non_map_effect(channel.effects[0].name) if channel.effects else None
    if first is not None and maps.group is None:
        merged = replace(merged, group=first.group)
    if outcome is Outcome.AMBIGUOUS and maps.outcome is not Outcome.AMBIGUOUS and first is not None:
        merged = replace(
            merged, ambiguous=channel.ambiguous, experiment=ExperimentProposal(channel.ambiguous, first.discriminating_experiment)
        )
    return merged


def _rename_jump(verdict: Diagnosis, jump: IdentifiedEffect, flash: IdentifiedEffect) -> Diagnosis:
    """The verdict with a jump renamed to the effect of the flash; basis field and size remain those of the maps."""
    charge = replace(jump, name=flash.name, parameters=(*jump.parameters, *flash.parameters))
    names = tuple(dict.fromkeys(flash.name if value in _JUMPS else value for value in verdict.ambiguous))
    merged = replace(
        verdict,
        effects=tuple(charge if effect is jump else effect for effect in verdict.effects),
        ambiguous=names,
        group=CHARGING_JUMP.group,
    )
    if verdict.outcome is Outcome.AMBIGUOUS and len(names) == 1:  # the flash has decided
        merged = replace(merged, outcome=Outcome.IDENTIFIED, ambiguous=(), experiment=None)
    return merged


def _coincide(jump: IdentifiedEffect, flash: IdentifiedEffect) -> bool:
    """Whether a flash coincides with the jump within the uncertainty of the maps."""
    parameters = {parameter.name: parameter for parameter in jump.parameters}
    at = parameters.get("at_s")
    if at is None:
        return False
    observed = [parameter for parameter in flash.parameters if parameter.name.endswith("at_s")]
    return any(
        abs(entry.value - at.value) <= _MAX_DEVIATION_SIGMAS * (entry.sigma**2 + at.sigma**2) ** 0.5 + COINCIDENCE_S for entry in observed
    )
