"""`semlive score`: a simulated run against its truth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from semlive.cli.tables import score_table
from semlive.report.score import load_truth
from semlive.report.score import score as scored
from semlive.service.replay import last_result


def score(
    log: Annotated[Path, typer.Argument(help="One MCAP file, or a run folder of segments.")],
    truth: Annotated[Path, typer.Option("--truth", help="The truth.json that the simulator wrote.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Every recovered quantity against truth, with its uncertainty."""
    scores = scored(last_result(log)[0], load_truth(truth))
    if as_json:
        typer.echo(json.dumps({one.name: one.to_json() for one in scores}))
    else:
        Console().print(score_table(scores))
