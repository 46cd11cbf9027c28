"""`semlive experiment row-start`: the law of the settling at the start of rows, from profiles at several settings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from semlive.data.diagnosis.effects import Outcome
from semlive.diagnose.row_start.laws import RowStartLaw, RowStartVerdict, row_start_law
from semlive.diagnose.row_start.profile import RowStartProfile
from semlive.formats.tables.profile_table import read_profile_table
from semlive.inputs.files import read_regular

_MAX_BYTES = 10**8
_OUTCOMES = {
    Outcome.NONE: "no significant settling",
    Outcome.IDENTIFIED: "one law describes all settings",
    Outcome.AMBIGUOUS: "several laws describe these settings equally well",
    Outcome.UNKNOWN: "amplitudes and lengths follow none of the laws",
}
_UNITS = {RowStartLaw.TIME: ("nm", "s"), RowStartLaw.POSITION: ("nm", "nm"), RowStartLaw.PIXELS: ("px", "px")}


def row_start(
    profiles: Annotated[
        Path,
        typer.Argument(help="Table with the columns pixel_nm, pixel_s, distance_px, shift_px and sigma_px; see docs/how-to/diagnose.md."),
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Find whether the settling at the start of rows follows the time, the position on the specimen or the pixels of the scan."""
    table = read_profile_table(read_regular(profiles, _MAX_BYTES), profiles.name)
    verdict = row_start_law([RowStartProfile(pixel_nm, pixel_s, *points.T) for (pixel_nm, pixel_s), points in table.items()])
    if as_json:
        typer.echo(json.dumps(row_start_json(verdict)))
        return
    typer.echo(f"{verdict.outcome.value}: {_OUTCOMES[verdict.outcome]}")
    if verdict.laws:
        amplitude, length = _UNITS[verdict.laws[0]]
        for size, constant in zip(verdict.amplitudes, verdict.constants, strict=True):
            typer.echo(f"  {verdict.laws[0]}: {size:.3g} {amplitude} over {constant:.3g} {length}, +- {100 * verdict.scatter:.0f} %")
        for law in verdict.laws[1:]:
            typer.echo(f"  or {law}")
    for experiment in verdict.experiments[:3]:
        setting = experiment.setting
        typer.echo(
            f"  to decide: pixels of {setting.pixel_nm:.3g} nm at {setting.pixel_s:.3g} s, expected log odds {experiment.log_odds:.1f}"
        )


def row_start_json(verdict: RowStartVerdict) -> dict[str, Any]:
    """JSON object of the verdict."""
    units = _UNITS[verdict.laws[0]] if verdict.laws else ("", "")
    return {
        "outcome": verdict.outcome.value,
        "laws": [law.value for law in verdict.laws],
        "evidence": {law.value: value for law, value in verdict.evidence.items()},
        "amplitudes": {"values": list(verdict.amplitudes), "unit": units[0]},
        "constants": {"values": list(verdict.constants), "unit": units[1]},
        "scatter": verdict.scatter,
        "foretold": [
            {
                "pixel_nm": experiment.setting.pixel_nm,
                "pixel_s": experiment.setting.pixel_s,
                "log_odds": experiment.log_odds,
                "true": experiment.hardest.value,
            }
            for experiment in verdict.experiments
        ],
    }
