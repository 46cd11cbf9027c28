"""A column that is still warm: the daemon measures until the drift is expected to be slow, and only then loads."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from semlive.cli.shared.simulated_run import daemon_config
from semlive.cli.shared.simulator import running_simulator
from semlive.service.log.files import messages

from ..waiting import RUN_END_S, logged

RATE = 20.0
LIMIT_PX_S = 0.03
# A third of a pixel per second when the bench begins, and below the limit after twelve minutes, which are 36 s of this computer's time:
# of a computer with five other busy processes the first pair came after 20 s.
SCENARIO = """
extends: paper_x200
scan: {width_px: 320, height_px: 276, frame_time_s: 9.4}
export: {databar_rows: 30}
detector: {read_noise: 3.0, shot_noise: 0.25}
drift:
  x: {warmup_px: 100.0, warmup_s: 300.0, linear_px_s: 0.0005, quadratic_px_s2: 0.0}
  y: {warmup_px: -20.0, warmup_s: 300.0, linear_px_s: -0.0012, quadratic_px_s2: 0.0}
experiment:
  protocol:
    calibration_shifts_px: [[0, 0]]
    translation_shifts_px: []
    loads_n: [100]
"""


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("warm")
    scenario = root / "warm.yaml"
    scenario.write_text(SCENARIO, encoding="utf-8")
    with running_simulator(str(scenario), root / "bench", RATE) as bench:
        config = daemon_config(bench, RATE)
        config["run"]["name"] = "warm"
        config["dic"] = {"subset_px": 31, "step_px": 8, "roi_px": None}
        config["protocol"].update(
            load_tolerance_n=20.0,
            warm_up={"max_rate_px_s": LIMIT_PX_S, "max_wait_s": 1800.0},
            adaptive_hold={"max_hold_s": 60.0, "max_rate_px_s": 0.04, "max_relaxation_n_s": 0.2},
        )
        path = root / "run.yaml"
        path.write_text(yaml.safe_dump(json.loads(json.dumps(config))), encoding="utf-8")
        command = [sys.executable, "-m", "semlive", "run", str(path), "--no-page", "--stop-on-fault"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=RUN_END_S)
    assert done.returncode == 0, done.stderr
    return root / "log" / "warm"


def longest_silence_s(log: Path, from_ns: int, to_ns: int) -> float:
    """Between two instants, how long nothing at all was written; a few readings a second of experiment time are."""
    times_ns = [item.log_time_ns for item in messages(log) if from_ns <= item.log_time_ns <= to_ns]
    return max(after - before for before, after in itertools.pairwise([from_ns, *times_ns, to_ns])) / 1e9


def test_it_measures_until_the_drift_is_expected_to_be_slow_and_only_then_loads(log: Path) -> None:
    pairs, states = logged(log, "/pair"), logged(log, "/state")
    extra = [item for item in pairs if item["step"]["warm_up"]]
    assert len(extra) >= 1
    assert [item["pair"] for item in pairs] == list(range(2 + len(extra)))
    assert [item["step"]["load_n"] for item in pairs] == [None] * (1 + len(extra)) + [100.0]
    requests = [item for item in states if item["before"] == "warming"]
    assert [item["cause"] for item in requests] == ["measure_again"] * len(extra) + ["warm"]
    for item in requests:
        upper = item["guards"]["rate_px_s"] + item["guards"]["sigma_px_s"]
        assert (upper <= LIMIT_PX_S) == (item["cause"] == "warm")
    (ramp,) = [item["time_ns"] for item in logged(log, "/command") if item["what"] == "ramp_to"]
    assert ramp >= requests[-1]["time_ns"]
    assert requests[-1]["guards"]["rate_px_s"] < 0.7 * requests[0]["guards"]["rate_px_s"]


def test_frames_scanned_in_a_hold_determine_its_drift(log: Path) -> None:
    observed = [item for item in logged(log, "/drift/hold")]
    scans = {item["export"]: item for item in logged(log, "/sem/scan")}
    paired = {item[member]["export"] for item in logged(log, "/pair") for member in ("first", "second")}
    assert len(observed) > len(logged(log, "/pair"))
    at_rest = [(item["time_ns"], item["after"] in ("holding", "imaging")) for item in logged(log, "/state")]
    for item in observed:
        assert not {item["before"], item["after"]} <= paired
        before, after = scans[item["before"]], scans[item["after"]]
        assert item["begin_time_ns"] == before["start_time_ns"]["value"] < after["start_time_ns"]["value"] < item["end_time_ns"]
        rest = [rests for time_ns, rests in at_rest if time_ns <= item["begin_time_ns"]][-1:]
        assert all(rest + [rests for time_ns, rests in at_rest if item["begin_time_ns"] < time_ns < item["end_time_ns"]])
    truth = json.loads((log.parents[1] / "bench" / "truth.json").read_text())["drift"]
    for item in observed:
        span_s = (item["end_time_ns"] - item["begin_time_ns"]) / 1e9
        moved_px = [
            np.diff(np.interp([item["begin_time_ns"], item["end_time_ns"]], truth["time_ns"], truth[name]))[0]
            for name in ("dx_px", "dy_px")
        ]
        assert item["rate_px_s"] == pytest.approx(np.array(moved_px) / span_s, rel=0.01, abs=0.001), item


def test_holds_are_never_shorter_than_they_must_be_nor_longer_than_they_may(log: Path) -> None:
    held = [(item["guards"]["held_s"], item["time_ns"]) for item in logged(log, "/state") if item["cause"] == "hold_over"]
    assert held
    for held_s, over_ns in held:
        # The loop turns twenty times a second, which at this rate is once a second of experiment time; on a busy computer it may
        # have been suspended, and then nothing was written either.
        assert 30.0 <= held_s <= 64.0 + longest_silence_s(log, over_ns - round(held_s * 1e9), over_ns), held
    for pair in logged(log, "/pair"):
        over = next(item["time_ns"] for item in logged(log, "/state") if item["cause"] == "hold_over" and item["step"] == pair["pair"])
        assert pair["first"]["start_time_ns"]["value"] >= over - 2e9
