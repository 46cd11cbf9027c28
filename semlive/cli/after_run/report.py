"""`semlive report`: write a run in the form of a paper, as one self-contained page, as PDF, and its figures as files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from semlive.cli.shared.output_path import output_file, write_text
from semlive.cli.shared.progress_bar import multi_stage_progress, progress_bar
from semlive.cli.shared.report_files import write_report_files
from semlive.cli.shared.report_options import figures_option, pdf_option
from semlive.errors import BadInput
from semlive.report.document.html_writer import html_page
from semlive.report.run_data import run_data
from semlive.report.run_report import report_without_results, run_report
from semlive.service.log.files import log_name, sibling_path
from semlive.service.log.run_facts import log_facts
from semlive.service.replay.replay import ReplayCallbacks, ReplayRequest, Source, replay


def report(
    log: Annotated[Path, typer.Argument(help="One MCAP file, or a run folder of segments.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Page to write; by default in the folder of the log and named after it: my-run-report.html."),
    ] = None,
    pdf: Annotated[Path | None, typer.Option("--pdf", help="Write the report as PDF too; needs the extra pdf of semlive.")] = None,
    pictures: Annotated[
        Path | None,
        typer.Option("--figures", help="Folder for every figure as PNG, SVG and PDF in the width of a journal page, and for the captions."),
    ] = None,
    maps: Annotated[
        str, typer.Option("--maps", help="Frames whose maps are drawn, up to four: 11,15,17. By default load steps spread over the run.")
    ] = "",
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Write a run in the form of a paper: instrument, protocol, calibration, results, uncertainty budget, limits, settings, files."""
    page = output_file(out or sibling_path(log, "-report.html"), "--out")
    pdf, pictures = pdf_option(pdf), figures_option(pictures)
    frames = _numbers(maps)
    try:
        with multi_stage_progress() as progress:
            # Frames are passed on one by one, so that memory does not grow with their number.
            done = replay(ReplayRequest(log, source=Source.DISPARITY), ReplayCallbacks(progress, frame=lambda _: None))
    except BadInput as error:
        # A run that ended with an alarm before its first pair has no results; its page shows the alarms.
        write_text(page, html_page(report_without_results(log_name(log), str(error), log_facts(log))))
        raise BadInput(f"{str(error).rstrip('.')}; its alarms and rejected frames are in {page}") from error
    document = run_report(run_data(log, done, frames))
    with progress_bar("drawing", "figure") as drawing:
        write_text(page, html_page(document, drawing))
    written = write_report_files(document, pdf, pictures)
    if as_json:
        typer.echo(json.dumps({"page": str(page), **written}))
        return
    for path in (page, *([pdf] if pdf else [])):
        typer.echo(str(path))
    if pictures is not None:
        typer.echo(f"{len(written['figures'])} files of figures in {pictures}")


def _numbers(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(part) for part in text.split(",")) if text else ()
    except ValueError:
        raise BadInput(f"--maps {text}: give numbers of frames with commas between them, for example 11,15,17") from None
