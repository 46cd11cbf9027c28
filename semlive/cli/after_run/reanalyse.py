"""`semlive reanalyse`: analyse many logs, or the pairs of one long log, on all cores or on a Dask cluster."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from semlive.cli.after_run.replay import EstimationMethod
from semlive.cli.shared.output_path import output_folder
from semlive.cli.shared.progress_bar import progress_bar
from semlive.cli.shared.terminal import cell, echo
from semlive.errors import BadInput, SemliveError
from semlive.report.campaign import LogOutcome, dask_executor, process_pool
from semlive.report.campaign import reanalyse as analyse_all
from semlive.service.config.overrides import parse_changes
from semlive.service.replay.replay import ReplayRequest, Source


def reanalyse(
    logs: Annotated[list[Path], typer.Argument(help="MCAP files or run folders.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for summary.csv, summary.json and combined.h5.")],
    dask: Annotated[
        str | None, typer.Option(help="Address of a Dask cluster, tcp://host:8786; by default the cores of this computer.")
    ] = None,
    method: Annotated[
        EstimationMethod | None, typer.Option(help="Method of estimation; by default that of the configuration in each log.")
    ] = None,
    settings: Annotated[list[str] | None, typer.Option("--set", help="key=value, as in dic.subset=31; may be repeated.")] = None,
    from_images: Annotated[
        bool, typer.Option("--from-images", help="Correlate the images again; the default for logs with images.")
    ] = False,
    from_disparity: Annotated[bool, typer.Option("--from-disparity", help="Start from the disparity maps in the logs.")] = False,
    jobs: Annotated[int | None, typer.Option(help="Number of processes on this computer; by default one for each core.", min=1)] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Analyse several logs again; the failure of one log does not stop the others."""
    if from_images and from_disparity:
        raise BadInput("--from-images and --from-disparity: give only one of them.")
    output_folder(out, "--out")
    source = Source.IMAGES if from_images else Source.DISPARITY if from_disparity else None
    changes = parse_changes(settings or [])
    requests = [ReplayRequest(log.absolute(), method.value if method else None, changes, source) for log in logs]
    workers = partial(process_pool, jobs) if dask is None else partial(dask_executor, dask)
    with progress_bar("reanalysing", "job") as progress:
        outcomes = analyse_all(requests, out.absolute(), workers, progress)
    failed = sum(outcome.error is not None for outcome in outcomes)
    if as_json:
        typer.echo(json.dumps({"logs": [outcome.row() for outcome in outcomes], "failed": failed, "combined": str(out / "combined.h5")}))
    else:
        Console().print(_table(outcomes))
        for outcome in outcomes:
            if outcome.error is not None:
                echo(f"{outcome.name}: {outcome.error}")
        echo(f"{out / 'combined.h5'}: {len(outcomes) - failed} of {len(outcomes)} logs")
    if failed:
        log, error = next((str(outcome.log), outcome.error) for outcome in outcomes if outcome.error is not None)
        message = error if error.startswith(log) else f"{log}: {error}"  # most errors begin with the log
        raise SemliveError(f"{failed} of {len(outcomes)} logs failed, the first {message}")


def _table(outcomes: tuple[LogOutcome, ...]) -> Table:
    table = Table(title="reanalysed", box=SIMPLE_HEAD, padding=(0, 1))
    for name in ("log", "pairs", "E, GPa", "Poisson's ratio", "noise, px", "s"):
        table.add_column(name, justify="left" if name == "log" else "right")
    for outcome in outcomes:
        row = outcome.row()
        if outcome.error is not None:
            table.add_row(cell(outcome.name), "", "failed", style="bold red")
            continue
        constants = ("-" if row[name] is None else f"{row[name]:.4g} ± {row[name + '_sigma']:.2g}" for name in ("e_gpa", "poisson"))
        table.add_row(cell(outcome.name), str(row["pairs"]), *constants, f"{row['noise_floor_px']:.3g}", f"{outcome.wall_s:.1f}")
    return table
