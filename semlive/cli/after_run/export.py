"""`semlive export`: fields and series of a log in the formats of other programs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from semlive.cli.after_run.replay import EstimationMethod
from semlive.cli.shared.output_path import output_folder, regular_output_file
from semlive.cli.shared.progress_bar import multi_stage_progress
from semlive.cli.shared.terminal import echo
from semlive.errors import BadInput
from semlive.report.export import DESCRIBED, ONE_FILE, Deposit, Format, export_log, read_deposit
from semlive.service.config.overrides import parse_changes
from semlive.service.replay.replay import ReplayRequest, Source


def export(
    log: Annotated[Path, typer.Argument(help="One MCAP file, or a run folder of segments.")],
    kind: Annotated[Format, typer.Option("--format", help="Format: hdf5, mat and nexus write one file, the others a folder.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="File or folder to write.")],
    method: Annotated[
        EstimationMethod | None, typer.Option(help="Method of estimation; by default that of the configuration in the log.")
    ] = None,
    settings: Annotated[list[str] | None, typer.Option("--set", help="key=value, as in estimate.window=15; may be repeated.")] = None,
    from_images: Annotated[bool, typer.Option("--from-images", help="Correlate the images again.")] = False,
    until: Annotated[int | None, typer.Option(help="Number of the last pair to use.", min=0)] = None,
    describe: Annotated[
        Path | None, typer.Option(help="YAML file with title, licence, persons, instrument and sample, for nexus and ro-crate.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Write corrected displacement and strain of every frame, drift, distortion, series and configuration."""
    changes = parse_changes(settings or [])
    if describe is not None and kind not in DESCRIBED:
        raise BadInput(f"--describe: {kind.value} contains no description; it is for --format {' and '.join(sorted(DESCRIBED))}")
    deposit = Deposit() if describe is None else read_deposit(describe)
    missing, invalid_without = (deposit.missing, deposit.invalid_without) if kind in DESCRIBED else ((), ())
    (regular_output_file if kind in ONE_FILE else output_folder)(out, "--out")
    images = from_images or any(change.of_images for change in changes)
    source = Source.IMAGES if images else Source.DISPARITY
    with multi_stage_progress() as progress:
        request = ReplayRequest(log, method.value if method else None, changes, source, until)
        replayed = export_log(request, kind, out, progress, deposit=deposit)
    frames = [summary.frame for summary in replayed.result.summaries]
    if invalid_without:
        echo(f"warning: the NeXus file is not valid NXem without {', '.join(invalid_without)}; add it to a file for --describe", err=True)
    if as_json:
        described = {"missing": list(missing), "invalid_without": list(invalid_without)} if kind in DESCRIBED else {}
        typer.echo(json.dumps({"out": str(out), "format": kind.value, "frames": frames, **described}))
    else:
        typer.echo(f"{out}: {len(frames)} frames")
        if missing:
            typer.echo(f"not described: {', '.join(missing)}; give a YAML file with them by --describe")
