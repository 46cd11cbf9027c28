"""`semlive report`: write one self-contained page about a log."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from semlive.cli.shared.output_path import output_file, output_folder, write_text
from semlive.cli.shared.progress_bar import multi_stage_progress, progress_bar
from semlive.errors import BadInput
from semlive.report.page import report_html, unanalysed_html
from semlive.report.sections import write_figures
from semlive.service.log.files import log_name, sibling_path
from semlive.service.log.run_facts import log_facts
from semlive.service.replay.replay import ReplayCallbacks, load_series, result_from_maps


def report(
    log: Annotated[Path, typer.Argument(help="One MCAP file, or a run folder of segments.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Page to write; by default in the folder of the log and named after it: my-run-report.html."),
    ] = None,
    pictures: Annotated[
        Path | None, typer.Option("--figures", help="Folder for every figure as PNG and PDF, in the width of a journal page.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Write a run as one page: figures as in the paper of the method, uncertainty budget, rejected frames, settings, versions."""
    page = output_file(out or sibling_path(log, "-report.html"), "--out")
    if pictures is not None:
        output_folder(pictures, "--figures")
    try:
        with multi_stage_progress() as progress:
            result, settings = result_from_maps(log, ReplayCallbacks(progress))
    except BadInput as error:
        # A run that ended with an alarm before its first pair has no results; its page shows the alarms.
        write_text(page, unanalysed_html(log_name(log), str(error), log_facts(log)))
        raise BadInput(f"{str(error).rstrip('.')}; its alarms and rejected frames are in {page}") from error
    series = load_series(log)
    with progress_bar("drawing", "figure") as drawing:
        write_text(page, report_html(log_name(log), result, series, settings, log_facts(log), drawing))
    written: list[Path] = []
    if pictures is not None:
        with progress_bar("writing", "figure") as writing:
            written = write_figures(pictures, result, series, settings, writing)
    if as_json:
        typer.echo(json.dumps({"page": str(page), "figures": [str(path) for path in written]}))
        return
    typer.echo(str(page))
    if pictures is not None:
        typer.echo(f"{len(written)} figures in {pictures}")
