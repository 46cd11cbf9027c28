"""kill -9 at random moments: acknowledged messages are in the log, the run is resumed, every step has its pair once.

    python tests/benchmarks/bench_kills.py --found FILE.jsonl [--kills 200] [--a-run 4] [--longest 30] [--rate 20] [--triggered] [--seed 0]

Each run (256 x 201 px, three shifts and four loads, a log in segments of 1 MB) is killed `--a-run` times, twice after its last step at
most, each time after a random stretch of up to `--longest` s, in one case of five from its start, else from when it is connected (however
long a busy computer takes for that), and resumed as by an operator: `--resume` at a terminal, and "resume" when it asks. Then it
ends by itself. Checked:
transitions, commands, images, pairs and faults that could be read at a kill are in the log at the end; steps are accepted in order,
each once; the last live result is that of `semlive replay`, byte for byte; Young's modulus is within four standard uncertainties of the
first run's, which is not disturbed. One JSON object a run is added to FILE, so the campaign can be interrupted and continued; with
another `--seed`, and another FILE, a second campaign can run at the same time. The exit code is 1 if a run failed.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import pty
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import yaml

from semlive.cli.shared.simulated_run import daemon_config
from semlive.cli.shared.simulator import running_simulator
from semlive.errors import SemliveError
from semlive.service.log.files import messages
from semlive.service.log.tail import LogTail

SCENARIO = """
extends: paper_x200
scan: {width_px: 256, height_px: 221, frame_time_s: 6.0}
export: {databar_rows: 20}
detector: {read_noise: 3.0, shot_noise: 0.25}
experiment:
  protocol:
    calibration_shifts_px: [[0, 0], [6, 0], [0, 6]]
    translation_shifts_px: []
    loads_n: [100, 300, 450, 600]
"""
PAIRS = 7
_LONGEST_S = 300.0


class Failed(Exception):
    """What should hold does not."""


MAX_FAILED = 5
"""Number of failed runs after which the campaign ends; a run that fails at once makes no kill."""


def logged(log: Path) -> list[tuple[str, bytes]]:
    """Everything in the log, truncated or complete."""
    try:
        return [(item.topic, item.payload) for item in messages(log)] if log.is_dir() and any(log.iterdir()) else []
    except SemliveError:
        return []


def of(found: list[tuple[str, bytes]], topic: str) -> list[dict[str, Any]]:
    """Messages of a topic."""
    return [json.loads(payload) for name, payload in found if name == topic]


def start(config: Path, resume: bool) -> tuple[subprocess.Popen[str], int]:
    """The daemon at a terminal."""
    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "semlive", "run", str(config), *(["--resume"] if resume else [])]
    process = subprocess.Popen(command, stdin=theirs, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    os.close(theirs)
    return process, ours


class Operator:
    """Follows a run's log, over all its starts."""

    def __init__(self, log: Path) -> None:
        self._log, self._tail = log, LogTail(log)
        self._states, self._asked = list[str](), 0

    def wait(self, process: subprocess.Popen[str], terminal: int, seconds: float, connected: bool = False) -> None:
        """Let it run for a time, once it is connected if so requested, or to its end; answer its prompt with resume."""
        before = len(self._states)
        end_s, counts = time.monotonic() + (_LONGEST_S if connected else seconds), not connected
        while time.monotonic() < end_s and process.poll() is None:
            time.sleep(min(0.2, max(0.01, end_s - time.monotonic())))
            try:
                self._look(terminal)
            except Failed:
                process.kill()
                raise
            if not counts and any(item != "connecting" for item in self._states[before:]):
                counts, end_s = True, time.monotonic() + seconds

    def _look(self, terminal: int) -> None:
        try:
            self._states += [json.loads(item.payload)["after"] for item in self._tail.poll() if item.topic == "/state"]
        except SemliveError:
            return
        if self._states.count("recover") > self._asked and self._states[-1] == "recover":
            self._asked += 1
            os.write(terminal, b"resume\n")
        if self._states[-1:] == ["fault"]:
            raise Failed(f"fault: {[item['what'] for item in of(logged(self._log), '/fault')][-1:]}")


def one_run(folder: Path, name: str, bench: dict[str, Any], rate: float, moments: list[tuple[bool, float]]) -> dict[str, Any]:
    """A run that is killed after each of these stretches of wall time, counted from when it is connected or not; raises Failed."""
    config = daemon_config(bench, rate)
    config["run"]["name"] = name
    config["dic"] = {"subset_px": 31, "step_px": 8, "roi_px": None}
    config["estimate"] = {"accept_poor_calibration": True}
    config["run"]["segment_gb"] = 0.001
    config["protocol"]["load_tolerance_n"] = 20.0
    for device in ("load_frame", "stage"):
        # A simulator that a busy computer does not let answer is a fault, but none that is looked for here.
        config[device]["settings"]["timeout_s"] = 4.0
    config["limits"] = {**config.get("limits", {}), "stale_after_s": 5.0, "lost_after_s": 30.0}
    path, log = folder / f"{name}.yaml", folder / "log" / name
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    killed_in, operator, acknowledged = [], Operator(log), set[tuple[str, bytes]]()
    process: subprocess.Popen[str] | None = None
    for connected, moment_s in moments:
        process, terminal = start(path, resume=bool(logged(log)))
        operator.wait(process, terminal, moment_s, connected)
        if process.poll() is not None:
            os.close(terminal)
            break
        process.kill()
        process.communicate()
        os.close(terminal)
        found = logged(log)
        acknowledged |= {item for item in found if item[0] in ("/state", "/pair", "/command", "/sem/original", "/fault")}
        killed_in.append(([item["after"] for item in of(found, "/state")] or ["nothing written"])[-1])
        if killed_in.count("complete") == 2:
            break
    if process is None or process.returncode != 0:
        process, terminal = start(path, resume=bool(logged(log)))
        operator.wait(process, terminal, 2 * _LONGEST_S)
        os.close(terminal)
    if process.poll() is None:
        process.kill()
        raise Failed(f"it did not end within {2 * _LONGEST_S:g} s; {[item['after'] for item in of(logged(log), '/state')][-3:]}")
    _, printed = process.communicate()
    # Killed after its last message, a run is complete, and resuming it reports that.
    whole = process.returncode == 2 and killed_in[-1:] == ["complete"] and "this run is complete" in " ".join(printed.split())
    if process.returncode != 0 and not whole:
        raise Failed(f"exit code {process.returncode}: {' '.join(printed.split())[-200:]}")
    found = logged(log)
    if lost := acknowledged - set(found):
        raise Failed(f"{len(lost)} acknowledged messages are gone: {sorted(topic for topic, _ in lost)[:5]}")
    if [item["pair"] for item in of(found, "/pair")] != list(range(PAIRS)):
        raise Failed(f"pairs {[item['pair'] for item in of(found, '/pair')]}")
    live = of(found, "/result")[-1]
    replayed = subprocess.run([sys.executable, "-m", "semlive", "replay", str(log), "--json"], capture_output=True, text=True, check=True)
    if json.loads(replayed.stdout) != live:
        raise Failed("the live result is not that of its replay")
    return {"killed_in": killed_in, "modulus": live["elastic"]["youngs_modulus_gpa"]}


def main() -> int:
    """Continue the campaign."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--found", type=Path, required=True, help="where what was found is kept")
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--a-run", type=int, default=4, help="kills in each run")
    parser.add_argument("--longest", type=float, default=30.0, help="the longest stretch before a kill, s")
    parser.add_argument("--rate", type=float, default=20.0)
    parser.add_argument("--triggered", action="store_true", help="the microscope scans when asked; otherwise all the time")
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    options = parser.parse_args()
    found_before = [json.loads(line) for line in options.found.read_text().splitlines()] if options.found.exists() else []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "small.yaml").write_text(SCENARIO, encoding="utf-8")
        while (
            sum(len(item.get("killed_in", ())) for item in found_before) < options.kills
            and sum(bool(item["failed"]) for item in found_before) < MAX_FAILED
        ):
            number = len(found_before)
            chance = random.Random(number + 1000 * options.seed)
            moments = [(chance.random() > 0.2, chance.uniform(0.0, options.longest)) for _ in range(options.a_run if number else 0)]
            began_s = time.monotonic()
            try:
                # A new simulator: semlive does not unload the specimen at the end, and a loaded frame is refused at the start.
                with running_simulator(
                    str(folder / "small.yaml"), folder / f"bench{number}", options.rate, triggered=options.triggered
                ) as bench:
                    found = one_run(folder, f"run{number}", bench, options.rate, moments)
                zero = found_before[0]["modulus"] if found_before else found["modulus"]
                off = abs(found["modulus"]["value"] - zero["value"]) / math.hypot(found["modulus"]["sigma"], zero["sigma"])
                found["sigmas_off"] = round(off, 2)
                found["failed"] = "" if off < 4 else "Young's modulus is another"
            except (Failed, OSError, subprocess.CalledProcessError) as error:
                found = {"killed_in": [], "failed": " ".join(str(error).split())}
                if not found_before:
                    raise
            found_before.append({"run": number, **found, "wall_s": round(time.monotonic() - began_s)})
            with options.found.open("a", encoding="utf-8") as file:
                file.write(json.dumps(found_before[-1]) + "\n")
            sys.stdout.write(json.dumps(found_before[-1]) + "\n")
            sys.stdout.flush()
    failed = [item["run"] for item in found_before if item["failed"]]
    kills = sum(len(item["killed_in"]) for item in found_before)
    sys.stdout.write(f"{kills} kills in {len(found_before)} runs, {len(failed)} runs failed {failed or ''}\n")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
