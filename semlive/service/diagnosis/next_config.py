"""The deciding experiment as a configuration that the daemon runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from semlive.data.diagnosis.verdict import ExperimentForecast
from semlive.diagnose.experiments.proposals import ExperimentKind, Proposal
from semlive.diagnose.experiments.protocols import protocol_for, within_travel
from semlive.errors import BadConfig
from semlive.service.config.configuration import parse_config
from semlive.service.log.pairs import first_run

_BY_HAND = {
    ExperimentKind.CHANGED_SCAN_TIMES: "Set the scan to {dwell} its dwell and row time before starting; state it where the files do not. "
    "`semlive experiment decide` reads both logs.",
    ExperimentKind.ROTATED_SCAN: "Run this twice, with the scan as it is and, under another run.name, with the scan turned by 90 degrees. "
    "`semlive experiment decide` reads both logs; the log that this was proposed from can be the first if its moves were as large.",
}


def next_config(log: Path, proposal: Proposal) -> str:
    """The log's own configuration with another protocol, as YAML.

    Raises:
        BadConfig: the log was not made by the daemon, so there is no configuration to change.
    """
    given = dict(first_run(log).config)
    try:
        parse_config(given, str(log))
    except BadConfig as error:
        raise BadConfig(f"{log}: holds no configuration of a run to propose from; propose from a log that the daemon wrote.") from error
    protocol = given.get("protocol")
    given["protocol"] = protocol_for(protocol if isinstance(protocol, dict) else {}, proposal.kind)
    if proposal.kind is ExperimentKind.ROTATED_SCAN:
        given["protocol"] = within_travel(given["protocol"], _travel_px(given))
    run = given.get("run")
    name = run.get("name") if isinstance(run, dict) else None
    given["run"] = {**(run if isinstance(run, dict) else {}), "name": f"{name or 'run'}-{proposal.kind.value.replace('_', '-')}"}
    parse_config(given, str(log))
    between = ", ".join(proposal.candidates) or "nothing that has a name"
    said = [f"# {proposal.kind.value.replace('_', ' ')}, about {between}: {proposal.description}"]
    said += [f"# By hand: {_BY_HAND[proposal.kind].format(dwell=_dwell(proposal.forecast))}"] if proposal.kind in _BY_HAND else []
    said += [_expected(proposal.forecast)] if proposal.forecast else []
    return "\n".join(said) + "\n" + yaml.safe_dump(given, sort_keys=False, allow_unicode=True)


def _travel_px(given: dict[str, Any]) -> float:
    """How far the stage may go along each axis; as far as one likes where nothing says so."""
    sem, limits = given.get("sem"), given.get("limits")
    pixel_um = sem.get("pixel_size_um") if isinstance(sem, dict) else None
    travel_um = limits.get("stage_travel_um") if isinstance(limits, dict) else None
    return float("inf") if pixel_um is None or travel_um is None else float(travel_um) / float(pixel_um)


def _dwell(foretold: ExperimentForecast | None) -> str:
    return "half or twice" if foretold is None else {0.5: "half", 2.0: "twice"}.get(foretold.dwell, f"{foretold.dwell:g} times")


def _expected(one: ExperimentForecast) -> str:
    said = f"the odds for {one.true} against {one.other}, if it is true, by exp({one.log_odds:.1f}) in {one.minutes:.0f} min of beam time"
    return f"# Expected to change {said}."
