"""Combination of the verdicts of all channels: disparity maps, row registration and intensity."""

from __future__ import annotations

from dataclasses import replace

from semlive.data.diagnosis.channels import IntensityDiagnosis, RowDiagnosis
from semlive.data.diagnosis.effects import HeldOutMisfit, IdentifiedEffect, Outcome
from semlive.data.diagnosis.verdict import Diagnosis, ExperimentProposal
from semlive.model.effects.intensity import CHARGING_JUMP
from semlive.model.effects.stage import non_map_effect

_NAMED = (Outcome.IDENTIFIED, Outcome.AMBIGUOUS)
_BRIGHTER = ("charging_frame_ramp", "charging_local_lens")
"""Effects of maps that grey goes along with."""
_JUMPS = ("drift_jump", "jump_within_pair")
_ALIKE = 3.0  # standard uncertainties of both
COINCIDENCE_S = 10.0  # maps know an instant no better: a subset has 43 rows of 0.1 s


def add_row_verdict(maps: Diagnosis, rows: RowDiagnosis) -> Diagnosis:
    """Combine the verdict of the maps with that of the rows."""
    return _joined(replace(maps, rows=rows), rows, rows.gap)


def add_intensity_verdict(found: Diagnosis, grey: IntensityDiagnosis) -> Diagnosis:
    """Combine the verdict so far with that of the intensity.

    Unexplained intensity changes are attributed to charging if the maps identified it. A jump of the maps that coincides with a flash is
    attributed to charging.
    """
    found = replace(found, grey=grey)
    if grey.outcome is Outcome.UNKNOWN and {effect.name for effect in found.effects} & set(_BRIGHTER):
        return _joined(found, replace(grey, outcome=Outcome.IDENTIFIED if grey.effects else Outcome.NONE))
    flash = next((effect for effect in grey.effects if effect.name == CHARGING_JUMP.name), None)
    jump = None if flash is None else next((effect for effect in found.effects if effect.name in _JUMPS and _coincide(effect, flash)), None)
    if flash is None or jump is None:
        return _joined(found, grey)
    found = _flashed(found, jump, flash)
    other_effects = tuple(effect for effect in grey.effects if effect is not flash)
    outcome = Outcome.NONE if not other_effects and grey.outcome is not Outcome.UNKNOWN else grey.outcome
    return _joined(found, replace(grey, effects=other_effects, outcome=outcome))


def _joined(maps: Diagnosis, channel: RowDiagnosis | IntensityDiagnosis, gap: HeldOutMisfit | None = None) -> Diagnosis:
    """Combine two channels. Unexplained misfit or a rejected effect of one channel is not compensated by an effect of the other.

    A rejected effect of the rows does not change the effects identified from the maps.
    """
    merged = replace(maps, where=(*maps.where, *channel.where), evidence=(*maps.evidence, *channel.evidence))
    if channel.outcome is Outcome.NONE or (channel.outcome is Outcome.REJECTED and maps.outcome is not Outcome.NONE):
        return merged
    if channel.outcome is Outcome.UNKNOWN and maps.outcome is not Outcome.REJECTED:
        return replace(merged, outcome=Outcome.UNKNOWN, effects=(*maps.effects, *channel.effects), ambiguous=(), experiment=None)
    merged = replace(merged, effects=(*maps.effects, *channel.effects))
    if maps.outcome is Outcome.NONE or (maps.outcome is Outcome.IDENTIFIED and channel.outcome in _NAMED):
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


def _flashed(found: Diagnosis, jump: IdentifiedEffect, flash: IdentifiedEffect) -> Diagnosis:
    """The verdict with a jump renamed to the effect of the flash; basis field and size remain those of the maps."""
    charge = replace(jump, name=flash.name, parameters=(*jump.parameters, *flash.parameters))
    among = tuple(dict.fromkeys(flash.name if value in _JUMPS else value for value in found.ambiguous))
    merged = replace(
        found, effects=tuple(charge if effect is jump else effect for effect in found.effects), ambiguous=among, group=CHARGING_JUMP.group
    )
    if found.outcome is Outcome.AMBIGUOUS and len(among) == 1:  # the flash has decided
        merged = replace(merged, outcome=Outcome.IDENTIFIED, ambiguous=(), experiment=None)
    return merged


def _coincide(jump: IdentifiedEffect, flash: IdentifiedEffect) -> bool:
    """Whether a flash coincides with the jump within the uncertainty of the maps."""
    parameters = {parameter.name: parameter for parameter in jump.parameters}
    at = parameters.get("at_s")
    if at is None:
        return False
    observed = [parameter for parameter in flash.parameters if parameter.name.endswith("at_s")]
    return any(abs(entry.value - at.value) <= _ALIKE * (entry.sigma**2 + at.sigma**2) ** 0.5 + COINCIDENCE_S for entry in observed)
