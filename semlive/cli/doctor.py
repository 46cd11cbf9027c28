"""`semlive doctor`: is everything in place?"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from semlive.cli.progress_bar import compile_with_progress
from semlive.cli.terminal import cell
from semlive.data.checks import Finding, Verdict
from semlive.data.settings import DicSettings
from semlive.errors import SemliveError
from semlive.service.checks import run_checks
from semlive.service.config.configuration import load_config

_COLOURS = {Verdict.OK: "green", Verdict.UNKNOWN: "yellow", Verdict.FAILED: "red"}


def doctor(
    config: Annotated[Path | None, typer.Argument(help="Configuration of a run; without it the computer alone is looked at.")] = None,
    warm: Annotated[bool, typer.Option("--warm", help="Compile the kernels now, so that the first run need not.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Look whether everything a run needs is in place, and say how to mend what is not; nothing is moved."""
    checked = None if config is None else load_config(config)
    if warm:
        compile_with_progress(DicSettings() if checked is None else checked.dic)
    findings = tuple(run_checks(checked))
    bad = [one for one in findings if one.verdict is Verdict.FAILED]
    if as_json:
        typer.echo(json.dumps({"sound": not bad, "findings": [finding.to_json() for finding in findings]}))
    else:
        Console().print(_table(findings))
    if bad:
        raise SemliveError(f"{len(bad)} of {len(findings)} findings are bad; {bad[0].what}: {bad[0].observation}; {bad[0].advice}")


def _table(findings: tuple[Finding, ...]) -> Table:
    table = Table(box=SIMPLE_HEAD, padding=(0, 1))
    table.add_column("what", no_wrap=True)
    table.add_column("is", no_wrap=True)
    table.add_column("says", overflow="fold")
    table.add_column("do", overflow="fold")
    for one in findings:
        colour = _COLOURS[one.verdict]
        table.add_row(cell(one.what), f"[{colour}]{one.verdict}[/{colour}]", cell(one.observation), cell(one.advice))
    return table
