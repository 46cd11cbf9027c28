"""`semlive export`: fields and series of a log in the formats of other programs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from semlive.cli.after_run.replay import EstimationMethod
from semlive.cli.shared.output_path import output_file, output_folder
from semlive.cli.shared.progress_bar import multi_stage_progress
from semlive.report.export import Format, export_log
from semlive.service.config.overrides import parse_changes
from semlive.service.replay.replay import ReplayRequest, Source


def export(
    log: Annotated[Path, typer.Argument(help="One MCAP file, or a run folder of segments.")],
    kind: Annotated[Format, typer.Option("--format", help="Format: hdf5 and mat write one file; csv, vtk and png write a folder.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="File or folder to write.")],
    method: Annotated[
        EstimationMethod | None, typer.Option(help="Method of estimation; by default that of the configuration in the log.")
    ] = None,
    settings: Annotated[list[str] | None, typer.Option("--set", help="key=value, as in estimate.window=15; may be repeated.")] = None,
    from_images: Annotated[bool, typer.Option("--from-images", help="Correlate the images again.")] = False,
    until: Annotated[int | None, typer.Option(help="Number of the last pair to use.", min=0)] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Write corrected displacement and strain of every frame, drift, distortion, series and configuration."""
    changes = parse_changes(settings or [])
    (output_file if kind in (Format.HDF5, Format.MAT) else output_folder)(out, "--out")
    images = from_images or any(change.of_images for change in changes)
    source = Source.IMAGES if images else Source.DISPARITY
    with multi_stage_progress() as progress:
        replayed = export_log(ReplayRequest(log, method.value if method else None, changes, source, until), kind, out, progress)
    frames = [summary.frame for summary in replayed.result.summaries]
    if as_json:
        typer.echo(json.dumps({"out": str(out), "format": kind.value, "frames": frames}))
    else:
        typer.echo(f"{out}: {len(frames)} frames")
