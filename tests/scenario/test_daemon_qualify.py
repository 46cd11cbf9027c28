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
from semlive.service.config.configuration import load_config

from ..waiting import PATIENCE_S, logged

RATE = 20.0
# With frames of 4 s a busy computer made the pauses between pairs so long, in frames, that the drift had thousands of knots.
SCENARIO = """
extends: paper_x200
scan: {width_px: 160, height_px: 138, frame_time_s: 40.0}
export: {databar_rows: 30}
detector: {read_noise: 3.0, shot_noise: 0.25}
experiment:
  load_frame: {strain_gage: false}
  protocol: {settle_s: 2, calibration_shifts_px: [[0, 0], [0, 0]], translation_shifts_px: [], loads_n: []}
"""
FRESH = {"stale_after_s": 5.0, "lost_after_s": 30.0}
"""On a busy computer the simulator answers late."""


def semlive(*arguments: object) -> str:
    """What a command prints; it must succeed."""
    done = subprocess.run([sys.executable, "-m", "semlive", *map(str, arguments)], capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.timeout(600)
def test_the_recommended_protocol_is_executed_and_its_log_is_qualified(tmp_path: Path) -> None:
    scenario, lab, protocol, further = (tmp_path / name for name in ("small.yaml", "lab.yaml", "calibrate.yaml", "next.yaml"))
    scenario.write_text(SCENARIO, encoding="utf-8")
    semlive("simulate", scenario, "--out", tmp_path / "frames")
    log = tmp_path / "log" / "demo-calibrate"
    with running_simulator(str(scenario), tmp_path / "bench", RATE, triggered=True) as bench:
        config = daemon_config(bench, RATE)
        config["stage"]["settings"]["timeout_s"] = 4.0
        config["limits"].update(FRESH)
        lab.write_text(yaml.safe_dump(json.loads(json.dumps(config))), encoding="utf-8")
        frames = tmp_path / "frames" / "export"
        recommended = json.loads(semlive("qualify", "--from", frames, "--quick", "--json", "--config", lab, "--protocol", protocol))
        semlive("run", protocol, "--no-page", "--stop-on-fault")
    shifts = recommended["protocol"]["shifts_px"]
    taken = [pair["step"]["shift_px"] for pair in logged(log, "/pair")]
    assert taken == shifts == [[0.0, 0.0], [4.0, 0.0], [0.0, 4.0]]
    qualified: dict[str, Any] = json.loads(semlive("qualify", "--from", log, "--quick", "--json", "--protocol", further))
    figures = {item["name"]: item for item in qualified["figures"]}
    assert (qualified["conditions"]["pairs"], qualified["conditions"]["dated"]) == (len(taken), True)
    assert qualified["conditions"]["frame_s"] == pytest.approx(40.0, rel=0.01)
    assert figures["drift_rate"]["high"] < 0.02  # the warming column of the paper: 0.004 px/s
    assert load_config(further).stage == load_config(lab).stage
