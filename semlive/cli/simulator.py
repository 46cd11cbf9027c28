"""Simulators as processes of their own, found by entry point and spoken to through files only."""

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
    """The module that an installed simulator is run as.

    Args:
        name: of the entry point: ``bench`` serves a daemon, ``frames`` writes frames and truth without one.

    Raises:
        BadInput: it is not installed.
    """
    found = entry_points(group="semlive.simulators", name=name)
    if not found:
        raise BadInput("no simulator is installed; install semlive with its simulators (python -m pip install semlive)")
    return next(iter(found)).module


@contextlib.contextmanager
def running_simulator(
    scenario: str, folder: Path, rate: float | None, *, triggered: bool = False, rtu: bool = False
) -> Iterator[dict[str, Any]]:
    """A simulated bench for as long as the context lasts; gives what it announced in ``ready.json``.

    The simulator gets a process group of its own, so that Ctrl-C reaches the daemon first and the bench is still there
    to be stopped by it.

    Args:
        scenario: name of a scenario, or the path of one.
        folder: for everything that the simulator writes.
        rate: seconds of experiment per second of wall time; None lets the simulator choose what it can keep up with.
        triggered: its microscope scans a frame when it is asked to; otherwise it scans all the time.
        rtu: it serves its registers over a serial line too.

    Raises:
        BadInput: no simulator is installed, or it does not know the scenario; no folder is left behind.
        SemliveError: it did not come up.
    """
    module = simulator_module("bench")
    made = [one for one in (folder, *folder.parents) if not one.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", module, "--scenario", scenario, "--out", str(folder), "--exit-with-stdin"]
    command += ["--rtu"] if rtu else []
    command += ["--rate", "auto" if rate is None else str(rate), "--mode", "triggered" if triggered else "continuous"]
    try:
        with (folder / "simulator.log").open("wb") as log:
            process = start_in_own_group(command, stdout=log, stderr=log)
            try:
                ready = _wait_until_ready(process, folder)
                made = []  # from here on what lies there is a run's
                yield ready
            finally:
                _end(process)
    except BadInput:
        _take_back(made)
        raise


def _take_back(made: list[Path]) -> None:
    """Remove a folder that was made for bad input, so that the corrected command finds it new; and those above it, if nothing else came."""
    if made:
        shutil.rmtree(made[0])
        with contextlib.suppress(OSError):
            for folder in made[1:]:
                folder.rmdir()


def _wait_until_ready(process: subprocess.Popen[bytes], folder: Path) -> dict[str, Any]:
    ready, deadline = folder / "ready.json", time.monotonic() + _START_TIMEOUT_S
    while time.monotonic() < deadline:
        if ready.exists():
            return json.loads(ready.read_text(encoding="utf-8"))
        if process.poll() is not None:
            said = (folder / "simulator.log").read_text(encoding="utf-8", errors="replace").strip().splitlines()
            error = BadInput if process.returncode == 2 else SemliveError
            raise error(said[-1] if said else f"the simulator ended with code {process.returncode} and said nothing; see {folder}")
        time.sleep(0.05)
    raise SemliveError(f"the simulator did not come up within {_START_TIMEOUT_S:.0f} s; see {folder / 'simulator.log'}")


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.stdin is not None:
        process.stdin.close()
    try:
        process.wait(_STOP_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
