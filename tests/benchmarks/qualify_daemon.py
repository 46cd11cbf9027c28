"""Scenarios of qualification through the real daemon: the plan that the command writes, its run, and the figures of its log.

Each scenario is a simulated instrument with a trigger and a stage. `semlive qualify lab.yaml --run` takes pairs until the drift settles,
the cross of shifts, ends the run as soon as no figure needs a further pair, and evaluates its log. The same frames are also evaluated as a
folder, whose times are those of the files instead of those of the run, and without commanded positions.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml

from semlive import dic
from semlive.cli.shared.simulated_run import daemon_config
from semlive.cli.shared.simulator import running_simulator
from semlive.data.settings import AnalysisSettings, ScanProfile
from semlive.qualify.evidence import first_settings
from semlive.qualify.figures.distortion import POINTS, without_affine
from semlive.service.config.configuration import load_config
from semlive.service.log.opened_log import OpenedLog
from semlive.service.qualification.frames import list_frames, load_frame
from semlive_simulators.scenario import Scenario, load_scenario

RATE = 20.0
"""Seconds of experiment per second of wall time."""
SLOW = {"stale_after_s": 5.0, "lost_after_s": 30.0}
"""On a busy computer the simulator answers late."""
COMPARED = ("noise_43", "drift_rate", "drift_rate_first", "frame_interval", "distortion", "false_strain_per_px", "waiting_time")
MAX_DIFFERENCE = 1.0
"""Largest difference of a figure of the log from that of the folder, in half widths of its interval: both have the same frames."""


@dataclass(frozen=True, slots=True, eq=False)
class DaemonRun:
    """A scenario through the daemon.

    Attributes:
        pairs: number of pairs in the log, of those that the plan has without warm-up, and of those of the warm-up.
        minutes: beam time, from the first frame to the end of the last, minutes of experiment.
        log: qualification of the log.
        folder: qualification of the folder of its frames.
        truth: true values by name of the figure.
    """

    pairs: tuple[int, int, int]
    minutes: float
    log: Mapping[str, Any]
    folder: Mapping[str, Any]
    truth: Mapping[str, float]


def run_scenario(name: str, work: Path) -> DaemonRun:
    """Qualify the simulated instrument of a scenario.

    Args:
        name: of the scenario.
        work: new folder for all files.

    Raises:
        SystemExit: a command failed.
    """
    scenario, lab, run = load_scenario(name), work / "lab.yaml", work / "log" / "demo-qualify"
    with running_simulator(name, work / "bench", RATE, triggered=True) as bench:
        config = json.loads(json.dumps(daemon_config(bench, RATE)))
        config["stage"]["settings"]["timeout_s"] = 4.0
        config["sem"]["profile"]["frame_time_s"] = scenario.frame_duration_s
        config["limits"].update(SLOW)
        lab.write_text(yaml.safe_dump(config), encoding="utf-8")
        log = json.loads(run_semlive("qualify", lab, "--run", "--json"))
    export = work / "bench" / "export"
    folder = json.loads(run_semlive("qualify", "--from", export, "--json"))
    frames = json.loads((work / "bench" / "truth.json").read_text(encoding="utf-8"))["frames"]
    minutes = ((frames[-1]["start_time_ns"] - frames[0]["start_time_ns"]) * 1e-9 + scenario.frame_duration_s) / 60.0
    planned = len(load_config(run.with_name(f"{run.name}.yaml")).protocol.calibration_shifts_px)
    warm_up = sum(json.loads(item.payload)["step"]["warm_up"] for item in OpenedLog(run).messages() if item.topic == "/pair")
    return DaemonRun((log["conditions"]["pairs"], planned, warm_up), minutes, log, folder, true_figures(scenario, work / "bench"))


def true_figures(scenario: Scenario, bench: Path) -> dict[str, float]:
    """True drift rate of the last pair, and largest distortion over the points of the correlation."""
    truth = json.loads((bench / "truth.json").read_text(encoding="utf-8"))
    starts = [(frame["start_time_ns"] - truth["start_time_ns"]) * 1e-9 for frame in truth["frames"][-2:]]
    row_s = np.linspace(0.0, scenario.frame_duration_s, 51)
    before, after = (scenario.drift.at(start_s + row_s).mean(axis=0) for start_s in starts)
    frames = list_frames(bench / "export", ScanProfile())
    settings, _ = first_settings(first := load_frame(frames[0], 0), AnalysisSettings())
    grid = dic.grid_for(settings.dic, first.info.width_px, first.info.height_px)
    x, y = (axis.ravel() for axis in np.meshgrid(*(np.linspace(axis[0], axis[-1], POINTS) for axis in (grid.x_px, grid.y_px))))
    rate = float(np.linalg.norm(after - before)) / (starts[1] - starts[0])
    if any("row_start" in effect for effect in truth["effects"]):
        return {"drift_rate": rate}  # settling is a part of the distortion
    bend = without_affine(scenario.distortion.at(x, y, scenario.scan.width_px, scenario.scan.height_px), x, y)
    return {
        "drift_rate": rate,
        "distortion": float(np.linalg.norm(bend, axis=1).max()),
    }


def disagreements(run: DaemonRun) -> list[str]:
    """Figures whose intervals do not contain the truth, and those that differ between log and folder."""
    of_log, of_folder = ({figure["name"]: figure for figure in found["figures"]} for found in (run.log, run.folder))
    found = [f"{name}: true value" for name, true in run.truth.items() if name in of_log and not _inside(of_log[name], true)]
    for name in COMPARED:
        if (name in of_log) != (name in of_folder):
            found.append(f"{name}: only in one")
        elif name in of_log:
            half = 0.5 * (of_log[name]["high"] - of_log[name]["low"])
            if abs(of_log[name]["value"] - of_folder[name]["value"]) > MAX_DIFFERENCE * half + 1e-6:
                found.append(f"{name}: folder")
    return found


def daemon_rows(limiting: Mapping[str, str], names: list[str]) -> Iterator[tuple[str, bool]]:
    """Lines of the table, each with whether the limit is right, and figures agree.

    Args:
        limiting: effect of each scenario.
        names: scenarios.
    """
    for name in names:
        with TemporaryDirectory(prefix="semlive-") as folder:
            run = run_scenario(name, Path(folder))
        limits, other = ((found["limiting"], found["limiting_corrected"]) for found in (run.log, run.folder))
        wrong = disagreements(run)
        named = " | ".join(effect.replace("_", " ") for effect in (limiting[name], *limits))
        same = "the same" if limits == other else ", ".join(other).replace("_", " ")
        pairs = f"{run.pairs[0]} of {run.pairs[1] + run.pairs[2]} | {run.pairs[2]} | {run.minutes:.0f} min"
        line = f"| `{name}` | {pairs} | {named} | {same} | {_drift(run)} | {'; '.join(wrong) or 'none'} |"
        right = any(limit.startswith(limiting[name]) for limit in limits)  # the yaw of the stage is its error too
        yield line, right and limits == other and not wrong


def _drift(run: DaemonRun) -> str:
    figures = {figure["name"]: figure for figure in run.log["figures"]}
    texts = []
    for name, factor in (("drift_rate", 1e3), ("distortion", 1.0)):
        if name in figures and name in run.truth:
            low, high = (factor * figures[name][end] for end in ("low", "high"))
            texts.append(f"{factor * run.truth[name]:.3g} in {low:.3g} to {high:.3g}")
        else:
            texts.append("")
    return " | ".join(texts)


def _inside(figure: Mapping[str, Any], true: float) -> bool:
    return figure["low"] <= true <= figure["high"]


def run_semlive(*arguments: object) -> str:
    """Output of a command without a terminal; SystemExit with its messages if it fails."""
    command = [sys.executable, "-m", "semlive", *map(str, arguments)]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"semlive {' '.join(map(str, arguments))}: {done.stdout[-1000:]}{done.stderr[-2000:]}")
    return done.stdout
