"""Configuration of a proposed experiment for the daemon."""

from __future__ import annotations

from typing import Any

import yaml

from semlive.data.diagnosis.verdict import ExperimentForecast
from semlive.diagnose.experiments.proposals import ExperimentKind, Proposal
from semlive.diagnose.experiments.protocols import protocol_for, within_travel
from semlive.errors import BadConfig
from semlive.service.config.configuration import parse_config
from semlive.service.log.opened_log import OpenedLog

_BY_HAND = {
    ExperimentKind.CHANGED_SCAN_TIMES: "Set the scan to {dwell} its dwell and row time before starting; "
    "`semlive experiment decide` reads both logs.",
    ExperimentKind.CHANGED_PIXEL_SIZE: "Set the magnification to pixels of {pixel_um:.4g} um, and the scan to a quarter of its dwell "
    "and row time, before starting; `semlive experiment decide` reads both logs.",
    ExperimentKind.ROTATED_SCAN: "Run this twice: with the present scan and, under another run.name, with the scan rotated by 90 degrees. "
    "`semlive experiment decide` reads both logs; the log of this proposal can be the first if its moves were as large.",
}


_PIXEL_RATIO = 0.5
"""Pixel size of the proposal, relative to that of the run: with a quarter of the dwell, no two laws of settling are equal."""


def next_config(log: OpenedLog, proposal: Proposal) -> str:
    """Configuration of the log with the protocol of the experiment, as YAML.

    Raises:
        BadConfig: the log was not written by the daemon and contains no configuration.
    """
    given = dict(log.run.config)
    try:
        parse_config(given, str(log.path))
    except BadConfig as error:
        raise BadConfig(f"{log.path}: contains no configuration of a run; propose from a log that the daemon wrote.") from error
    protocol = given.get("protocol")
    given["protocol"] = protocol_for(protocol if isinstance(protocol, dict) else {}, proposal.kind)
    if proposal.kind is ExperimentKind.ROTATED_SCAN:
        given["protocol"] = within_travel(given["protocol"], _travel_px(given))
    pixel_um = None
    if proposal.kind is ExperimentKind.CHANGED_PIXEL_SIZE:
        given, pixel_um = at_pixel_size(given)
    run = given.get("run")
    name = run.get("name") if isinstance(run, dict) else None
    given["run"] = {**(run if isinstance(run, dict) else {}), "name": f"{name or 'run'}-{proposal.kind.value.replace('_', '-')}"}
    parse_config(given, str(log.path))
    between = ", ".join(proposal.candidates) or "no identified effect"
    lines = [f"# {proposal.kind.value.replace('_', ' ')}, about {between}: {proposal.description}"]
    lines += (
        [f"# By hand: {_BY_HAND[proposal.kind].format(dwell=_dwell(proposal.forecast), pixel_um=pixel_um)}"]
        if proposal.kind in _BY_HAND
        else []
    )
    lines += [_expected(proposal.forecast)] if proposal.forecast else []
    return "\n".join(lines) + "\n" + yaml.safe_dump(given, sort_keys=False, allow_unicode=True)


def at_pixel_size(given: dict[str, Any]) -> tuple[dict[str, Any], float]:
    """The configuration at another pixel size, without a model, whose effects belong to one pixel size; and that size, um."""
    sem = dict(given["sem"])
    sem["pixel_size_um"] = pixel_um = _PIXEL_RATIO * float(sem["pixel_size_um"])
    profile = sem.get("profile")
    if isinstance(profile, dict) and profile.get("pixel_size_m") is not None:
        sem["profile"] = {**profile, "pixel_size_m": _PIXEL_RATIO * float(profile["pixel_size_m"])}
    return {**{key: value for key, value in given.items() if key != "model"}, "sem": sem}, pixel_um


def _travel_px(given: dict[str, Any]) -> float:
    """Allowed travel of the stage along each axis, px; infinite without a limit."""
    sem, limits = given.get("sem"), given.get("limits")
    pixel_um = sem.get("pixel_size_um") if isinstance(sem, dict) else None
    travel_um = limits.get("stage_travel_um") if isinstance(limits, dict) else None
    return float("inf") if pixel_um is None or travel_um is None else float(travel_um) / float(pixel_um)


def _dwell(forecast: ExperimentForecast | None) -> str:
    return "half or twice" if forecast is None else {0.5: "half", 2.0: "twice"}.get(forecast.dwell, f"{forecast.dwell:g} times")


def _expected(forecast: ExperimentForecast) -> str:
    odds = f"the odds for {forecast.true} against {forecast.other}, if it is true, by exp({forecast.log_odds:.1f})"
    return f"# Expected to change {odds} in {forecast.minutes:.0f} min of beam time."
