"""`semlive demo`: a complete simulated experiment through the daemon."""

from __future__ import annotations

import datetime
import json
import time
from pathlib import Path
from typing import Annotated, Any

import typer
import yaml
from rich.console import Console

from semlive.cli.shared.daemon_process import run_daemon
from semlive.cli.shared.output_path import output_folder
from semlive.cli.shared.simulated_run import daemon_config
from semlive.cli.shared.simulator import running_simulator
from semlive.errors import BadInput, SemliveError


def demo(
    short: Annotated[bool, typer.Option("--short", help="Fewer pairs: 5 for calibration, 4 tensile.")] = False,
    scenario: Annotated[str | None, typer.Option(help="Name of a simulator scenario.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for all files of the demo; new or empty.")] = None,
    rate: Annotated[
        float | None, typer.Option(help="Seconds of experiment per second of wall time; by default the simulator chooses, at most 40.")
    ] = None,
    triggered: Annotated[bool, typer.Option("--triggered", help="The microscope scans on a trigger; otherwise continuously.")] = False,
    rtu: Annotated[bool, typer.Option("--rtu", help="Load frame and stage use Modbus RTU on one serial line; not on Windows.")] = False,
    operator: Annotated[
        bool,
        typer.Option("--operator", help="Rehearsal: you answer the questions, here or on the page; the simulator obeys."),
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object; all other output goes to standard error.")] = False,
) -> None:
    """Run a simulated in-situ tensile experiment through the daemon and compare the result with the truth."""
    began, console = time.monotonic(), Console(stderr=as_json)
    folder = (out or Path("runs") / f"demo-{datetime.datetime.now(datetime.UTC):%Y%m%d-%H%M%S}").resolve()
    output_folder(folder, "--out")
    if folder.exists() and any(folder.iterdir()):
        raise BadInput(f"{folder}: the folder is not empty; give --out a new folder")
    console.print(f"starting the simulated microscope, load frame and stage; everything goes to {folder}")
    if operator:
        console.print(_REHEARSAL)
        rate = rate or _REHEARSAL_RATE
    name = scenario or _SCENARIOS[operator, short]
    with running_simulator(name, folder / "instrument", rate, triggered=triggered, rtu=rtu) as bench:
        config = folder / "run.yaml"
        content = daemon_config(bench, bench["rate"])
        config.write_text(yaml.safe_dump(moved_by_hand(content, bench["rate"]) if operator else content, sort_keys=False), encoding="utf-8")
        code = run_daemon(config, *(["--attended"] if operator else ["--stop-on-fault"]))
        truth_file = Path(bench["truth_file"])
    if code != 0:
        raise SemliveError(f"the daemon ended with exit code {code}; its log is in {folder / 'log'}")
    from semlive.cli.before_run.demo_result import show_result  # noqa: PLC0415  (1.5 s, for which the experiment need not wait)

    result = show_result(console, folder, truth_file)
    console.print(f"done in {time.monotonic() - began:.0f} s; try: semlive replay {folder / 'log' / 'demo'}")
    if as_json:
        typer.echo(json.dumps(result))


_SCENARIOS = {(False, False): "paper_x200", (False, True): "short", (True, False): "rehearsal", (True, True): "rehearsal_short"}
"""Scenario by (rehearsal of an operator, short run)."""
_REHEARSAL_RATE = 5.0
_PATIENCE_S = 3600.0
"""Wall time for which a rehearsal waits for an answer, s."""
_REHEARSAL = """rehearsal: only the simulated instrument moves. Requests for moves and loads appear here and on the page. Answer as at
the instrument: Enter when the specimen is moved, the load in N when it is reached. The simulated instrument then does
what your answer states. Type pause, resume or stop at any time. Try a wrong answer too."""


def moved_by_hand(config: dict[str, Any], rate: float) -> dict[str, Any]:
    """A configuration of `daemon_config` with a person in place of the interfaces of load frame and stage, which obey the answers.

    Args:
        config: the configuration for the simulated bench.
        rate: seconds of experiment per second of wall time.
    """
    pixel_um, frame, stage = config["sem"]["pixel_size_um"], config["load_frame"], config["stage"]
    program = "the load frame's program"
    return {
        **config,
        "load_frame": {**frame, "driver": "operator", "settings": {"program": program, "rehearsal": frame["settings"]}},
        "stage": {**stage, "driver": "operator", "settings": {"um_per_px": pixel_um, "rehearsal": stage["settings"]}},
        "protocol": {**config["protocol"], "motion_timeout_s": _PATIENCE_S * rate},
    }
