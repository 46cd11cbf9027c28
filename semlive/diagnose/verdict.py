"""One verdict from both channels: disparity maps, and rows that were registered by themselves."""

from __future__ import annotations

from dataclasses import replace

from semlive.data.diagnosis import Diagnosis, Experiment, Outcome, RowChannel
from semlive.model.row_effects import of_rows

_NAMED = (Outcome.IDENTIFIED, Outcome.AMBIGUOUS)


def with_rows(maps: Diagnosis, rows: RowChannel) -> Diagnosis:
    """The maps' verdict with what rows show beside it.

    What one channel cannot explain, or had rejected, is not made good by a name that the other has; a rejected effect of rows does
    not touch what maps identified.
    """
    beside = replace(maps, rows=rows, where=(*maps.where, *rows.where), evidence=(*maps.evidence, *rows.evidence))
    if rows.outcome is Outcome.NONE or (rows.outcome is Outcome.REJECTED and maps.outcome is not Outcome.NONE):
        return beside
    if rows.outcome is Outcome.UNKNOWN and maps.outcome is not Outcome.REJECTED:
        return replace(beside, outcome=Outcome.UNKNOWN, effects=(*maps.effects, *rows.effects), ambiguous=(), experiment=None)
    beside = replace(beside, effects=(*maps.effects, *rows.effects))
    if maps.outcome is Outcome.NONE or (maps.outcome is Outcome.IDENTIFIED and rows.outcome in _NAMED):
        outcome = rows.outcome
    else:
        outcome = maps.outcome
    beside = replace(beside, outcome=outcome, gap=maps.gap or rows.gap)
    first = of_rows(rows.effects[0].name) if rows.effects else None
    if first is not None and maps.group is None:
        beside = replace(beside, group=first.group)
    if outcome is Outcome.AMBIGUOUS and maps.outcome is not Outcome.AMBIGUOUS and first is not None:
        beside = replace(beside, ambiguous=rows.ambiguous, experiment=Experiment(rows.ambiguous, first.decides))
    return beside
