"""`semlive score`: compare a simulated run with its truth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from semlive.cli.shared.output_path import output_file, output_folder
from semlive.cli.shared.progress_bar import multi_stage_progress
from semlive.cli.shared.tables import score_table
from semlive.report.scoring.errors import compare_with_truth
from semlive.report.scoring.figures import SHEET_SUFFIXES, save_figures
from semlive.report.scoring.score import load_truth
from semlive.report.scoring.score import score as scored
from semlive.report.scoring.truth import Truth
from semlive.service.replay.replay import ReplayCallbacks, result_from_maps


def score(
    log: Annotated[Path, typer.Argument(help="One MCAP file, or a run folder of segments.")],
    truth: Annotated[Path, typer.Option("--truth", help="File truth.json that the simulator wrote.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    everything: Annotated[bool, typer.Option("--all", help="Show every frame and pair in the table, as in the JSON.")] = False,
    figures: Annotated[
        Path | None, typer.Option("--figures", help="Folder for one PNG per figure, or a .png, .svg or .pdf file for all on one sheet.")
    ] = None,
) -> None:
    """Compare every recovered quantity with its true value, and check whether the stated uncertainties hold."""
    if figures is not None:
        (output_file if figures.suffix.lower() in SHEET_SUFFIXES else output_folder)(figures, "--figures")
    with multi_stage_progress() as progress:
        result, _ = result_from_maps(log, ReplayCallbacks(progress))
    true_values = load_truth(truth)
    scores = scored(result, true_values)
    written = () if figures is None else save_figures(compare_with_truth(result, Truth.of(true_values)), figures)
    if as_json:
        typer.echo(json.dumps({quantity.name: quantity.to_json() for quantity in scores}))
        return
    Console().print(score_table(scores, everything=everything))
    for path in written:
        typer.echo(f"figure: {path}")
