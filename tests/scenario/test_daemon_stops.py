"""Ctrl-C, a dead analysis, a lost link, an unreadable image: the frame stops, the log is complete, and one message has the reason."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader

from semlive.cli.shared.simulator import running_simulator

from ..waiting import RUN_END_S, logged

STARTS_S = 150.0
"""Wall seconds within which a run gets to the state that is waited for."""


def reached(found: dict[str, list[dict[str, Any]]], state: str) -> bool:
    return any(one["after"] == state for one in found.get("/state", ()))


def finish(process: subprocess.Popen[str]) -> tuple[int, str]:
    out, err = process.communicate(timeout=RUN_END_S)
    return process.returncode, out + err


@pytest.mark.parametrize("state", ["connecting", "ready", "ramping", "settling", "holding", "imaging"])
def test_ctrl_c_stops_the_frame_and_finishes_the_log(
    instrument: Callable[..., Any], wait_until: Callable[..., None], watched: Callable[[Path], Any], state: str
) -> None:
    one = instrument(f"ctrl-c-{state}")
    one.wait_for_slow_answers()
    # The load first, so that the early states are those of a frame that moves; more steps, so that the run is not over too soon.
    one.config["protocol"].update(calibration_shifts_px=[], loads_n=[600.0, 620.0, 640.0, 660.0], ramp_rate_n_s=20.0)
    one.config["limits"]["force_step_max_n"] = 1000.0
    process = one.start()
    watched(one.log).until(lambda found: reached(found, state), process, STARTS_S)
    process.send_signal(signal.SIGINT)
    code, printed = finish(process)
    assert code == 1, printed
    assert "Traceback" not in printed
    wait_until(one.load_frame_at_rest, 2.0)
    (segment,) = one.log.glob("*.mcap")
    with segment.open("rb") as stream:
        last = [json.loads(message.data) for _, _, message in make_reader(stream).iter_messages(topics=["/state"])][-1]
    assert last["after"] == "aborted"
    assert not list(one.log.glob("*.part"))


@pytest.mark.parametrize("after_s", [0.1, 0.5, 1.0, 2.0])
def test_ctrl_c_while_starting_prints_no_traceback(instrument: Callable[..., Any], after_s: float) -> None:
    one = instrument(f"early-{after_s}")
    process = one.start()
    time.sleep(after_s)
    process.send_signal(signal.SIGINT)
    code, printed = finish(process)
    assert code in (1, -signal.SIGINT), printed
    # On a busy computer Python may not have come to a line of ours yet; then it answers itself, with files of its own.
    of_ours = [line for line in printed.splitlines() if 'File "' in line and '"<frozen ' not in line]
    assert "Traceback" not in printed or not of_ours, printed
    assert one.load_frame_at_rest()
    assert not list(one.log.glob("*.part"))


INTERRUPTED = """
import signal, sys

where, config = sys.argv[1:]
module, function = where.split(".")

def look(frame, event, _):
    if event == "call" and frame.f_code.co_name == function and frame.f_code.co_filename.endswith(module + ".py"):
        sys.setprofile(None)
        signal.raise_signal(signal.SIGINT)

import semlive.cli.during_run.run  # first: what is imported under the eyes of `look` takes three times as long

from semlive.cli.main import main

sys.argv = ["semlive", "run", config, "--no-page"]
sys.setprofile(look)
main()
"""


@pytest.mark.parametrize(
    "where",
    [
        *("daemon.run", "run_folder.open_clock", "run_folder.open_log", "daemon._experiment", "daemon._open_socket"),
        *("devices.open_links", "protocol_loop.run"),
    ],
)
def test_ctrl_c_takes_effect_at_every_stage_of_starting(instrument: Callable[..., Any], where: str) -> None:
    """Between the handler and the run's control there was no receiver, and the run continued to its end."""
    one = instrument(f"starting-{where}")
    command = [sys.executable, "-c", INTERRUPTED, where, str(one.write_config())]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    code, printed = finish(process)
    assert code == 1, printed
    assert "Traceback" not in printed
    assert not logged(one.log, "/pair")
    assert {transition["after"] for transition in logged(one.log, "/state")} <= {"connecting", "stopping", "aborted"}
    assert one.load_frame_at_rest()
    assert not list(one.log.glob("*.part"))


def test_a_killed_analysis_is_started_again_and_loses_nothing(instrument: Callable[..., Any], watched: Callable[[Path], Any]) -> None:
    one = instrument("killed-analysis")
    one.wait_for_slow_answers()
    process = one.start()
    watched(one.log).until(lambda found: len(found.get("/pair", ())) == 2, process, STARTS_S)
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    assert len(children) == 1
    os.kill(int(children[0]), signal.SIGKILL)
    code, printed = finish(process)
    assert code == 0, printed
    assert "the analysis process died" in " ".join(printed.split())
    (result,) = logged(one.log, "/result")
    assert result["pairs"] == 5
    maps = [(one["reference"], one["current"]) for one in logged(one.log, "/dic/summary")]
    assert len(maps) == len(set(maps)) == 13
    exports = [scan["export"] for scan in logged(one.log, "/sem/scan")]
    assert exports == sorted(set(exports))


def test_an_unreadable_image_is_refused_by_name_and_the_run_continues(
    instrument: Callable[..., Any], watched: Callable[[Path], Any]
) -> None:
    one = instrument("unreadable")
    one.wait_for_slow_answers()
    # A hold of 5 s: what comes when it is seen is looked at before the run ends.
    one.config["protocol"].update(calibration_shifts_px=[[0, 0]], loads_n=[], hold_s=100.0)
    process = one.start()
    watched(one.log).until(lambda found: reached(found, "holding"), process, STARTS_S)
    # An image of another source: complete, but without any scan timing.
    shape = (64, 64)
    png = cv2.imencode(".png", np.random.default_rng(1).integers(0, 255, shape, dtype=np.uint8))[1].tobytes()
    (Path(one.bench["export_folder"]) / "strange.png").write_bytes(png)
    code, printed = finish(process)
    assert code == 0, printed
    assert "strange.png" in printed
    refused = [file for file in logged(one.log, "/sem/file") if file["name"] == "strange.png" and file["decision"] == "refused"]
    assert len(refused) == 1
    assert "dwell" in refused[0]["reason"]


def test_a_load_beyond_the_limits_is_refused_before_anything_moves(instrument: Callable[..., Any]) -> None:
    one = instrument("beyond")
    one.config["protocol"]["loads_n"] = [100.0, 9000.0]
    code, printed = one.run()
    assert code == 2, printed
    assert "9000" in printed
    assert "Traceback" not in printed
    assert not logged(one.log, "/command")


def test_a_lost_bench_ends_the_run_with_one_message(tmp_path: Path, instrument: Callable[..., Any], watched: Callable[[Path], Any]) -> None:
    one = instrument("lost")
    scenario = one.folder.parent / "small.yaml"
    with running_simulator(str(scenario), tmp_path / "bench", 20.0) as bench:
        for section in ("load_frame", "stage"):
            one.config[section]["settings"]["port"] = bench["port"]
        one.config["sem"]["folder"] = bench["export_folder"]
        one.config["run"]["clock_file"] = bench["clock_file"]
        process = one.start()
        watched(one.log).until(lambda found: reached(found, "holding"), process, STARTS_S)
    code, printed = finish(process)
    assert code == 1
    assert "Traceback" not in printed
    assert any(state["after"] == "fault" for state in logged(one.log, "/state"))
    assert logged(one.log, "/fault")
