"""One verdict from all channels: disparity maps, rows that were registered by themselves, and grey levels."""

from __future__ import annotations

from dataclasses import replace

from semlive.data.diagnosis import Diagnosis, ExperimentProposal, HeldOutMisfit, IdentifiedEffect, IntensityDiagnosis, Outcome, RowDiagnosis
from semlive.model.effects.intensity import CHARGING_JUMP
from semlive.model.effects.stage import non_map_effect

_NAMED = (Outcome.IDENTIFIED, Outcome.AMBIGUOUS)
_BRIGHTER = ("charging_frame_ramp", "charging_local_lens")
"""Effects of maps that grey goes along with."""
_JUMPS = ("drift_jump", "jump_within_pair")
_ALIKE = 3.0  # standard uncertainties of both
COINCIDENCE_S = 10.0  # maps know an instant no better: a subset has 43 rows of 0.1 s


def add_row_verdict(maps: Diagnosis, rows: RowDiagnosis) -> Diagnosis:
    """The maps' verdict with what rows show beside it."""
    return _joined(replace(maps, rows=rows), rows, rows.gap)


def add_intensity_verdict(found: Diagnosis, grey: IntensityDiagnosis) -> Diagnosis:
    """The verdict so far with what grey levels show beside it.

    Grey that no law explains goes along with a charge that the maps named. A jump of the maps that comes with a flash is a charge's.
    """
    found = replace(found, grey=grey)
    if grey.outcome is Outcome.UNKNOWN and {one.name for one in found.effects} & set(_BRIGHTER):
        return _joined(found, replace(grey, outcome=Outcome.IDENTIFIED if grey.effects else Outcome.NONE))
    flash = next((one for one in grey.effects if one.name == CHARGING_JUMP.name), None)
    jump = None if flash is None else next((one for one in found.effects if one.name in _JUMPS and _coincide(one, flash)), None)
    if flash is None or jump is None:
        return _joined(found, grey)
    found = _flashed(found, jump, flash)
    others = tuple(one for one in grey.effects if one is not flash)
    outcome = Outcome.NONE if not others and grey.outcome is not Outcome.UNKNOWN else grey.outcome
    return _joined(found, replace(grey, effects=others, outcome=outcome))


def _joined(maps: Diagnosis, channel: RowDiagnosis | IntensityDiagnosis, gap: HeldOutMisfit | None = None) -> Diagnosis:
    """What one channel cannot explain, or had rejected, is not made good by a name that the other has.

    A rejected effect of rows does not touch what maps identified.
    """
    beside = replace(maps, where=(*maps.where, *channel.where), evidence=(*maps.evidence, *channel.evidence))
    if channel.outcome is Outcome.NONE or (channel.outcome is Outcome.REJECTED and maps.outcome is not Outcome.NONE):
        return beside
    if channel.outcome is Outcome.UNKNOWN and maps.outcome is not Outcome.REJECTED:
        return replace(beside, outcome=Outcome.UNKNOWN, effects=(*maps.effects, *channel.effects), ambiguous=(), experiment=None)
    beside = replace(beside, effects=(*maps.effects, *channel.effects))
    if maps.outcome is Outcome.NONE or (maps.outcome is Outcome.IDENTIFIED and channel.outcome in _NAMED):
        outcome = channel.outcome
    else:
        outcome = maps.outcome
    beside = replace(beside, outcome=outcome, gap=maps.gap or gap)
    first = non_map_effect(channel.effects[0].name) if channel.effects else None
    if first is not None and maps.group is None:
        beside = replace(beside, group=first.group)
    if outcome is Outcome.AMBIGUOUS and maps.outcome is not Outcome.AMBIGUOUS and first is not None:
        beside = replace(
            beside, ambiguous=channel.ambiguous, experiment=ExperimentProposal(channel.ambiguous, first.discriminating_experiment)
        )
    return beside


def _flashed(found: Diagnosis, jump: IdentifiedEffect, flash: IdentifiedEffect) -> Diagnosis:
    """The verdict with a jump called by the name of what flashes; its law and its size stay those of the maps."""
    charge = replace(jump, name=flash.name, parameters=(*jump.parameters, *flash.parameters))
    among = tuple(dict.fromkeys(flash.name if one in _JUMPS else one for one in found.ambiguous))
    told = replace(
        found, effects=tuple(charge if one is jump else one for one in found.effects), ambiguous=among, group=CHARGING_JUMP.group
    )
    if found.outcome is Outcome.AMBIGUOUS and len(among) == 1:  # the flash has decided
        told = replace(told, outcome=Outcome.IDENTIFIED, ambiguous=(), experiment=None)
    return told


def _coincide(jump: IdentifiedEffect, flash: IdentifiedEffect) -> bool:
    """Whether one of the flashes comes when the picture jumps, as far as the maps tell when."""
    told = {one.name: one for one in jump.parameters}
    at = told.get("at_s")
    if at is None:
        return False
    seen = [one for one in flash.parameters if one.name.endswith("at_s")]
    return any(abs(one.value - at.value) <= _ALIKE * (one.sigma**2 + at.sigma**2) ** 0.5 + COINCIDENCE_S for one in seen)
