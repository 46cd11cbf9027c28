"""`semlive reanalyse`: a campaign of logs, or one long log's pairs, on all cores or on a Dask cluster."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from semlive.cli.progress_bar import progress_bar
from semlive.cli.replay import EstimationMethod
from semlive.cli.terminal import cell, echo
from semlive.errors import BadInput, SemliveError
from semlive.report.campaign import LogOutcome, dask_executor, process_pool
from semlive.report.campaign import reanalyse as analyse_all
from semlive.service.config.overrides import parse_changes
from semlive.service.replay.replay import ReplayRequest, Source


def reanalyse(
    logs: Annotated[list[Path], typer.Argument(help="MCAP files or run folders.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for summary.csv, summary.json and combined.h5.")],
    dask: Annotated[str | None, typer.Option(help="An existing cluster, tcp://host:8786; by default this machine's cores.")] = None,
    method: Annotated[EstimationMethod | None, typer.Option(help="Method of estimation; by default each log's own.")] = None,
    settings: Annotated[list[str] | None, typer.Option("--set", help="key=value, as in dic.subset=31; may be given again.")] = None,
    from_images: Annotated[
        bool, typer.Option("--from-images", help="Correlate the images again: the default where there are any.")
    ] = False,
    from_disparity: Annotated[bool, typer.Option("--from-disparity", help="Start from the disparity maps in the logs.")] = False,
    jobs: Annotated[int | None, typer.Option(help="Processes on this machine; by default one for each core.", min=1)] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Analyse logs anew; what goes wrong with one does not stop the rest."""
    if from_images and from_disparity:
        raise BadInput("--from-images and --from-disparity: give one of them.")
    source = Source.IMAGES if from_images else Source.DISPARITY if from_disparity else None
    changes = parse_changes(settings or [])
    asked = [ReplayRequest(log.absolute(), method.value if method else None, changes, source) for log in logs]
    workers = partial(process_pool, jobs) if dask is None else partial(dask_executor, dask)
    with progress_bar("reanalysing", "job") as progress:
        done = analyse_all(asked, out.absolute(), workers, progress)
    failed = sum(one.error is not None for one in done)
    if as_json:
        typer.echo(json.dumps({"logs": [one.row() for one in done], "failed": failed, "combined": str(out / "combined.h5")}))
    else:
        Console().print(_table(done))
        for one in done:
            if one.error is not None:
                echo(f"{one.name}: {one.error}")
        echo(f"{out / 'combined.h5'}: {len(done) - failed} of {len(done)} logs")
    if failed:
        log, error = next((str(one.log), one.error) for one in done if one.error is not None)
        said = error if error.startswith(log) else f"{log}: {error}"  # most name it
        raise SemliveError(f"{failed} of {len(done)} logs failed, the first {said}")


def _table(done: tuple[LogOutcome, ...]) -> Table:
    table = Table(title="reanalysed", box=SIMPLE_HEAD, padding=(0, 1))
    for name in ("log", "pairs", "E, GPa", "Poisson's ratio", "noise, px", "s"):
        table.add_column(name, justify="left" if name == "log" else "right")
    for one in done:
        row = one.row()
        if one.error is not None:
            table.add_row(cell(one.name), "", "failed", style="bold red")
            continue
        found = ("-" if row[name] is None else f"{row[name]:.4g} ± {row[name + '_sigma']:.2g}" for name in ("e_gpa", "poisson"))
        table.add_row(cell(one.name), str(row["pairs"]), *found, f"{row['noise_floor_px']:.3g}", f"{one.wall_s:.1f}")
    return table
