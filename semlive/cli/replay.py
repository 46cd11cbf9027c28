"""`semlive replay`: the analysis again, from the log's raw images."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from semlive.cli.tables import result_table
from semlive.service.replay import replay_images
from semlive.service.result_json import differences, result_json


class EstimationMethod(StrEnum):
    """Methods of estimation."""

    JOINT = "joint"
    SUTTON2007 = "sutton2007"


def replay(
    log: Annotated[Path, typer.Argument(help="One MCAP file, or a run folder of segments.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    method: Annotated[
        EstimationMethod | None, typer.Option(help="Method of estimation; by default the one that the run's configuration names.")
    ] = None,
) -> None:
    """Recompute the analysis from the log's raw images and print the result."""
    replayed = replay_images(log, method.value if method else None)
    result = result_json(replayed.result, replayed.settings)
    if as_json:
        typer.echo(json.dumps(result))
        return
    console = Console()
    console.print(result_table(replayed.result))
    if method is not None:
        console.print(f"estimated by {method}; without --method the result is compared with the live one")
    elif replayed.recorded is None:
        console.print("the log holds no final result to compare with: the run did not end by itself")
    elif differing := differences(replayed.recorded, result):
        console.print(f"live and replayed results differ in {len(differing)} values, the first {differing[0]}")
    else:
        console.print("live and replayed results are identical")
