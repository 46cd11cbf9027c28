"""A long run of small frames: does memory grow, is a reading missed, does anything go wrong?

    python tests/benchmarks/bench_soak.py --pairs 1000 [--hold 600] [--frame 60] [--rate 300] [--out FOLDER]

The simulated bench and the real daemon, 256 x 201 px, pair after pair of stage shifts and two loads at the end. With a hold of ten
minutes and a scan a minute 900 pairs are a week of the experiment's time. The log is cut into small segments, and during the run old runs
are pruned again and again to a limit that it exceeds itself: copies of a finished run go, it stays. The memory of every process of the
daemon is taken each second (resident set without pages of files; /proc, Linux). After the warm-up, the first quarter, its slope is fitted
to the medians of 16 stretches up to the last step's end (a choice takes twice as much for half a minute; what stays after it is
looked for), with the standard error that their scatter gives, larger where the residual of one stretch resembles that of the next:
memory that grows in steps holds less information than so many independent figures. Also printed: the slope of each later quarter, and
the most that was ever taken. Prints one JSON object; the exit code is 1 if the run did not complete, readings are missing, an old
run was kept, or the slope of a process is more than two of its errors above zero, or is not known within 1 MB in 1000 pairs (two errors).
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import math
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from semlive.cli.shared.simulated_run import daemon_config
from semlive.cli.shared.simulator import running_simulator
from semlive.formats.log.messages import SEM_ORIGINAL, ResultMessage, StateMessage
from semlive.service.log.files import messages, segment_path
from semlive.service.log.recording import Recorder
from semlive.service.runtime.clock import SystemClock

DRIFT_PX_S = {"x": 0.0005, "y": -0.0012}
SCENARIO: dict[str, Any] = {
    "extends": "paper_x200",
    "scan": {"width_px": 256, "height_px": 221},
    "export": {"databar_rows": 20},
    "detector": {"read_noise": 3.0, "shot_noise": 0.25},
    # The experiment's own drift, made for two hours, has a term in t^2, which after a day outruns every search.
    "drift": {
        axis: {"warmup_px": 3.0, "warmup_s": 3000.0, "linear_px_s": rate, "quadratic_px_s2": 0.0} for axis, rate in DRIFT_PX_S.items()
    },
}
SHIFTS = ((0, 0), (6, 0), (0, 6), (-6, 0), (0, -6))
STRETCHES = 16
WARM_UP = 0.25
MAX_UNCERTAINTY_MB = 1.0
LIMIT_GB = 0.02
OLD_BYTES = 5_000_000
PRUNE_EVERY_S = 30.0


@dataclass(frozen=True)
class SoakPlan:
    """What is soaked.

    Attributes:
        pairs: in all.
        rate: seconds of experiment in a second of wall time.
        hold_s: rest before every pair.
        frame_s: time of a scan.
    """

    pairs: int
    rate: float
    hold_s: float
    frame_s: float


def processes(pid: int) -> dict[str, float]:
    """Memory, MB, of the daemon and of its children, by what they are: resident, without pages that lie in files."""
    found: dict[str, float] = {}
    for one in (pid, *_children(pid)):
        try:
            words = Path(f"/proc/{one}/cmdline").read_bytes().decode().split("\0")
            status = Path(f"/proc/{one}/status").read_text(encoding="ascii")
        except OSError:
            continue
        name = "control" if one == pid else next((word.rpartition(".")[2] for word in words if word.startswith("semlive.")), "other")
        resident = next((line for line in status.splitlines() if line.startswith("RssAnon")), "RssAnon: 0 kB")
        found[name] = found.get(name, 0.0) + int(resident.split()[1]) / 1024
    return found


def _children(pid: int) -> list[int]:
    try:
        tasks = list(Path(f"/proc/{pid}/task").iterdir())
        return [int(child) for task in tasks for child in (task / "children").read_text(encoding="ascii").split()]
    except OSError:
        return []


def slope(times_s: np.ndarray, resident_mb: np.ndarray, pairs_per_s: float) -> dict[str, Any]:
    """Growth in MB for 1000 pairs after the warm-up, and its standard error."""
    after_warm_up = times_s >= times_s[0] + WARM_UP * (times_s[-1] - times_s[0])
    middle = [(part_t.mean(), np.median(part_m)) for part_t, part_m in _stretches(times_s[after_warm_up], resident_mb[after_warm_up])]
    t, m = np.array(middle).T
    fit = np.polyfit(t, m, 1)
    off = m - np.polyval(fit, t)
    sigma = math.sqrt((off**2).sum() / (len(t) - 2) / ((t - t.mean()) ** 2).sum())
    autocorrelation = min(max(float((off[1:] * off[:-1]).sum() / max((off**2).sum(), 1e-12)), 0.0), 0.9)
    sigma *= math.sqrt((1.0 + autocorrelation) / (1.0 - autocorrelation))
    scale = 1000.0 / pairs_per_s
    quarters = zip(np.array_split(times_s[after_warm_up], 4), np.array_split(resident_mb[after_warm_up], 4), strict=True)
    return {
        "mb_per_1000_pairs": round(float(fit[0]) * scale, 2),
        "standard_error": round(sigma * scale, 2),
        "alike": round(autocorrelation, 2),
        "by_quarter": [round(float(np.polyfit(part_t, part_m, 1)[0]) * scale, 1) for part_t, part_m in quarters],
        "first_mb": round(float(resident_mb[after_warm_up][0]), 1),
        "last_mb": round(float(resident_mb[-1]), 1),
        "most_mb": round(float(resident_mb.max()), 1),
    }


def _stretches(times_s: np.ndarray, values: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    return list(zip(np.array_split(times_s, STRETCHES), np.array_split(values, STRETCHES), strict=True))


def looked_at(log: Path) -> dict[str, Any]:
    """Figures of the log: pairs, missing readings, faults, the experiment's time."""
    pairs, results, numbers, faults, ends = 0, 0, list[int](), list[str](), list[int]()
    for one in messages(log):
        ends = [*ends[:1], one.log_time_ns]
        pairs += one.topic == "/pair"
        results += one.topic == "/drift/estimate"
        if one.topic == "/load_frame/sample":
            numbers.append(json.loads(one.payload)["sequence"])
        elif one.topic == "/fault":
            faults.append(json.loads(one.payload)["what"])
    # A link that was opened again counts from 0.
    missing = sum(after - before - 1 for before, after in itertools.pairwise(numbers) if after > before)
    opened = sum(after <= before for before, after in itertools.pairwise(numbers))
    hours = (ends[-1] - ends[0]) / 3.6e12 if ends else 0.0
    figures = {"pairs": pairs, "estimates": results, "readings": len(numbers), "missing_readings": missing, "links_opened_again": opened}
    return figures | {
        "experiment_h": round(hours, 2),
        "faults": faults[:5],
        "segments": len(list(log.iterdir())),
        "log_mb": round(sum(p.stat().st_size for p in log.iterdir()) / 1e6),
    }


@contextlib.contextmanager
def pruning(root: Path) -> Iterator[dict[str, int]]:
    """Old runs come, and are pruned during the run; gives how many came and went."""
    over, counts = threading.Event(), {"old_runs": 0, "pruned": 0}

    def run() -> None:
        while not over.is_set():
            name = f"old{counts['old_runs']}"
            _old_run(root / name, name)
            counts["old_runs"] += 1
            command = [sys.executable, "-m", "semlive", "prune", str(root), "--gb", str(LIMIT_GB), "--delete", "--json"]
            done = subprocess.run(command, capture_output=True, text=True, check=True)
            counts["pruned"] += sum(one["deleted"] for one in json.loads(done.stdout)["runs"])
            over.wait(PRUNE_EVERY_S)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield counts
    finally:
        over.set()
        thread.join()


def _old_run(folder: Path, name: str) -> None:
    """A small run that came to its end a year ago."""
    folder.mkdir(parents=True)
    recorder = Recorder(segment_path(folder, name, 0), SystemClock(), sys.exit)
    recorder.write(SEM_ORIGINAL, bytes(OLD_BYTES), sequence=0)
    recorder.write("/state", StateMessage(time_ns=1, before="imaging", after="complete", cause="done", step=None, guards={}))
    recorder.write("/result", ResultMessage({"pairs": 0}))
    recorder.close()
    ended_s = time.time() - 3e7
    for path in folder.iterdir():
        os.utime(path, (ended_s, ended_s))


def scenario(pairs: int, frame_s: float) -> str:
    """The scenario of so many pairs, YAML."""
    shifts = [list(SHIFTS[number % len(SHIFTS)]) for number in range(pairs - 2)]
    protocol = {"calibration_shifts_px": shifts, "translation_shifts_px": [], "loads_n": [100, 600]}
    return yaml.safe_dump({**SCENARIO, "scan": {**SCENARIO["scan"], "frame_time_s": frame_s}, "experiment": {"protocol": protocol}})


def measure(plan: SoakPlan, folder: Path) -> dict[str, Any]:
    """One run from begin to end."""
    pairs, rate = plan.pairs, plan.rate
    (folder / "soak.yaml").write_text(scenario(pairs, plan.frame_s), encoding="utf-8")
    with running_simulator(str(folder / "soak.yaml"), folder / "bench", rate) as bench, pruning(folder / "log") as pruned:
        config = daemon_config(bench, rate)
        config["run"] |= {"name": "soak", "segment_gb": 0.05}
        # Ten thousand files are looked at in a tenth of a second.
        config["sem"] |= {"poll_s": 0.1, "stable_for_s": 0.1}
        config["dic"] = {"subset_px": 31, "step_px": 14, "roi_px": None}
        config["estimate"] = {"accept_poor_calibration": True}
        config["protocol"] |= {"load_tolerance_n": 20.0, "recentre_beyond_px": 10.0, "hold_s": plan.hold_s}
        config["load_frame"]["poll_s"], config["stage"]["poll_s"] = 0.05, 0.1
        for device in ("load_frame", "stage"):
            # A simulator that a busy computer does not let answer is no fault that is looked for here.
            config[device]["settings"] |= {"timeout_s": 4.0, "frozen_after_s": 20.0}
        # In a week the drift goes 0.9 mm, and the stage goes after it.
        config["limits"] = {**config.get("limits", {}), "stale_after_s": 5.0, "lost_after_s": 30.0, "stage_travel_um": 2000.0}
        (folder / "run.yaml").write_text(yaml.safe_dump(config), encoding="utf-8")
        command = [sys.executable, "-m", "semlive", "run", str(folder / "run.yaml"), "--stop-on-fault", "--no-page"]
        began_s = time.monotonic()
        with (folder / "said").open("w+", encoding="utf-8") as output, (folder / "memory.jsonl").open("w", buffering=1) as series:
            as_unit = {**os.environ, "PYTHONMALLOC": "malloc"}  # as deploy/semlive@.service has it
            daemon = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=output, env=as_unit)
            taken: list[tuple[float, dict[str, float]]] = []
            while daemon.poll() is None:
                # The conclusion corrects every frame again, once, and takes the time that it needs.
                if " complete " not in (folder / "said").read_bytes()[-1000:].decode(errors="replace"):
                    taken.append((time.monotonic() - began_s, processes(daemon.pid)))
                    series.write(json.dumps(taken[-1]) + "\n")
                time.sleep(1.0)
            output.seek(0)
            last = " ".join(output.read().split())[-200:]
        wall_s = time.monotonic() - began_s
    figures = {"exit_code": daemon.returncode, "wall_s": round(wall_s), **looked_at(folder / "log" / "soak"), **pruned}
    figures["memory"] = {name: _memory(taken, name, figures["pairs"] / taken[-1][0]) for name in ("control", "analysis")}
    return figures if daemon.returncode == 0 else {**figures, "said": last}


def _memory(taken: list[tuple[float, dict[str, float]]], name: str, pairs_per_s: float) -> dict[str, Any]:
    there = np.array([(at_s, found[name]) for at_s, found in taken if name in found])
    return slope(there[:, 0], there[:, 1], pairs_per_s) if len(there) > 4 * STRETCHES else {}


def grows(figures: dict[str, Any]) -> bool:
    """Whether a slope is significantly above zero, or is too uncertain to decide."""
    error = figures.get("standard_error", math.inf)
    return 2.0 * error > MAX_UNCERTAINTY_MB or figures["mb_per_1000_pairs"] > 2.0 * error


def main() -> int:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=1000)
    parser.add_argument("--rate", type=float, default=300.0)
    parser.add_argument("--hold", type=float, default=600.0, help="rest before every pair, s")
    parser.add_argument("--frame", type=float, default=60.0, help="time of a scan, s")
    parser.add_argument("--out", type=Path, default=None, help="where the log stays; else it is deleted")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = options.out or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        figures = measure(SoakPlan(options.pairs, options.rate, options.hold, options.frame), folder)
    sys.stdout.write(json.dumps(figures) + "\n")
    worse = any(grows(one) for one in figures["memory"].values())
    return int(figures["exit_code"] != 0 or figures["missing_readings"] != 0 or figures["pruned"] < figures["old_runs"] or worse)


if __name__ == "__main__":
    sys.exit(main())
