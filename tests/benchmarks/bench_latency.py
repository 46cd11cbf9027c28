"""How exact the hold is and how long a result takes, from the logs of real runs of the daemon on the bench.

    python tests/benchmarks/bench_latency.py [--poll-s 1 --stable-for-s 2] [--no-events] [--full-rate 40]

The first run is at rate 1, a second of experiment for a second of wall time, as at an instrument: small frames, the 30 s hold, about
4 minutes. The second has frames of the paper's size (1024 x 884 px, 18,000 points); at rate 1 it would take 40 minutes, so it runs
faster, and only what is wall time at any rate is taken from it: arrival, correlation, estimate. Its microscope scans when asked, so that
it does not render the next frame, which an instrument does elsewhere, while a pair is analysed on the same processors; ``--continuous``
has one that does. With ``--pairs 105`` the 99th percentile has pairs enough: half an hour at rate 14.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from daemon_plans import check_plan

from semlive.cli.shared.simulated_run import daemon_config
from semlive.cli.shared.simulator import running_simulator
from semlive.formats.log.reader import LogMessage
from semlive.service.log.files import messages

HOLD_S = 30.0
SMALL = """
extends: paper_x200
scan: {width_px: 256, height_px: 221, frame_time_s: 6.63}
export: {databar_rows: 30}
experiment:
  protocol:
    hold_s: 30
    calibration_shifts_px: [[0, 0], [6, 0]]
    translation_shifts_px: []
    loads_n: [100, 300]
  dic: {subset_px: 31, step_px: 8, roi_px: null}
"""
CROSS_PX = ([0, 0], [24, 0], [-8, -20], [0, 28], [-28, 6], [16, 0], [0, -16], [8, 8])
TOP_N = 1500.0


@dataclass(frozen=True)
class Log:
    """A finished run: JSON messages by topic, each with its place in the log, on the line of wall time."""

    by_topic: dict[str, list[tuple[LogMessage, dict[str, Any]]]]

    def wall_s(self, time_ns: int) -> float:
        """Wall time of an instant of experiment time, by the clock that was in force."""
        clocks = [clock for message, clock in self.by_topic["/clock"] if message.log_time_ns <= time_ns]
        clock = clocks[-1] if clocks else self.by_topic["/clock"][0][1]
        return clock["mono0_ns"] / 1e9 + (time_ns - clock["utc0_ns"]) / 1e9 / clock["rate"]

    def of(self, topic: str) -> list[tuple[LogMessage, dict[str, Any]]]:
        return self.by_topic.get(topic, [])

    def recorded_s(self, topic: str, key: Callable[[dict[str, Any]], int | None]) -> dict[int, float]:
        """When each message was recorded, wall s, by a number in its payload; the first counts."""
        found: dict[int, float] = {}
        for message, payload in self.of(topic):
            number = key(payload)
            if number is not None:
                found.setdefault(number, self.wall_s(message.log_time_ns))
        return found


def run(scenario: str, rate: float, folder: Path, sem: dict[str, Any], *, triggered: bool = False) -> Log:
    """A complete run of the daemon; its log."""
    folder.mkdir()
    path = folder / "scenario.yaml"
    path.write_text(scenario, encoding="utf-8")
    with running_simulator(str(path), folder / "bench", rate, triggered=triggered) as bench:
        config = daemon_config(bench, rate)
        config["sem"].update(sem)
        config["estimate"] = {"accept_poor_calibration": True}  # only times count
        config_file = folder / "run.yaml"
        config_file.write_text(yaml.safe_dump(config), encoding="utf-8")
        command = [sys.executable, "-m", "semlive", "run", str(config_file), "--no-page", "--stop-on-fault"]
        subprocess.run(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=sys.stderr, check=True)
    by_topic: dict[str, list[tuple[LogMessage, dict[str, Any]]]] = {}
    for message in messages(folder / "log" / "demo"):
        if message.payload.startswith(b"{"):
            by_topic.setdefault(message.topic, []).append((message, json.loads(message.payload)))
    return Log(by_topic)


def full_scenario(pairs: int) -> str:
    """The paper's frames: a calibration, then loads in equal steps."""
    shifts = [list(CROSS_PX[n % len(CROSS_PX)]) for n in range(min(len(CROSS_PX), pairs - 3))]
    loads_n = [round(100.0 + step, 1) for step in np.linspace(0.0, TOP_N - 100.0, pairs - len(shifts)).tolist()]
    protocol = {"calibration_shifts_px": shifts, "translation_shifts_px": [], "loads_n": loads_n, "recentre_beyond_px": 10.0}
    limits = {"force_step_max_n": max(600.0, *np.ceil(np.diff(loads_n)).tolist())}
    return yaml.safe_dump({"extends": "paper_x200", "experiment": {"protocol": protocol, "limits": limits}})


def holds_s(log: Log) -> list[float]:
    """Wall length of every hold that was kept, from "settled" to "hold over"."""
    held, settled_ns = [], 0
    for _, state in log.of("/state"):
        if state["cause"] == "settled":
            settled_ns = state["time_ns"]
        elif state["cause"] == "hold_over":
            held.append(log.wall_s(state["time_ns"]) - log.wall_s(settled_ns))
    return held


def sample_periods_s(log: Log, topic: str) -> list[float]:
    """Wall time between readings of a device."""
    return list(np.diff([sample["mono_ns"] for _, sample in log.of(topic)]) / 1e9)


def files_s(log: Log) -> dict[str, list[float]]:
    """From the end of writing of every file to what followed."""
    arrived = {payload["export"]: (message, payload) for message, payload in log.of("/sem/file") if payload["decision"] == "arrived"}
    complete = {export: log.wall_s(payload["mtime_ns"]) for export, (_, payload) in arrived.items()}
    scans = log.recorded_s("/sem/scan", lambda payload: payload["export"])
    return {
        "file complete -> believed complete": [log.wall_s(payload["arrival_time_ns"]) - complete[n] for n, (_, payload) in arrived.items()],
        "file complete -> /sem/file in the log": [log.wall_s(message.log_time_ns) - complete[n] for n, (message, _) in arrived.items()],
        "/sem/file -> decoded, /sem/scan": [scans[n] - log.wall_s(arrived[n][0].log_time_ns) for n in scans],
    }


def results_s(log: Log) -> dict[str, list[float]]:
    """From the second frame of every pair to the pair's results."""
    arrived = {payload["export"]: (message, payload) for message, payload in log.of("/sem/file") if payload["decision"] == "arrived"}
    paired = log.recorded_s("/pair", lambda payload: payload["pair"])
    strained = log.recorded_s("/strain/summary", lambda payload: payload["frame"])
    estimated = log.recorded_s("/drift/estimate", lambda payload: max(payload["frame"]) // 2)
    names = ("/sem/file -> /pair", "/sem/file -> /drift/estimate", "/sem/file -> /strain/summary", "file complete -> /strain/summary")
    rows: dict[str, list[float]] = {name: [] for name in names}
    for _, pair in log.of("/pair"):
        number = pair["pair"]
        message, payload = arrived[pair["second"]["export"]]
        at, result = log.wall_s(message.log_time_ns), strained[2 * number + 1]
        rows["/sem/file -> /pair"].append(paired[number] - at)
        rows["/sem/file -> /drift/estimate"].append(estimated[number] - at)
        rows["/sem/file -> /strain/summary"].append(result - at)
        rows["file complete -> /strain/summary"].append(result - log.wall_s(payload["mtime_ns"]))
    return rows


def analyses_s(log: Log) -> list[float]:
    """Correlation, estimate and strain of every pair, in the analysis process itself."""
    last_map = {payload["current"]: payload["wall_s"] for _, payload in log.of("/dic/summary")}
    return [last_map[2 * pair["pair"] + 1] for _, pair in log.of("/pair")]


def table(title: str, rows: Iterable[tuple[str, Sequence[float]]]) -> None:
    """One line for each quantity, ms."""
    sys.stdout.write(f"\n{title}\n{'ms':<44}{'n':>7}{'mean':>10}{'p50':>10}{'p99':>10}{'max':>10}\n")
    for name, values in rows:
        ms = 1e3 * np.asarray(values)
        figures = (ms.mean(), np.percentile(ms, 50), np.percentile(ms, 99), ms.max())
        sys.stdout.write(f"{name:<44}{ms.size:>7}" + "".join(f"{figure:>10.1f}" for figure in figures) + "\n")
    sys.stdout.flush()


def main() -> None:
    """Run both and print."""
    parser = argparse.ArgumentParser(description="Hold and latency of the daemon, measured from its logs.")
    parser.add_argument("--poll-s", type=float, default=1.0, help="between looks at the folder; 1 is the configuration's default")
    parser.add_argument("--stable-for-s", type=float, default=2.0, help="without change before a file is complete; 2 is the default")
    parser.add_argument("--full-rate", type=float, default=40.0, help="experiment seconds per wall second with full-size frames")
    parser.add_argument("--pairs", type=int, default=8, help="of the run with full-size frames; the 99th percentile asks for 100")
    parser.add_argument("--continuous", action="store_true", help="full-size frames are scanned all the time, not when asked")
    parser.add_argument("--no-events", action="store_true", help="the folder is scanned at its interval only")
    parser.add_argument("--small-only", action="store_true", help="only the run at rate 1")
    parser.add_argument("--smoke", action="store_true", help="only check that the daemon accepts both plans")
    options = parser.parse_args()
    sem: dict[str, Any] = {"poll_s": options.poll_s, "stable_for_s": options.stable_for_s, "file_events": not options.no_events}
    if options.smoke:
        for scenario in (SMALL, *(full_scenario(pairs) for pairs in (options.pairs, 105))):
            check_plan(scenario, options.full_rate, lambda config: config | {"sem": config["sem"] | sem})
        return
    with tempfile.TemporaryDirectory(prefix="semlive-latency-") as folder:
        small = run(SMALL, 1.0, Path(folder) / "small", sem)
        table(
            f"rate 1, 256 x 221 px; folder scanned every {options.poll_s:g} s, files complete after {options.stable_for_s:g} s unchanged",
            [
                (f"hold beyond {HOLD_S:g} s", [held - HOLD_S for held in holds_s(small)]),
                ("load frame, time between readings", sample_periods_s(small, "/load_frame/sample")),
                ("stage, time between readings", sample_periods_s(small, "/stage/sample")),
                *files_s(small).items(),
                *((f"2nd frame: {name}", values) for name, values in results_s(small).items()),
                ("analysis of a pair by itself", analyses_s(small)),
            ],
        )
        if options.small_only:
            return
        full = run(full_scenario(options.pairs), options.full_rate, Path(folder) / "full", {}, triggered=not options.continuous)
        scans = "all the time" if options.continuous else "when asked"
        rows, points = results_s(full), full.of("/dic/summary")[0][1]["points"]
        table(
            f"rate {options.full_rate:g}, 1024 x 884 px, {points} points; wall time; the microscope scans {scans}",
            [
                ("/sem/file -> decoded, /sem/scan", files_s(full)["/sem/file -> decoded, /sem/scan"]),
                *((f"2nd frame: {name}", rows[name]) for name in tuple(rows)[:3]),
                ("analysis of a pair by itself", analyses_s(full)),
            ],
        )
        stretches = [len(log.of("/clock")) - 1 for log in (small, full)]
        sys.stdout.write(f"\nthe simulation stretched its clock {stretches[0]} and {stretches[1]} times\n")


if __name__ == "__main__":
    main()
