"""Qualifying runs that `semlive qualify --run` takes itself: the first one, and the further steps that it needs."""

from __future__ import annotations

import sys
from pathlib import Path

from semlive.cli.shared.daemon_process import run_daemon
from semlive.cli.shared.output_path import write_text
from semlive.cli.shared.terminal import echo
from semlive.errors import SemliveError
from semlive.inputs.yaml_text import read_yaml
from semlive.qualify.further import StepName, proposals
from semlive.qualify.values import Qualification
from semlive.service.config.configuration import checked_text
from semlive.service.qualification.plan import plan_of


def take_pairs(instrument: Path, step: StepName | None) -> Path:
    """Write a qualifying run next to its log and take its pairs; returns its log.

    Args:
        instrument: configuration of the instrument, or the log of its first run.
        step: a further step; None for the first run.

    Raises:
        BadConfig: the configuration is invalid.
        SemliveError: the run ended before its pairs were taken.
    """
    plan = plan_of(instrument, step)
    config = checked_text(read_yaml(plan.text.encode(), str(instrument)), str(instrument))
    log = (config.run.folder / config.run.name).absolute()
    log.parent.mkdir(parents=True, exist_ok=True)
    path = log.with_name(f"{log.name}.yaml")
    write_text(path, plan.text)
    echo(f"{path}: {plan.duration_text()}", err=True)
    # Without a terminal nobody is there to answer a fault.
    options = () if sys.stdin.isatty() else ("--stop-on-fault", "--no-page")
    code = run_daemon(path, "--until-qualified", *options)
    if code:
        raise SemliveError(
            f"the run ended before its last pair (exit code {code}); semlive run {path} --resume --until-qualified continues it, "
            f"and semlive qualify --from {log} evaluates its pairs"
        )
    return log


def further_log(found: Qualification, first: Path) -> Path | None:
    """Log of the next further step, which is taken after a person has set the scan for it.

    Args:
        found: qualification so far.
        first: log of the first run.

    Returns:
        None if no step is needed, nobody sets the scan, or the run failed, which is shown: the qualification so far is not lost.
    """
    steps = proposals(found)
    if not steps or not sys.stdin.isatty():
        return None
    proposal = steps[0]
    echo(f"next step: {proposal.reason}", err=True)
    echo(f"{proposal.step.change}, then press Enter; or type end: ", err=True)
    answer = sys.stdin.readline()
    if not answer or answer.strip():
        return None
    try:
        return take_pairs(first, proposal.step.name)
    except SemliveError as error:
        echo(str(error), err=True)
        return None
