"""`semlive doctor`: check the computer and, with a configuration, the devices and folders of a run."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from semlive.cli.before_run.recommendation_text import recommendation_json, recommendation_rows
from semlive.cli.shared.progress_bar import compile_with_progress
from semlive.cli.shared.terminal import cell
from semlive.data.checks import Finding, Verdict
from semlive.data.settings import DicSettings
from semlive.errors import BadConfig, SemliveError
from semlive.service.alerts.targets import read_targets, send
from semlive.service.checks import run_checks
from semlive.service.config.configuration import Config, load_config
from semlive.service.planning.recommendation import Recommendation, recommendation_for_file

_COLOURS = {Verdict.OK: "green", Verdict.UNKNOWN: "yellow", Verdict.FAILED: "red"}


def doctor(
    config: Annotated[Path | None, typer.Argument(help="Configuration of a run; without it only the computer is checked.")] = None,
    test_frame: Annotated[
        Path | None, typer.Option("--test-frame", help="One frame of the specimen, for which method, subset and step are recommended.")
    ] = None,
    warm: Annotated[bool, typer.Option("--warm", help="Compile the kernels now instead of at the first run.")] = False,
    send_alert: Annotated[bool, typer.Option("--send-alert", help="Send a test alert to every address of the section alerts.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Check whether everything that a run needs is in place, and show how to correct what is not; nothing moves."""
    checked = None if config is None else load_config(config)
    if warm:
        compile_with_progress(DicSettings() if checked is None else checked.dic)
    recommended = None if test_frame is None else recommendation_for_file(test_frame, checked)
    findings = (*run_checks(checked), *(() if recommended is None else (pattern_finding(recommended),)))
    if send_alert:
        findings = (*findings, *sent_alerts(checked))
    failed = [finding for finding in findings if finding.verdict is Verdict.FAILED]
    if as_json:
        found = {"sound": not failed, "findings": [finding.to_json() for finding in findings]}
        typer.echo(json.dumps({**found, **({} if recommended is None else {"recommended": recommendation_json(recommended)})}))
    else:
        Console().print(_table(findings))
    if failed:
        raise SemliveError(f"{len(failed)} of {len(findings)} checks failed; {failed[0].what}: {failed[0].observation}; {failed[0].advice}")


def sent_alerts(config: Config | None) -> Iterator[Finding]:
    """Send a test alert to every address.

    Raises:
        BadConfig: there is no section alerts, or its file is not valid.
    """
    if config is None or config.alerts is None:
        raise BadConfig("--send-alert: needs a configuration with a section alerts; add it, with file: FILE")
    for target in read_targets(config.alerts.file):
        if send(target, f"{config.run.name}: test", "This is a test alert of semlive."):
            yield Finding("test alert", f"{target.label} accepted it", Verdict.OK)
        else:
            yield Finding(
                "test alert", f"{target.label} did not accept it", Verdict.FAILED, "check the address, its password and the network"
            )


def pattern_finding(recommended: Recommendation) -> Finding:
    """The recommendation as a finding; open where subsets are not sufficient."""
    observation = "; ".join(text for _, text in recommendation_rows(recommended))
    if recommended.choice.method == "subset":
        return Finding("pattern", observation, Verdict.OK)
    return Finding("pattern", observation, Verdict.UNKNOWN, "use the global method, or improve the pattern, the contrast or the scan")


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
