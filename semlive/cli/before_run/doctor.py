"""`semlive doctor`: check the computer and, with a configuration, the devices and folders of a run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from semlive.cli.shared.progress_bar import compile_with_progress
from semlive.cli.shared.terminal import cell
from semlive.data.checks import Finding, Verdict
from semlive.data.settings import DicSettings
from semlive.errors import SemliveError
from semlive.service.checks import run_checks
from semlive.service.config.configuration import load_config

_COLOURS = {Verdict.OK: "green", Verdict.UNKNOWN: "yellow", Verdict.FAILED: "red"}


def doctor(
    config: Annotated[Path | None, typer.Argument(help="Configuration of a run; without it only the computer is checked.")] = None,
    warm: Annotated[bool, typer.Option("--warm", help="Compile the kernels now instead of at the first run.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Check whether everything that a run needs is in place, and show how to correct what is not; nothing moves."""
    checked = None if config is None else load_config(config)
    if warm:
        compile_with_progress(DicSettings() if checked is None else checked.dic)
    findings = tuple(run_checks(checked))
    failed = [finding for finding in findings if finding.verdict is Verdict.FAILED]
    if as_json:
        typer.echo(json.dumps({"sound": not failed, "findings": [finding.to_json() for finding in findings]}))
    else:
        Console().print(_table(findings))
    if failed:
        raise SemliveError(f"{len(failed)} of {len(findings)} checks failed; {failed[0].what}: {failed[0].observation}; {failed[0].advice}")


def _table(findings: tuple[Finding, ...]) -> Table:
    table = Table(box=SIMPLE_HEAD, padding=(0, 1))
    table.add_column("check", no_wrap=True)
    table.add_column("status", no_wrap=True)
    table.add_column("result", overflow="fold")
    table.add_column("remedy", overflow="fold")
    for finding in findings:
        colour = _COLOURS[finding.verdict]
        table.add_row(cell(finding.what), f"[{colour}]{finding.verdict}[/{colour}]", cell(finding.observation), cell(finding.advice))
    return table
