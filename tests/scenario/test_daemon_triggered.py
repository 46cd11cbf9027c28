"""The microscope scans on request: the same experiment as with one that scans all the time, in less time."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from typing import Any

import pytest
import yaml

from semlive.cli.shared.simulated_run import daemon_config
from semlive.cli.shared.simulator import running_simulator
from semlive.service.log.files import messages

from ..waiting import RUN_END_S

# With 40 s a frame the hold of a step ends soon after the start of a scan, which a free-running microscope wastes.
SCENARIO = """
extends: paper_x200
scan: {width_px: 256, height_px: 221, frame_time_s: 40.0}
export: {databar_rows: 30}
experiment:
  protocol:
    calibration_shifts_px: [[0, 0], [6, 0]]
    translation_shifts_px: []
    loads_n: [100]
  dic: {subset_px: 31, step_px: 8, roi_px: null}
  estimate: {accept_poor_calibration: true}
"""
RATE = "20"
"""What the computer takes to answer counts this many times in the experiment's time: half of the rate that the demo would choose."""
PAIRS, FRAME_S = 3, 40.0
MODES = ("continuous", "triggered")


@dataclass(frozen=True)
class Ran:
    """A finished run: its log by topic, and what really happened."""

    log: dict[str, list[dict[str, Any]]]
    truth: dict[str, Any]

    @property
    def took_s(self) -> float:
        """Experiment time from the first motion to the end."""
        states = self.log["/state"]
        began = next(state["time_ns"] for state in states if state["cause"] == "start")
        return (states[-1]["time_ns"] - began) / 1e9

    @property
    def before_scans_s(self) -> float:
        """Experiment time from the end of each hold to the scan of the pair's first frame, and from this frame to the second, together."""
        over = {state["step"]: state["time_ns"] for state in self.log["/state"] if state["cause"] == "hold_over"}
        first, second = ([pair[member]["start_time_ns"]["value"] for pair in self.log["/pair"]] for member in ("first", "second"))
        after_holds = [start - over[pair["pair"]] for start, pair in zip(first, self.log["/pair"], strict=True)]
        between = [later - earlier - FRAME_S * 1e9 for earlier, later in zip(first, second, strict=True)]
        return sum((*after_holds, *between)) / 1e9

    @property
    def paired(self) -> list[int]:
        """Exports that are in a pair, in order."""
        return [pair[member]["export"] for pair in self.log["/pair"] for member in ("first", "second")]


@pytest.fixture(scope="module")
def ran_modes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Ran]:
    """Both modes, side by side."""
    root = tmp_path_factory.mktemp("modes")
    scenario = root / "small.yaml"
    scenario.write_text(SCENARIO, encoding="utf-8")
    # Both are one experiment; what `semlive demo` does after it, which takes longer, is done once.
    demo = [sys.executable, "-m", "semlive", "demo", "--scenario", str(scenario), "--rate", RATE, "--triggered", "--out"]
    with running_simulator(str(scenario), root / "continuous" / "instrument", float(RATE)) as bench:
        config = root / "continuous" / "run.yaml"
        config.write_text(yaml.safe_dump(json.loads(json.dumps(daemon_config(bench, float(RATE))))), encoding="utf-8")
        run = [sys.executable, "-m", "semlive", "run", str(config), "--no-page", "--stop-on-fault"]
        started = {
            mode: subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
            for mode, command in (("continuous", run), ("triggered", [*demo, str(root / "triggered")]))
        }
        printed = {mode: process.communicate(timeout=RUN_END_S)[0] for mode, process in started.items()}
    ran = {}
    for mode, process in started.items():
        assert process.returncode == 0, printed[mode]
        log: dict[str, list[dict[str, Any]]] = {}
        for message in messages(root / mode / "log" / "demo"):
            if message.topic in ("/state", "/pair", "/command", "/sem/file", "/sem/scan", "/fault", "/result"):
                log.setdefault(message.topic, []).append(json.loads(message.payload))
        ran[mode] = Ran(log, json.loads((root / mode / "instrument" / "truth.json").read_text(encoding="utf-8")))
    return ran


@pytest.mark.parametrize("mode", MODES)
def test_the_run_completes(ran_modes: dict[str, Ran], mode: str) -> None:
    log = ran_modes[mode].log
    assert log["/state"][-1]["after"] == "complete"
    assert len(log["/pair"]) == PAIRS
    assert log["/result"][0]["pairs"] == PAIRS
    assert "/fault" not in log


def test_no_unused_frame_is_scanned_after_the_first_step(ran_modes: dict[str, Ran]) -> None:
    ran = ran_modes["triggered"]
    exports = [scan["export"] for scan in ran.log["/sem/scan"]]
    # The uncertainty of a start time is learned from the first frame: only that frame may have been requested too early.
    first_of_second_step = ran.paired[2]
    assert [export for export in exports if export >= first_of_second_step] == ran.paired[2:]
    assert len(exports) <= 2 * PAIRS + 1
    # Every request was scanned, and every scan is in the log.
    triggers = [command for command in ran.log["/command"] if command["what"] == "trigger"]
    assert len(triggers) == len(exports) == len(ran.truth["frames"])
    assert not any(frame["moving"] for frame in ran.truth["frames"])


def test_every_frame_begins_after_its_hold_and_after_the_frame_before(ran_modes: dict[str, Ran]) -> None:
    for mode in MODES:
        log = ran_modes[mode].log
        for pair in log["/pair"]:
            own = [state for state in log["/state"] if state["step"] == pair["pair"]]
            settled = max(state["time_ns"] for state in own if state["cause"] == "settled")
            first, second = (pair[member]["start_time_ns"]["value"] for member in ("first", "second"))
            assert first - settled >= 30e9
            assert second - first >= FRAME_S * 1e9


def test_it_takes_less_time_than_scanning_all_the_time(ran_modes: dict[str, Ran]) -> None:
    triggered, continuous = ran_modes["triggered"], ran_modes["continuous"]
    assert len(continuous.log["/sem/scan"]) > len(triggered.log["/sem/scan"])
    # Measured: 27 to 33 s a step lost to a scan that began too early, 10 s to asking for the second frame only after the first. With a
    # trigger only the answers of the computer are between hold and scans; on a busy one they took longer than what is saved.
    assert triggered.took_s - triggered.before_scans_s < continuous.took_s
    assert triggered.before_scans_s > 0.0
