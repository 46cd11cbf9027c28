"""A run with a model of further effects: killed, resumed without the model in the command, replayed, diagnosed."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import yaml

from ..waiting import RUN_END_S, logged

Command = Callable[..., tuple[int, str, str]]
PAIRS = 6
"""Wall seconds within which a run, or a part of it, ends on a busy computer; it decides nothing but when a test that hangs is given up."""
EFFECTS = ["magnification_drift", "tilt_with_load", "mains_hum"]
CORRECTED = "magnification_drift, tilt_with_load taken out of the maps"


def write_model(path: Path, **run: float) -> Path:
    values = {"mains_hum": {"frequency_hz": 50.0}}
    laws = [{"family": name, "values": values.get(name, {}), "size_px": 0.1} for name in EFFECTS]
    effects = [{"name": law["family"], "law": law, "parameters": {}} for law in laws]
    found_in = {"end_s": 900.0, "width_px": 320, "height_px": 276, "pixel_size_um": 1.25, **run}
    path.write_text(json.dumps({"version": 1, "effects": effects, "run": found_in}), encoding="utf-8")
    return path


def run_refused(*words: object) -> tuple[int, str, str]:
    """`semlive run` in a process of its own: it changes how its process gets memory."""
    command = [sys.executable, "-m", "semlive", "run", *map(str, words)]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=RUN_END_S, check=False)
    return done.returncode, done.stdout, done.stderr


@pytest.fixture(scope="module")
def done(instrument: Callable[..., Any], wait_until: Callable[..., None], watched: Callable[[Path], Any]) -> Any:
    """A run with a model, killed after its third pair and resumed by a command that does not name the model."""
    one = instrument("modelled")
    one.wait_for_slow_answers()
    one.config["protocol"].update(calibration_shifts_px=[[0, 0], [6, 0], [0, 6], [-6, 0], [0, -6]], loads_n=[600])
    one.model = write_model(one.folder / "model.json")
    process = one.start("--model", str(one.model))
    # Three pairs are accepted and three are to come: analysis may be behind, and would let the run end before it is killed.
    watched(one.log).until(lambda found: len(found.get("/pair", ())) == 3, process, RUN_END_S)
    process.send_signal(signal.SIGKILL)
    process.communicate(timeout=30)
    assert 3 <= len(logged(one.log, "/pair")) < PAIRS
    wait_until(lambda: one.load_frame_status() == 2, RUN_END_S)  # its watchdog: fault
    process = one.start("--resume", "--yes")
    out, err = process.communicate(timeout=RUN_END_S)
    one.end_bench()
    assert process.returncode == 0, out + err
    return one


@pytest.mark.timeout(3 * RUN_END_S)
def test_the_log_names_the_model_both_times(done: Any) -> None:
    runs = logged(done.log, "/run")
    assert len(runs) == 2
    assert runs[0]["config"]["model"] == runs[1]["config"]["model"]
    assert [one["name"] for one in runs[0]["config"]["model"]["effects"]] == EFFECTS
    lines = [one["text"] for one in logged(done.log, "/log")]
    assert sum(one.endswith(f"taken out of them: {', '.join(EFFECTS)}") for one in lines) == 2


@pytest.mark.timeout(3 * RUN_END_S)
@pytest.mark.parametrize("source", ["--from-disparity", "--from-images"])
def test_a_replay_without_the_model_in_its_command_gives_the_live_results(done: Any, source: str, semlive: Command) -> None:
    (live,) = logged(done.log, "/result")
    assert live["pairs"] == PAIRS
    assert any(CORRECTED in one for one in live["warnings"])
    assert "model: mains_hum is not a matter of maps, and is left in" in live["warnings"]
    code, out, err = semlive("replay", done.log, source, "--json")
    assert (code, json.loads(out)) == (0, live), err


@pytest.mark.timeout(3 * RUN_END_S)
def test_maps_in_the_log_are_uncorrected_so_that_another_model_can_be_applied(done: Any, semlive: Command) -> None:
    none = done.folder / "none.json"
    none.write_text(json.dumps({"version": 1, "effects": []}), encoding="utf-8")
    results = []
    for model in (done.model, none):
        code, out, err = semlive("replay", done.log, "--model", model, "--from-disparity", "--json")
        assert code == 0, err
        results.append(json.loads(out))
    assert results[0] == logged(done.log, "/result")[0]
    assert not any("model:" in one for one in results[1]["warnings"])
    assert results[1]["frames"][-1]["strain_mean"] != results[0]["frames"][-1]["strain_mean"]


@pytest.mark.timeout(3 * RUN_END_S)
def test_diagnosis_begins_with_the_model_of_the_run(done: Any, semlive: Command) -> None:
    code, out, err = semlive("diagnose", done.log, "--json", "-o", done.folder / "child.json")
    assert code == 0, err
    child = json.loads((done.folder / "child.json").read_text(encoding="utf-8"))
    assert [one["name"] for one in child["effects"]][: len(EFFECTS)] == EFFECTS
    assert child["parent_sha256"] == logged(done.log, "/run")[0]["config"]["model"]["sha256"]
    assert not set(EFFECTS) & {one["name"] for one in json.loads(out)["effects"]}


@pytest.mark.timeout(3 * RUN_END_S)
def test_plan_names_the_model_and_refuses_one_that_does_not_fit(done: Any, semlive: Command) -> None:
    config = done.write_config()
    timed = done.folder / "timed.yaml"
    timed.write_text(yaml.safe_dump({**done.config, "sem": {**done.config["sem"], "profile": {"frame_time_s": 9.4}}}), encoding="utf-8")
    code, out, err = semlive("plan", timed, "--model", done.model, "--json")
    assert (code, json.loads(out)["model"]) == (0, EFFECTS), err
    small = write_model(done.folder / "x10000.json", pixel_size_um=0.025)
    other = done.folder / "version.json"
    other.write_text(json.dumps({"version": 2, "effects": []}), encoding="utf-8")
    unknown = done.folder / "unknown.json"
    unknown.write_text(done.model.read_text(encoding="utf-8").replace("tilt_with_load", "warp"), encoding="utf-8")
    lacking = done.folder / "lacking.json"
    lacking.write_text(done.model.read_text(encoding="utf-8").replace('"frequency_hz": 50.0', ""), encoding="utf-8")
    wide = write_model(done.folder / "wide.json", width_px=640)
    for command, model, words in (
        (("plan", config), small, "another magnification"),
        (("run", config, "--resume"), other, "has version 2, this program reads version 1"),
        (("plan", config), unknown, "no effect is called warp"),
        (("plan", config), lacking, "mains_hum lacks frequency_hz"),
        (("run", config, "--no-page"), small, "another magnification"),
        (("replay", done.log), small, "another magnification"),
        (("replay", done.log), wide, "frames of 640 x 276 px"),
        (("diagnose", done.log), wide, "frames of 640 x 276 px"),
        (("run", config, "--resume", "--no-page"), wide, "model."),  # not the one that the run began with
    ):
        refused = run_refused if command[0] == "run" else partial(semlive, command[0])
        code, _, err = refused(*command[1:], "--model", model)
        assert (code, words in err.splitlines()[-1]) == (2, True), (command, err)
