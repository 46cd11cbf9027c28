"""`semlive frame`: looks at load frames before they are used."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from semlive.cli.terminal import cell
from semlive.data.checks import FrameCheck, Verdict
from semlive.errors import BadConfig, SemliveError
from semlive.ports import FrameChecker
from semlive.service.config.configuration import Config, load_config
from semlive.service.runtime.clock import open_clock

frame = typer.Typer(help="Look at a load frame, without moving it.", no_args_is_help=True)
_COLOURS = {Verdict.OK: "green", Verdict.UNKNOWN: "yellow", Verdict.FAILED: "red"}


@frame.callback()
def _frame() -> None:
    """Look at a load frame, without moving it."""


@frame.command("check")
def check(
    description: Annotated[
        str, typer.Argument(metavar="MAP", help="Device description: a name (a wrong one lists them), or a .yaml path.")
    ],
    host: Annotated[str, typer.Option(help="Address of a device on the network.")] = "127.0.0.1",
    port: Annotated[str, typer.Option(help="TCP port, or the path of a serial line (/dev/ttyUSB0, COM3).")] = "502",
    unit: Annotated[int, typer.Option(min=0, max=255, help="Modbus unit.")] = 1,
    baud: Annotated[int | None, typer.Option(help="Of a serial line; otherwise as the description says.")] = None,
    parity: Annotated[str | None, typer.Option(help="none, even or odd; otherwise as the description says.")] = None,
    timeout_s: Annotated[float, typer.Option(help="Longest wait for an answer.")] = 0.5,
    loads_n: Annotated[
        list[float] | None, typer.Option("--load", help="A load of the run, N; may be given several times. Needs --rate.")
    ] = None,
    rate_n_s: Annotated[
        float | None, typer.Option("--rate", min=0.0, help="Rate of its ramps, N/s: can the device hold these orders as meant?")
    ] = None,
    config: Annotated[
        Path | None, typer.Option("--config", help="Configuration of a run: its loads, its rate and what its load frame's settings change.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Read who answers, whether its values are plausible and in which order its words come; nothing is written or moved."""
    settings: dict[str, object] = {"unit": unit, "timeout_s": timeout_s}
    if port.isdigit():
        settings |= {"host": host, "port": int(port)}
    else:
        line = {"port": port, "baud": baud, "parity": parity}
        settings["serial"] = {key: value for key, value in line.items() if value is not None}
    if config is not None:
        settings |= _of_config(load_config(config), settings)
    orders = dict(_mapping(settings.get("orders")))
    orders |= {key: value for key, value in (("loads_n", loads_n), ("rate_n_s", rate_n_s)) if value is not None}
    if orders.get("loads_n") and orders.get("rate_n_s") is None:
        raise BadConfig("--load needs --rate: a load alone is no order; give the rate of the ramps, N/s")
    settings["orders"] = orders
    found = _checker()(description, settings, open_clock(None))
    if as_json:
        sys.stdout.write(
            json.dumps({**asdict(found), "findings": [finding.to_json() for finding in found.findings], "sound": found.passed}) + "\n"
        )
    else:
        _show(found)
    if not found.passed:
        bad = [finding for finding in found.findings if finding.verdict is Verdict.FAILED]
        raise SemliveError(
            f"{found.device} at {found.where}: {len(bad)} of {len(found.findings)} findings are bad; {bad[0].what}: {bad[0].advice}"
        )


def _of_config(config: Config, given: dict[str, object]) -> dict[str, object]:
    """What the configuration says of the device, as far as it was not given, and the orders of the run."""
    own = {} if config.load_frame is None else dict(config.load_frame.settings)
    orders: dict[str, object] = {"loads_n": list(config.protocol.loads_n), "rate_n_s": config.protocol.ramp_rate_n_s}
    if "approach" in own:
        orders["approach"] = own["approach"]
    kept = {key: own[key] for key in ("registers", "units", "station") if key in own and key not in given}
    return {**kept, "orders": orders}


def _mapping(value: object) -> Mapping[str, object]:
    return value if isinstance(value, Mapping) else {}


def _checker() -> FrameChecker:
    points = list(entry_points(group="semlive.frame_checks"))
    if not points:
        raise BadConfig("no driver can look at devices; install semlive with its drivers (python -m pip install semlive)")
    return points[0].load()


def _show(found: FrameCheck) -> None:
    table = Table(title=cell(f"{found.device} at {found.where}"), title_justify="left", caption=cell(found.source), caption_justify="left")
    for column in ("what", "says", "is", "do"):
        table.add_column(column)
    for finding in found.findings:
        colour = _COLOURS[finding.verdict]
        table.add_row(cell(finding.what), cell(finding.observation), f"[{colour}]{finding.verdict}[/{colour}]", cell(finding.advice))
    Console().print(table)
