"""The bench as a process: what it writes, how it ends."""

from __future__ import annotations

import contextlib
import hashlib
import json
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from pymodbus.client import ModbusSerialClient, ModbusTcpClient

from semlive.formats.tables.clock_file import decode_clock
from semlive_simulators.load_frame.registers import f32
from semlive_simulators.microscope.render import render_frame
from semlive_simulators.scenario import load_scenario
from semlive_simulators.specimen.specimen import at_rest

from ..waiting import wait_until

SMALL = """
extends: paper_x200
scan: {width_px: 256, height_px: 221, frame_time_s: 6.63}
export: {databar_rows: 30}
"""
RATE = "20"


def start(folder: Path, *options: str, stdin: int | None = subprocess.DEVNULL) -> subprocess.Popen[bytes]:
    scenario = folder / "small.yaml"
    scenario.write_text(SMALL)
    command = [sys.executable, "-m", "semlive_simulators.bench", "--scenario", str(scenario), "--out", str(folder / "out"), "--rate", RATE]
    process = subprocess.Popen([*command, *options], stdin=stdin, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    wait_until(lambda: (folder / "out" / "ready.json").exists() or process.poll() is not None)
    return process


def ready(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "out" / "ready.json").read_text())


def truth(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "out" / "truth.json").read_text())


def rested(folder: Path) -> int | None:
    """The first frame at rest after one during which the machine moved."""
    moving = [frame["moving"] for frame in truth(folder)["frames"]]
    return next((number for number in range(1, len(moving)) if not moving[number] and any(moving[:number])), None)


def ended(process: subprocess.Popen[bytes], how: int | None) -> tuple[int, str, str]:
    if how is not None:
        process.send_signal(how)
    out, err = process.communicate(timeout=150)
    return process.returncode, out.decode(), err.decode()


def test_frames_and_truth_of_a_run_agree(tmp_path: Path) -> None:
    process = start(tmp_path)
    printed = ready(tmp_path)
    assert printed["host"] == "127.0.0.1"
    assert printed["pixel_size_m"] == 1.25e-6
    assert (printed["mode"], printed["scenario"]) == ("continuous", "small")
    assert printed["experiment"]["protocol"]["hold_s"] == 30
    clock = decode_clock(Path(printed["clock_file"]).read_bytes())
    assert clock.rate == 20.0
    assert abs(clock.time_ns(time.monotonic_ns()) - time.time_ns()) < 600e9
    client = ModbusTcpClient(printed["host"], port=printed["port"], timeout=20, retries=0)
    assert client.connect()
    client.write_registers(0, [*f32(600.0), *f32(100.0), 1, 1, 0, 0], device_id=printed["unit"])
    client.write_registers(100, [*f32(25.0), *f32(0.0), 1, 1], device_id=printed["unit"])
    wait_until(lambda: len(truth(tmp_path)["frames"]) >= 5 and rested(tmp_path) is not None)
    client.close()
    code, out, _ = ended(process, signal.SIGTERM)
    assert (code, out) == (0, "")
    whole = truth(tmp_path)
    names = [frame["file"] for frame in whole["frames"]]
    assert names == [f"x200_{number:04d}.tif" for number in range(1, len(names) + 1)]
    assert sorted(path.name for path in Path(printed["export_folder"]).glob("*")) == names
    last = whole["frames"][-1]
    assert not last["moving"]
    assert last["load_mean_n"] == pytest.approx(599, abs=3)
    assert last["strain"]["eyy"] == pytest.approx(last["load_mean_n"] / 711_000, rel=1e-3)
    assert last["strain"]["exx"] == pytest.approx(-0.33 * last["strain"]["eyy"])
    assert last["stage_px"][0] == pytest.approx(20 + 600 * 0.0007, abs=1.5)
    starts = np.array([frame["start_time_ns"] for frame in whole["frames"]])
    assert np.diff(starts).tolist() == [7_030_000_000] * (len(starts) - 1)  # 6.63 s and a gap of 0.4 s
    drift = whole["drift"]
    assert set(np.diff(drift["time_ns"]).tolist()) == {5_000_000_000}
    assert drift["time_ns"][0] <= starts[0]
    assert drift["time_ns"][-1] >= starts[-1] + 6_630_000_000
    assert np.array(whole["distortion"]["ex_px"]).shape == (len(whole["distortion"]["y_px"]), len(whole["distortion"]["x_px"]))
    assert whole["distortion"]["x_px"][-1] == 255
    for frame, path in zip(whole["frames"], sorted(Path(printed["export_folder"]).glob("*.tif")), strict=True):
        assert tifffile.imread(path).shape == (251, 256)
        end_ns = frame["start_time_ns"] + 6_630_000_000
        assert 1.9e9 < path.stat().st_mtime_ns - end_ns < 2.1e9


def test_the_truth_alone_reproduces_a_frame(tmp_path: Path) -> None:
    process = start(tmp_path)
    printed = ready(tmp_path)
    client = ModbusTcpClient(printed["host"], port=printed["port"], timeout=20, retries=0)
    assert client.connect()
    client.write_registers(0, [*f32(1500.0), *f32(100.0), 1, 1, 0, 0], device_id=printed["unit"])
    client.write_registers(100, [*f32(-30.0), *f32(17.0), 1, 1], device_id=printed["unit"])
    wait_until(lambda: rested(tmp_path) is not None)
    client.close()
    assert ended(process, signal.SIGTERM)[0] == 0
    whole = truth(tmp_path)
    number = rested(tmp_path)
    assert number is not None
    frame = whole["frames"][number]
    assert abs(frame["stage_px"][0] + 24) < 2
    scenario = load_scenario(str(tmp_path / "small.yaml"))
    begin_s = (frame["start_time_ns"] - whole["start_time_ns"]) * 1e-9
    rendered = render_frame(scenario, begin_s, at_rest(frame["stage_px"], frame["gradient"]), frame=number)
    exported = tifffile.imread(Path(printed["export_folder"]) / frame["file"])[:221]
    difference = np.abs(rendered.astype(int) - exported.astype(int))
    # Relaxation within the frame, below 1 N, moves the picture by up to 0.002 px: a grey level here and there.
    assert difference.max() <= 1
    assert difference.mean() < 0.05


def test_the_same_seed_scans_the_same_pixels(tmp_path: Path) -> None:
    hashes: dict[str, str] = {}
    for name, seed in (("a", "5"), ("b", "5"), ("c", "6")):
        folder = tmp_path / name
        folder.mkdir()
        process = start(folder, "--seed", seed)
        wait_until(lambda folder=folder: bool(truth(folder)["frames"]))
        assert ended(process, signal.SIGINT)[0] == 0
        pixels = tifffile.imread(folder / "out" / "export" / "x200_0001.tif")[:221]
        hashes[name] = hashlib.sha256(pixels.tobytes()).hexdigest()
        assert truth(folder)["seed"] == int(seed)
    assert hashes["a"] == hashes["b"] != hashes["c"]


def test_serial_lines_are_announced_and_belong_to_the_same_machine(tmp_path: Path) -> None:
    process = start(tmp_path, "--rtu", "--serial")
    printed = ready(tmp_path)
    client = ModbusSerialClient(printed["rtu_port"], baudrate=19_200, timeout=20, retries=0)
    assert client.connect()
    assert client.read_input_registers(0, count=2, device_id=printed["unit"]).registers == [0x5E31, 1]
    with open(printed["serial_port"], "r+b", buffering=0) as line:
        line.write(b"u")
        wait_until(lambda: client.read_input_registers(3, count=1, device_id=printed["unit"]).registers == [1])
        line.write(b"s")
        wait_until(lambda: client.read_input_registers(3, count=1, device_id=printed["unit"]).registers == [0])
    client.close()
    code, _, err = ended(process, signal.SIGTERM)
    assert (code, err) == (0, "")


def test_it_chooses_a_rate_and_the_end_of_standard_input_ends_it(tmp_path: Path) -> None:
    process = start(tmp_path, "--rate", "auto", "--exit-with-stdin", stdin=subprocess.PIPE)
    printed = ready(tmp_path)
    assert printed["rate"] == decode_clock(Path(printed["clock_file"]).read_bytes()).rate
    assert 0 < printed["rate"] <= 40
    assert printed["shifts_by"] == "stage"
    time.sleep(0.2)
    assert process.poll() is None
    code, _, err = ended(process, None)  # communicate closes its input
    assert code == 0, err
    assert truth(tmp_path)["version"] == 1


def test_a_file_is_half_written_for_a_moment(tmp_path: Path) -> None:
    process = start(tmp_path)
    folder = tmp_path / "out" / "export"
    sizes: dict[str, list[int]] = {}

    def caught() -> bool:
        """One of the files half-written: a moment is 75 ms, in which a busy computer may not look."""
        done = [frame["file"] for frame in truth(tmp_path)["frames"]]
        for path in folder.iterdir():
            sizes.setdefault(path.name, []).append(path.stat().st_size)
        return any(min(sizes[name]) < max(sizes[name]) for name in done)

    wait_until(caught)
    assert ended(process, signal.SIGTERM)[0] == 0
    assert all(observed == sorted(observed) for observed in sizes.values())
    for frame in truth(tmp_path)["frames"][:-1]:
        assert max(sizes[frame["file"]]) <= (folder / frame["file"]).stat().st_size


def test_renaming_shows_the_final_name_only_for_a_complete_file(tmp_path: Path) -> None:
    scenario = tmp_path / "renaming.yaml"
    scenario.write_text(SMALL.replace("export: {", "export: {style: rename, "))
    process = start(tmp_path, "--scenario", str(scenario))
    folder = tmp_path / "out" / "export"
    observed: set[str] = set()
    sizes: dict[str, set[int]] = {}

    def complete() -> bool:
        """Both kinds of names were seen: a file is written in 75 ms, in which a busy computer may not look."""
        for path in folder.glob("*"):
            with contextlib.suppress(FileNotFoundError):  # renamed since
                size = path.stat().st_size
                observed.add(path.suffix)
                if path.suffix == ".tif":
                    sizes.setdefault(path.name, set()).add(size)
        return {".tmp", ".tif"} <= observed

    wait_until(complete)
    assert ended(process, signal.SIGTERM)[0] == 0
    assert observed == {".tmp", ".tif"}
    assert {name: {(folder / name).stat().st_size} for name in sizes} == sizes


def test_a_stalled_process_stretches_the_clock_and_reports_so(tmp_path: Path) -> None:
    process = start(tmp_path)
    clock_file = tmp_path / "out" / "clock.json"
    process.send_signal(signal.SIGSTOP)
    time.sleep(0.5)  # 10 s of experiment time
    process.send_signal(signal.SIGCONT)
    wait_until(lambda: decode_clock(clock_file.read_bytes()).revision > 0)
    wait_until(lambda: len(truth(tmp_path)["frames"]) >= 3)
    code, _, err = ended(process, signal.SIGTERM)
    assert code == 0
    assert "clock stretched" in err
    whole = truth(tmp_path)
    assert whole["clock_stretches"] >= 1
    assert whole["worst_lag_s"] > 5
    assert set(np.diff([frame["start_time_ns"] for frame in whole["frames"]]).tolist()) == {7_030_000_000}


@pytest.mark.parametrize(("options", "says"), [(["--scenario", "nowhere"], "nowhere does not exist"), (["--rate", "-1"], "rate")])
def test_bad_input_gives_one_error_line_and_exit_code_2(tmp_path: Path, options: list[str], says: str) -> None:
    code, _, err = ended(start(tmp_path, *options), None)
    assert code == 2
    assert says in err
    assert err.count("\n") == 1


def test_a_port_in_use_gives_one_error_line_and_exit_code_2(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        code, _, err = ended(start(tmp_path, "--port", str(taken.getsockname()[1])), None)
    assert code == 2
    assert "choose another --port" in err
    assert err.count("\n") == 1
