"""The deciding experiment as a configuration that the daemon runs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

from semlive.diagnose.propose import Kind, Proposal
from semlive.errors import BadConfig
from semlive.service.config import parse_config
from semlive.service.log_pairs import first_run

PARKED_PAIRS = 10
Protocol = dict[str, Any]

_BY_HAND = {
    Kind.OTHER_SCAN: "Set the scan to half or twice its dwell and row time before starting; state it where the files do not. "
    "`semlive experiment decide` reads both logs.",
    Kind.TURNED_SCAN: "Turn the scan by 90 degrees before starting.",
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
    given["protocol"] = changed_protocol(protocol if isinstance(protocol, dict) else {}, proposal.kind)
    run = given.get("run")
    name = run.get("name") if isinstance(run, dict) else None
    given["run"] = {**(run if isinstance(run, dict) else {}), "name": f"{name or 'run'}-{proposal.kind.value.replace('_', '-')}"}
    parse_config(given, str(log))
    between = ", ".join(proposal.between) or "nothing that has a name"
    said = [f"# {proposal.kind.value.replace('_', ' ')}, about {between}: {proposal.about}"]
    said += [f"# By hand: {_BY_HAND[proposal.kind]}"] if proposal.kind in _BY_HAND else []
    return "\n".join(said) + "\n" + yaml.safe_dump(given, sort_keys=False, allow_unicode=True)


def changed_protocol(protocol: Protocol, kind: Kind) -> Protocol:
    """A protocol with an experiment in place of its own."""
    return {**protocol, **_CHANGES[kind](protocol)}


def _unloaded(shifts: list[Any]) -> Protocol:
    return {"calibration_shifts_px": shifts, "translation_shifts_px": [], "loads_n": [], "warm_up": None}


def _there_and_back(protocol: Protocol) -> Protocol:
    shifts = protocol.get("calibration_shifts_px") or []
    return _unloaded([one for shift in shifts for one in (shift, [0.0, 0.0])])


_CHANGES: dict[Kind, Callable[[Protocol], Protocol]] = {
    Kind.PARKED: lambda protocol: _unloaded([[0.0, 0.0]] * PARKED_PAIRS),
    Kind.AGAIN: lambda protocol: _unloaded(protocol.get("calibration_shifts_px") or []),
    Kind.LONGER_HOLD: lambda protocol: {"hold_s": 4.0 * float(protocol.get("hold_s", 30.0)), "adaptive_hold": None},
    Kind.DUMMY_STEPS: lambda protocol: {"loads_n": [load for load in protocol.get("loads_n") or [] for _ in range(2)]},
    Kind.UNLOAD: lambda protocol: {"loads_n": [*(protocol.get("loads_n") or []), *reversed((protocol.get("loads_n") or [])[:-1])]},
    Kind.REVERSED: _there_and_back,
    Kind.OTHER_SCAN: lambda protocol: _unloaded(protocol.get("calibration_shifts_px") or []),
    Kind.TURNED_SCAN: lambda protocol: _unloaded(protocol.get("calibration_shifts_px") or []),
}
