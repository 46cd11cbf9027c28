"""`semlive score`: a simulated run against its truth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from semlive.cli.progress_bar import multi_stage_progress
from semlive.cli.tables import score_table
from semlive.report.scoring.errors import compare_with_truth
from semlive.report.scoring.figures import save_figures
from semlive.report.scoring.score import load_truth
from semlive.report.scoring.score import score as scored
from semlive.report.scoring.truth import Truth
from semlive.service.replay.replay import ReplayCallbacks, result_from_maps


def score(
    log: Annotated[Path, typer.Argument(help="One MCAP file, or a run folder of segments.")],
    truth: Annotated[Path, typer.Option("--truth", help="The truth.json that the simulator wrote.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    everything: Annotated[bool, typer.Option("--all", help="Every frame and pair in the table, as in the JSON.")] = False,
    figures: Annotated[
        Path | None, typer.Option("--figures", help="A folder for one PNG each, or a .png, .svg or .pdf file for one sheet.")
    ] = None,
) -> None:
    """Every recovered quantity against truth, with its uncertainty, and whether the stated uncertainties hold."""
    with multi_stage_progress() as progress:
        result, _ = result_from_maps(log, ReplayCallbacks(progress))
    told = load_truth(truth)
    scores = scored(result, told)
    written = () if figures is None else save_figures(compare_with_truth(result, Truth.of(told)), figures)
    if as_json:
        typer.echo(json.dumps({one.name: one.to_json() for one in scores}))
        return
    Console().print(score_table(scores, everything=everything))
    for path in written:
        typer.echo(f"figure: {path}")
