"""The recommended protocol is executed as it was written: frames, their qualification, the daemon on the same instrument, its log."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from semlive.cli.shared.simulated_run import daemon_config
from semlive.cli.shared.simulator import running_simulator

from ..waiting import logged

RATE = 20.0
SCENARIO = """
extends: paper_x200
scan: {width_px: 256, height_px: 221, frame_time_s: 6.0}
export: {databar_rows: 30}
detector: {read_noise: 3.0, shot_noise: 0.25}
stage: {backlash_um: 1.25, position_noise_um: 0.05, yaw_rad: 1.0e-3}
experiment:
  load_frame: {strain_gage: false}
  protocol: {settle_s: 2, calibration_shifts_px: [[0, 0], [0, 0]], translation_shifts_px: [], loads_n: []}
"""
LARGEST_PX = 7.0
"""3 % of the shorter edge."""
FRESH = {"stale_after_s": 5.0, "lost_after_s": 30.0}
"""On a busy computer the simulator answers late."""


def semlive(*arguments: object) -> str:
    """What a command prints; it must succeed."""
    done = subprocess.run([sys.executable, "-m", "semlive", *map(str, arguments)], capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def executed(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], dict[str, Any], Path]:
    """Results from the frames and from the log, and the log."""
    root = tmp_path_factory.mktemp("qualified")
    scenario, lab, protocol = root / "small.yaml", root / "lab.yaml", root / "calibrate.yaml"
    scenario.write_text(SCENARIO, encoding="utf-8")
    semlive("simulate", scenario, "--out", root / "frames")
    with running_simulator(str(scenario), root / "bench", RATE, triggered=True) as bench:
        config = daemon_config(bench, RATE)
        config["stage"]["settings"]["timeout_s"] = 4.0
        config["limits"].update(FRESH)
        lab.write_text(yaml.safe_dump(json.loads(json.dumps(config))), encoding="utf-8")
        frames = semlive("qualify", "--from", root / "frames" / "export", "--quick", "--json", "--config", lab, "--protocol", protocol)
        semlive("run", protocol, "--no-page", "--stop-on-fault")
    log = root / "log" / "demo-calibrate"
    return json.loads(frames), json.loads(semlive("qualify", "--from", log, "--quick", "--json")), log


def test_the_recommended_protocol_is_executed_as_written(executed: tuple[dict[str, Any], dict[str, Any], Path]) -> None:
    recommended, _, log = executed
    shifts = recommended["protocol"]["shifts_px"]
    assert [pair["step"]["shift_px"] for pair in logged(log, "/pair")] == shifts
    assert max(x for x, _ in shifts) == LARGEST_PX
    assert logged(log, "/state")[-1]["after"] == "complete"


def test_the_log_determines_what_the_frames_did_not(executed: tuple[dict[str, Any], dict[str, Any], Path]) -> None:
    recommended, qualified, _ = executed
    assert {"distortion", "stage"} <= {item["name"] for item in recommended["undetermined"]}
    figures = {item["name"]: item for item in qualified["figures"]}
    assert qualified["conditions"]["pairs"] == len(recommended["protocol"]["shifts_px"])
    # 1.25 um of 1.25 um per px.
    for axis, scale in (("x", 1.010), ("y", 0.993)):
        backlash = figures[f"stage_backlash_{axis}"]
        assert backlash["low"] <= scale <= backlash["high"], axis
        # Backlash is up to 0.5 px at the ends of moves of 8 px.
        assert figures[f"stage_scale_{axis}"]["value"] == pytest.approx(scale, abs=0.08)
    assert figures["distortion"]["low"] > 0.0
