"""`semlive export`: a log's fields and series in the formats of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from semlive.cli.progress_bar import multi_stage_progress
from semlive.cli.replay import EstimationMethod
from semlive.report.export import Format, export_log
from semlive.service.config.overrides import parse_changes
from semlive.service.replay.replay import ReplayRequest, Source


def export(
    log: Annotated[Path, typer.Argument(help="One MCAP file, or a run folder of segments.")],
    kind: Annotated[Format, typer.Option("--format", help="hdf5 and mat are one file; csv, vtk and png a folder.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="The file, or the folder.")],
    method: Annotated[EstimationMethod | None, typer.Option(help="Method of estimation; by default the log's own.")] = None,
    settings: Annotated[list[str] | None, typer.Option("--set", help="key=value, as in estimate.window=15; may be given again.")] = None,
    from_images: Annotated[bool, typer.Option("--from-images", help="Correlate the images again.")] = False,
    until: Annotated[int | None, typer.Option(help="Number of the last pair to take.", min=0)] = None,
) -> None:
    """Write corrected displacement and strain of every frame, drift, distortion, series and configuration."""
    changes = parse_changes(settings or [])
    images = from_images or any(change.of_images for change in changes)
    source = Source.IMAGES if images else Source.DISPARITY
    with multi_stage_progress() as progress:
        done = export_log(ReplayRequest(log, method.value if method else None, changes, source, until), kind, out, progress)
    typer.echo(f"{out}: {len(done.result.summaries)} frames")
