"""`semlive report`: one self-contained page of a log."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from semlive.report.page import report_html
from semlive.service.replay import last_result, load_series


def report(
    log: Annotated[Path, typer.Argument(help="One MCAP file, or a run folder of segments.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="The page; report.html beside the log by default.")] = None,
) -> None:
    """Write report.html: load, drift, distortion, strain maps, stress-strain curve."""
    result, settings = last_result(log)
    page = out or log.parent / "report.html"
    page.write_text(report_html(log.stem, result, load_series(log), settings), encoding="utf-8")
    typer.echo(str(page))
