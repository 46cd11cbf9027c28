"""`semlive doctor`: is everything in place?"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from semlive.cli.terminal import cell
from semlive.cli.track import warmed
from semlive.data.frame_check import Finding, Verdict
from semlive.data.settings import DicSettings
from semlive.errors import SemliveError
from semlive.service.checkup import look
from semlive.service.config import load_config

_COLOURS = {Verdict.GOOD: "green", Verdict.OPEN: "yellow", Verdict.BAD: "red"}


def doctor(
    config: Annotated[Path | None, typer.Argument(help="Configuration of a run; without it the computer alone is looked at.")] = None,
    warm: Annotated[bool, typer.Option("--warm", help="Compile the kernels now, so that the first run need not.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Look whether everything a run needs is in place, and say how to mend what is not; nothing is moved."""
    checked = None if config is None else load_config(config)
    if warm:
        warmed(DicSettings() if checked is None else checked.dic)
    findings = tuple(look(checked))
    bad = [one for one in findings if one.verdict is Verdict.BAD]
    if as_json:
        typer.echo(json.dumps({"sound": not bad, "findings": [asdict(one) for one in findings]}))
    else:
        Console().print(_table(findings))
    if bad:
        raise SemliveError(f"{len(bad)} of {len(findings)} findings are bad; {bad[0].what}: {bad[0].said}; {bad[0].advice}")


def _table(findings: tuple[Finding, ...]) -> Table:
    table = Table(box=SIMPLE_HEAD, padding=(0, 1))
    table.add_column("what", no_wrap=True)
    table.add_column("is", no_wrap=True)
    table.add_column("says", overflow="fold")
    table.add_column("do", overflow="fold")
    for one in findings:
        colour = _COLOURS[one.verdict]
        table.add_row(cell(one.what), f"[{colour}]{one.verdict}[/{colour}]", cell(one.said), cell(one.advice))
    return table
