"""`semlive simulate`: write frames and truth of a simulated experiment without the daemon."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from semlive.cli.shared.output_path import output_folder
from semlive.cli.shared.simulator import simulator_module
from semlive.errors import BadInput, SemliveError


def simulate(
    scenario: Annotated[str, typer.Argument(help="Name of a simulator scenario, or a path ending in .yaml.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for export/, truth.json and frames.csv; new or empty.")],
    frames: Annotated[str | None, typer.Option(help="Frames to write, counted from 0, as in 0-3,8; by default all.")] = None,
    seed: Annotated[int | None, typer.Option(help="Random seed in place of that of the scenario.")] = None,
    model: Annotated[Path | None, typer.Option("--from", help="Model whose effects are simulated too, as `diagnose -o` writes it.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Simulate the experiment of a scenario without the daemon, and write the files that the microscope would export."""
    output_folder(out, "--out")
    if model is not None:
        from semlive.service.diagnosis.model_scenario import scenario_yaml  # noqa: PLC0415  (1.4 s, and only a model needs it)

        with tempfile.TemporaryDirectory(prefix="semlive-") as folder:
            extended = Path(folder) / "scenario.yaml"
            extended.write_text(scenario_yaml(model, _absolute(scenario)), encoding="utf-8")
            written = _play(str(extended), out, frames, seed)
            (out / extended.name).write_bytes(extended.read_bytes())
    else:
        written = _play(scenario, out, frames, seed)
    export, truth, table = out / "export", out / "truth.json", out / "frames.csv"
    if as_json:
        typer.echo(json.dumps({"frames": written, "export": str(export), "truth": str(truth), "table": str(table)}))
    else:
        typer.echo(f"{written} frames in {export}; the truth is in {truth}, the purpose of each frame in {table}")


def _absolute(scenario: str) -> str:
    return str(Path(scenario).resolve()) if scenario.endswith((".yaml", ".yml")) else scenario


def _play(scenario: str, out: Path, frames: str | None, seed: int | None) -> int:
    """Run the simulator; returns the number of frames written."""
    command = [sys.executable, "-m", simulator_module("frames"), "--scenario", scenario, "--out", str(out)]
    command += [] if frames is None else ["--frames", frames]
    command += [] if seed is None else ["--seed", str(seed)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, encoding="utf-8")
    written = _follow(process)
    _, errors = process.communicate()
    if process.returncode:
        lines = errors.strip().splitlines() or [f"simulate: the simulator ended with code {process.returncode} and printed no message"]
        raise (BadInput if process.returncode == 2 else SemliveError)(lines[-1])
    return written


def _follow(process: subprocess.Popen[str]) -> int:
    """Show progress until the output of the simulator ends; returns the number of frames written."""
    done = 0
    columns = (TextColumn("rendering"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("rendering", total=None)
        for line in process.stdout or ():
            _, done, total = (int(number) for number in line.split())
            progress.update(task, completed=done, total=total)
    return done
