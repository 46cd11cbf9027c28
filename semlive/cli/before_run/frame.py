"""`semlive frame`: check a load frame before it is used."""

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

from semlive.cli.shared.terminal import cell
from semlive.data.checks import FrameCheck, Verdict
from semlive.errors import BadConfig, SemliveError
from semlive.ports import FrameChecker
from semlive.service.config.configuration import Config, load_config
from semlive.service.runtime.clock import open_clock

frame = typer.Typer(help="Check a load frame without moving it.", no_args_is_help=True)
_COLOURS = {Verdict.OK: "green", Verdict.UNKNOWN: "yellow", Verdict.FAILED: "red"}


@frame.callback()
def _frame() -> None:
    """Check a load frame without moving it."""


@frame.command("check")
def check(
    description: Annotated[str, typer.Argument(metavar="MAP", help="Device map: its name (a wrong name lists all), or a .yaml path.")],
    host: Annotated[str, typer.Option(help="Address of a device on the network.")] = "127.0.0.1",
    port: Annotated[str, typer.Option(help="TCP port, or the path of a serial line (/dev/ttyUSB0, COM3).")] = "502",
    unit: Annotated[int, typer.Option(min=0, max=255, help="Modbus unit.")] = 1,
    baud: Annotated[int | None, typer.Option(help="Baud rate of a serial line; by default that of the device map.")] = None,
    parity: Annotated[str | None, typer.Option(help="none, even or odd; by default that of the device map.")] = None,
    timeout_s: Annotated[float, typer.Option(help="Maximum time to wait for a reply.")] = 0.5,
    loads_n: Annotated[list[float] | None, typer.Option("--load", help="Load of the run, N; may be repeated. Needs --rate.")] = None,
    rate_n_s: Annotated[
        float | None,
        typer.Option(
            "--rate", min=0.0, help="Rate of its ramps, N/s; the check is whether the registers can represent the loads and the rate."
        ),
    ] = None,
    force_reads: Annotated[
        str | None,
        typer.Option(help="Force that the device's own panel shows now, N, with all its digits: 123.456. Proves scale and format."),
    ] = None,
    extension_reads: Annotated[str | None, typer.Option(help="Extension that the device's own panel shows now, mm.")] = None,
    config: Annotated[
        Path | None, typer.Option("--config", help="Configuration of a run: its loads, its rate and the settings of its load frame.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Read which device replies, whether its values are plausible, and its word order; nothing is written or moved."""
    settings: dict[str, object] = {"unit": unit, "timeout_s": timeout_s}
    if port.isdigit():
        settings |= {"host": host, "port": int(port)}
    else:
        line = {"port": port, "baud": baud, "parity": parity}
        settings["serial"] = {key: value for key, value in line.items() if value is not None}
    if config is not None:
        settings |= _config_settings(load_config(config), settings)
    orders = dict(_mapping(settings.get("orders")))
    orders |= {key: value for key, value in (("loads_n", loads_n), ("rate_n_s", rate_n_s)) if value is not None}
    if orders.get("loads_n") and orders.get("rate_n_s") is None:
        raise BadConfig("--load needs --rate: a command consists of load and rate; give the rate of the ramps, N/s")
    settings["orders"] = orders
    settings |= {key: value for key, value in (("force_reads", force_reads), ("extension_reads", extension_reads)) if value is not None}
    result = _checker()(description, settings, open_clock(None))
    if as_json:
        findings = [finding.to_json() for finding in result.findings]
        sys.stdout.write(json.dumps({**asdict(result), "findings": findings, "sound": result.passed}) + "\n")
    else:
        _show(result)
    _require_sound(result)


def _require_sound(result: FrameCheck) -> None:
    """Raise SemliveError for a device that disagrees with its description, or may have another one."""
    if not result.passed:
        failed = [finding for finding in result.findings if finding.verdict is Verdict.FAILED]
        if not failed:
            opened = next(finding for finding in result.findings if finding.verdict is Verdict.UNKNOWN and finding.advice)
            for finding in result.findings:
                if finding.what.startswith(("order of words", "scale of")) and finding.verdict is Verdict.UNKNOWN:
                    opened = finding
                    break
            raise SemliveError(
                f"{result.device} at {result.where}: nothing disagrees with the description, but the readings are not proved; "
                f"{opened.what}: {opened.advice}"
            )
        raise SemliveError(
            f"{result.device} at {result.where}: {len(failed)} of {len(result.findings)} checks failed; "
            f"{failed[0].what}: {failed[0].advice}"
        )


def _config_settings(config: Config, given: dict[str, object]) -> dict[str, object]:
    """Settings of the device in the configuration that no option gives, and the commands of the run."""
    driver_settings = {} if config.load_frame is None else dict(config.load_frame.settings)
    orders: dict[str, object] = {"loads_n": list(config.protocol.loads_n), "rate_n_s": config.protocol.ramp_rate_n_s}
    if "approach" in driver_settings:
        orders["approach"] = driver_settings["approach"]
    settings = {key: driver_settings[key] for key in ("registers", "units", "station") if key in driver_settings and key not in given}
    return {**settings, "orders": orders}


def _mapping(value: object) -> Mapping[str, object]:
    return value if isinstance(value, Mapping) else {}


def _checker() -> FrameChecker:
    points = list(entry_points(group="semlive.frame_checks"))
    if not points:
        raise BadConfig("no installed driver can check devices; install semlive with its drivers (python -m pip install semlive)")
    return points[0].load()


def _show(result: FrameCheck) -> None:
    table = Table(
        title=cell(f"{result.device} at {result.where}"), title_justify="left", caption=cell(result.source), caption_justify="left"
    )
    for column in ("check", "result", "status", "remedy"):
        table.add_column(column)
    for finding in result.findings:
        colour = _COLOURS[finding.verdict]
        table.add_row(cell(finding.what), cell(finding.observation), f"[{colour}]{finding.verdict}[/{colour}]", cell(finding.advice))
    Console().print(table)
