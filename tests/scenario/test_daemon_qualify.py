"""An instrument is qualified by one command, and the recommended protocol is executed as it was written."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from semlive.cli.shared.simulated_run import daemon_config
from semlive.cli.shared.simulator import running_simulator
from semlive.service.config.configuration import load_config

from ..waiting import RUN_END_S, logged

RATE, FRAME_S = 20.0, 40.0
# With frames of 4 s a busy computer made the pauses between pairs so long, in frames, that the drift had thousands of knots.
SCENARIO = """
extends: paper_x200
scan: {width_px: 160, height_px: 138, frame_time_s: 40.0}
export: {databar_rows: 30}
detector: {read_noise: 3.0, shot_noise: 0.25}
experiment:
  load_frame: {strain_gage: false}
  protocol: {settle_s: 2, calibration_shifts_px: [[0, 0], [4, 0]], translation_shifts_px: [], loads_n: []}
"""
FRESH = {"stale_after_s": 5.0, "lost_after_s": 30.0}
"""On a busy computer the simulator answers late."""


def in_new_process(*arguments: object) -> str:
    """What a command prints that drives the instrument; it must succeed."""
    done = subprocess.run([sys.executable, "-m", "semlive", *map(str, arguments)], capture_output=True, text=True, timeout=RUN_END_S)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_one_command_qualifies_an_instrument_and_the_protocol_that_it_recommends_is_executed(
    tmp_path: Path, semlive: Callable[..., tuple[int, str, str]]
) -> None:
    def evaluated(*arguments: object) -> Any:
        code, out, err = semlive("qualify", *arguments, "--quick", "--json")
        assert code == 0, out + err
        return json.loads(out)

    scenario, lab, protocol, further = (tmp_path / name for name in ("small.yaml", "lab.yaml", "calibrate.yaml", "next.yaml"))
    scenario.write_text(SCENARIO, encoding="utf-8")
    first, log = (tmp_path / "log" / name for name in ("demo-qualify", "demo-calibrate"))
    with running_simulator(str(scenario), tmp_path / "bench", RATE, triggered=True) as bench:
        config = daemon_config(bench, RATE)
        config["stage"]["settings"]["timeout_s"] = 4.0
        config["sem"]["profile"]["frame_time_s"] = FRAME_S
        config["limits"].update(FRESH)
        config["dic"] = {"subset_px": 25, "step_px": 8, "roi_px": None}
        lab.write_text(yaml.safe_dump(json.loads(json.dumps(config))), encoding="utf-8")
        found: dict[str, Any] = json.loads(in_new_process("qualify", lab, "--run", "--quick", "--json"))
        export = tmp_path / "bench" / "export"
        recommended = evaluated("--from", export, "--config", lab, "--protocol", protocol)
        in_new_process("run", protocol, "--no-page", "--stop-on-fault")
    pairs = logged(first, "/pair")
    warm_up = [pair for pair in pairs if pair["step"]["warm_up"]]
    assert len(pairs) == found["conditions"]["pairs"] == recommended["conditions"]["pairs"]
    assert warm_up
    assert {tuple(pair["step"]["shift_px"]) for pair in warm_up} == {(0.0, 0.0)}
    requests = [item for item in logged(first, "/state") if item["before"] == "warming"]
    assert [item["cause"] for item in requests][:-1] == ["measure_again"] * len(warm_up)
    assert requests[-1]["cause"] in ("warm", "warm_up_ended")
    limit_px_s = 0.02 / FRAME_S
    assert requests[-1]["cause"] == "warm_up_ended" or requests[-1]["guards"]["change_px_s"] < limit_px_s
    shifts = recommended["protocol"]["shifts_px"]
    taken = [pair["step"]["shift_px"] for pair in logged(log, "/pair")]
    assert taken == shifts == [[0.0, 0.0], [4.0, 0.0], [0.0, 4.0]]
    qualified: dict[str, Any] = evaluated("--from", log, "--protocol", further)
    figures = {item["name"]: item for item in qualified["figures"]}
    assert (qualified["conditions"]["pairs"], qualified["conditions"]["dated"]) == (len(taken), True)
    assert qualified["conditions"]["frame_s"] == pytest.approx(FRAME_S, rel=0.01)
    assert figures["drift_rate"]["high"] < 0.02  # the warming column of the paper: 0.004 px/s
    assert load_config(further).stage == load_config(lab).stage
