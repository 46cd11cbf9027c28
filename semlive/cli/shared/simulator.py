"""Simulators run as separate processes, are found by entry point, and communicate through files only."""

from __future__ import annotations

import contextlib
import json
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from semlive.errors import BadInput, SemliveError
from semlive.service.runtime.process import start_in_own_group

_START_TIMEOUT_S = 180.0
_STOP_TIMEOUT_S = 20.0


def simulator_module(name: str) -> str:
    """The module of an installed simulator, for ``python -m``.

    Args:
        name: name of the entry point: ``bench`` serves a daemon, ``frames`` writes frames and truth without one.

    Raises:
        BadInput: no simulator is installed.
    """
    modules = entry_points(group="semlive.simulators", name=name)
    if not modules:
        raise BadInput("no simulator is installed; install semlive with its simulators (python -m pip install semlive)")
    return next(iter(modules)).module


@contextlib.contextmanager
def running_simulator(
    scenario: str, folder: Path, rate: float | None, *, triggered: bool = False, rtu: bool = False
) -> Iterator[dict[str, Any]]:
    """A simulated bench that runs until the context ends; gives the content of its ``ready.json``.

    The simulator has its own process group. Ctrl-C therefore reaches the daemon first, and the daemon can still stop the
    simulated load frame.

    Args:
        scenario: name of a scenario, or the path of one.
        folder: folder for the files of the simulator.
        rate: seconds of experiment per second of wall time; None lets the simulator choose a rate that it can maintain.
        triggered: the microscope scans a frame on each trigger; otherwise it scans continuously.
        rtu: serve the registers on a serial line too.

    Raises:
        BadInput: no simulator is installed, or the scenario does not exist; new folders are removed again.
        SemliveError: the simulator did not start.
    """
    module = simulator_module("bench")
    new_folders = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", module, "--scenario", scenario, "--out", str(folder), "--exit-with-stdin"]
    command += ["--rtu"] if rtu else []
    command += ["--rate", "auto" if rate is None else str(rate), "--mode", "triggered" if triggered else "continuous"]
    try:
        with (folder / "simulator.log").open("wb") as log:
            process = start_in_own_group(command, stdout=log, stderr=log)
            try:
                ready = _wait_until_ready(process, folder)
                new_folders = []  # the folder now holds a run
                yield ready
            finally:
                _end(process)
    except BadInput:
        _remove_folders(new_folders)
        raise


def _remove_folders(new_folders: list[Path]) -> None:
    """Remove the new folders of a command with bad input, so that the corrected command finds none; parents only if empty."""
    if new_folders:
        shutil.rmtree(new_folders[0])
        with contextlib.suppress(OSError):
            for folder in new_folders[1:]:
                folder.rmdir()


def _wait_until_ready(process: subprocess.Popen[bytes], folder: Path) -> dict[str, Any]:
    ready, deadline = folder / "ready.json", time.monotonic() + _START_TIMEOUT_S
    while time.monotonic() < deadline:
        if ready.exists():
            return json.loads(ready.read_text(encoding="utf-8"))
        if process.poll() is not None:
            messages = (folder / "simulator.log").read_text(encoding="utf-8", errors="replace").strip().splitlines()
            error = BadInput if process.returncode == 2 else SemliveError
            raise error(
                messages[-1] if messages else f"the simulator ended with code {process.returncode} and printed no message; see {folder}"
            )
        time.sleep(0.05)
    raise SemliveError(f"the simulator did not start within {_START_TIMEOUT_S:.0f} s; see {folder / 'simulator.log'}")


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.stdin is not None:
        process.stdin.close()
    try:
        process.wait(_STOP_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
