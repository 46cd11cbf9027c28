"""`semlive simulate`: frames and truth without the daemon."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from semlive_simulators.microscope.render import render_frame
from semlive_simulators.scenario import load_scenario
from semlive_simulators.simulate import main
from semlive_simulators.specimen.specimen import at_rest

SMALL = """
extends: paper_x200
scan: {width_px: 256, height_px: 221, frame_time_s: 23.67}
export: {databar_rows: 30, vendor: VENDOR, clock_offset_s: 7.0, style: rename}
experiment:
  protocol:
    calibration_shifts_px: [[0, 0], [24, -10]]
    translation_shifts_px: [[-14, 21]]
    loads_n: [400, 1800]
"""
COLUMNS = "frame,pair,phase,start_s,dwell_s,row_time_s,width,height,integrations,load_n,shift_x_px,shift_y_px"
GAGED = f"{COLUMNS},gage_strain"


def semlive(*arguments: object) -> tuple[int, str, str]:
    command = [sys.executable, "-m", "semlive", "simulate", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    return done.returncode, done.stdout, done.stderr


def frames(*arguments: object) -> int:
    """The same program without the command around it."""
    return main(["--scenario", str(arguments[0]), *map(str, arguments[1:])])


def scenario_file(folder: Path, vendor: str = "fei") -> Path:
    path = folder / "small.yaml"
    path.write_text(SMALL.replace("VENDOR", vendor))
    return path


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("played")
    code, out, err = semlive(scenario_file(folder), "--out", folder / "out")
    assert (code, err) == (0, "")
    assert out.startswith("10 frames in ")
    return folder / "out"


@pytest.fixture(scope="module")
def truth(played: Path) -> dict[str, Any]:
    return json.loads((played / "truth.json").read_text())


@pytest.fixture(scope="module")
def table(played: Path) -> list[dict[str, str]]:
    text = (played / "frames.csv").read_text()
    assert text.splitlines()[0] == GAGED
    return list(csv.DictReader(text.splitlines()))


def test_each_frame_has_a_file_a_row_and_a_truth(played: Path, truth: dict[str, Any], table: list[dict[str, str]]) -> None:
    names = [f"x200_{number:04d}.tif" for number in range(1, 11)]
    assert sorted(path.name for path in (played / "export").iterdir()) == names
    assert [frame["file"] for frame in truth["frames"]] == names
    assert [int(row["frame"]) for row in table] == list(range(10))
    assert [int(row["pair"]) for row in table] == [number // 2 for number in range(10)]
    assert [row["phase"] for row in table] == ["calibration"] * 4 + ["translation"] * 2 + ["tension"] * 4
    for row, frame in zip(table, truth["frames"], strict=True):
        assert float(row["start_s"]) == pytest.approx((frame["start_time_ns"] - truth["start_time_ns"]) * 1e-9, abs=1e-6)
        assert float(row["row_time_s"]) == frame["row_time_s"]
        assert (row["width"], row["height"], row["integrations"]) == ("256", "221", "1")
        assert not frame["moving"]
    assert truth["clock_stretches"] == 0


def test_it_takes_the_time_that_motion_hold_and_scan_take(truth: dict[str, Any], table: list[dict[str, str]]) -> None:
    start_s = np.array([float(row["start_s"]) for row in table])
    assert np.diff(start_s)[::2] == pytest.approx([24.07] * 5)  # 23.67 s and a gap of 0.4 s
    # Export 2 s, motion, 5 s settled, 30 s hold; a ramp at 50 N/s takes 8 and 28 s and closes slowly, a move 1 to 3 s.
    travel_s = np.diff(start_s)[1::2] - 23.67 - 2.0 - 35.0
    assert (travel_s[:2] > 1.0).all()
    assert (travel_s[:2] < 4.0).all()
    assert travel_s[2] == pytest.approx(400 / 50, abs=8)
    assert travel_s[3] == pytest.approx(1400 / 50, abs=8)
    assert truth["drift"]["time_ns"][-1] * 1e-9 > truth["start_time_ns"] * 1e-9 + start_s[-1] + 23.67


def test_load_and_shift_are_what_was_requested_within_the_machines_errors(truth: dict[str, Any], table: list[dict[str, str]]) -> None:
    for row, frame in zip(table, truth["frames"], strict=True):
        commanded = np.array([float(row["shift_x_px"]), float(row["shift_y_px"])])
        carried = np.array([0.0007, -0.0019]) * frame["load_mean_n"]
        error_px = np.array(frame["stage_px"]) - commanded - carried
        assert np.abs(error_px).max() < 1.5
        if row["phase"] == "tension":
            target_n = 400.0 if int(row["pair"]) == 3 else 1800.0
            assert float(row["load_n"]) == pytest.approx(target_n, abs=12)
            assert float(row["load_n"]) == pytest.approx(frame["load_mean_n"], abs=1)
        else:
            assert row["load_n"] == ""
    assert any(np.abs(np.array(frame["stage_px"]) - np.round(frame["stage_px"])).max() > 0.05 for frame in truth["frames"])


def test_the_strain_gage_is_reported_with_its_own_errors(truth: dict[str, Any], table: list[dict[str, str]]) -> None:
    for row, frame in zip(table, truth["frames"], strict=True):
        # Factor 1.005, offset 4e-6, and noise of 1.5e-6 over the root of 24 readings; the load changes by less than 1 N meanwhile.
        assert float(row["gage_strain"]) == pytest.approx(1.005 * frame["strain"]["eyy"] + 4e-6, abs=3e-6)
    assert float(table[-1]["gage_strain"]) > 2e-3
    assert len({row["gage_strain"] for row in table}) == len(table)


def test_an_experiment_without_a_gage_has_no_column_for_it(tmp_path: Path) -> None:
    path = scenario_file(tmp_path)
    path.write_text(path.read_text() + "  load_frame: {strain_gage: false}\n")
    assert frames(path, "--out", tmp_path / "out", "--frames", "0") == 0
    assert (tmp_path / "out" / "frames.csv").read_text().splitlines()[0] == COLUMNS


def test_the_truth_alone_reproduces_the_frames(played: Path, truth: dict[str, Any]) -> None:
    scenario = load_scenario(str(played.parent / "small.yaml"))
    for number in (3, 9):
        frame = truth["frames"][number]
        begin_s = (frame["start_time_ns"] - truth["start_time_ns"]) * 1e-9
        rendered = render_frame(scenario, begin_s, at_rest(frame["stage_px"], frame["gradient"]), frame=number)
        exported = tifffile.imread(played / "export" / frame["file"])[:221]
        difference = np.abs(rendered.astype(int) - exported.astype(int))
        assert difference.max() <= 1  # relaxation within the frame, below 1 N
        assert difference.mean() < 0.05


def contents(folder: Path) -> dict[str, tuple[bytes, int]]:
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): (path.read_bytes(), path.stat().st_mtime_ns) for path in files}


def test_the_same_seed_gives_the_same_bytes_and_another_does_not(played: Path, tmp_path: Path) -> None:
    path = scenario_file(tmp_path)
    assert frames(path, "--out", tmp_path / "again") == 0
    first, again = contents(played), contents(tmp_path / "again")
    assert {name: data for name, (data, _) in first.items()} == {name: data for name, (data, _) in again.items()}
    assert {name: ns for name, (_, ns) in first.items() if "/" in name} == {name: ns for name, (_, ns) in again.items() if "/" in name}
    assert frames(path, "--out", tmp_path / "other", "--seed", 5, "--frames", "0,1") == 0
    other = contents(tmp_path / "other")
    assert len(other) == 4
    assert all(other[name][0] != first[name][0] for name in other)


def test_selected_frames_equal_those_of_the_complete_experiment(played: Path, tmp_path: Path) -> None:
    code, out, err = semlive(scenario_file(tmp_path), "--out", tmp_path / "some", "--frames", "3,8-9", "--json")
    assert code == 0, err
    assert json.loads(out) == {
        "frames": 3,
        "export": str(tmp_path / "some" / "export"),
        "truth": str(tmp_path / "some" / "truth.json"),
        "table": str(tmp_path / "some" / "frames.csv"),
    }
    whole, some = contents(played / "export"), contents(tmp_path / "some" / "export")
    assert sorted(some) == ["x200_0004.tif", "x200_0009.tif", "x200_0010.tif"]
    assert all(whole[name] == some[name] for name in some)
    rows = (played / "frames.csv").read_text().splitlines()
    assert (tmp_path / "some" / "frames.csv").read_text().splitlines() == [rows[0], rows[4], rows[9], rows[10]]


def test_another_vendors_files_and_sidecars(tmp_path: Path) -> None:
    assert frames(scenario_file(tmp_path, "jeol"), "--out", tmp_path / "out", "--frames", "2") == 0
    assert sorted(path.name for path in (tmp_path / "out" / "export").iterdir()) == ["x200_0003.tif", "x200_0003.txt"]


def test_shifts_by_the_beam_are_quick_and_crooked(tmp_path: Path) -> None:
    path = scenario_file(tmp_path)
    path.write_text(path.read_text() + "shifts_by: beam_shift\n")
    assert frames(path, "--out", tmp_path / "out", "--frames", "2") == 0
    [frame] = json.loads((tmp_path / "out" / "truth.json").read_text())["frames"]
    x_px, y_px = 1.03 * 24 + 0.96 * np.sin(0.035) * -10, 0.96 * np.cos(0.035) * -10
    assert frame["stage_px"] == pytest.approx([x_px, y_px], abs=0.02)


def test_a_planned_emergency_stop_ends_the_experiment_with_one_message(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = scenario_file(tmp_path)
    path.write_text(path.read_text() + "faults: [{at_s: 345.0, what: emergency_stop, lasts_s: 10.0}]\n")
    assert frames(path, "--out", tmp_path / "out", "--frames", "0,7") == 2
    printed = capsys.readouterr().err
    assert "a load of 1800 N ends in a fault" in printed  # pressed while a frame at 400 N was scanned
    assert printed.count("\n") == 1


@pytest.mark.parametrize(
    ("scenario", "options", "says"),
    [
        ("nowhere", [], "nowhere does not exist"),
        ("short", ["--frames", "3-1"], "write it as 0-3,8"),
        ("short", ["--frames", "18"], "frames 0-17"),
    ],
)
def test_bad_input_gives_one_error_line_and_exit_code_2(tmp_path: Path, scenario: str, options: list[str], says: str) -> None:
    code, out, err = semlive(scenario, "--out", tmp_path / "out", *options)
    assert (code, out) == (2, "")
    assert not (tmp_path / "out").exists()
    assert says in err
    assert err.count("\n") == 1


def test_a_folder_in_use_is_not_changed(tmp_path: Path) -> None:
    (tmp_path / "precious.txt").write_text("data")
    code, _, err = semlive("short", "--out", tmp_path)
    assert code == 2
    assert "is not empty" in err
    assert [path.name for path in tmp_path.iterdir()] == ["precious.txt"]


@pytest.mark.parametrize("name", ["paper_x200", "paper_x10000"])
def test_the_papers_scenarios_give_the_same_bytes_again(tmp_path: Path, name: str) -> None:
    path = tmp_path / "fewer_pixels.yaml"
    stops = "experiment: {protocol: {calibration_shifts_px: [[0, 0], [8, 0]], translation_shifts_px: [], loads_n: []}}"
    path.write_text(f"extends: {name}\nscan: {{width_px: 160, height_px: 138}}\nexport: {{databar_rows: 30}}\n{stops}\n")
    for folder in ("one", "two"):
        assert frames(path, "--out", tmp_path / folder, "--frames", "0,3") == 0
    item, two = contents(tmp_path / "one"), contents(tmp_path / "two")
    assert len(item) == 4
    assert {file: data for file, (data, _) in item.items()} == {file: data for file, (data, _) in two.items()}
    assert frames(path, "--out", tmp_path / "other", "--frames", "0,3", "--seed", "99") == 0
    other = contents(tmp_path / "other")
    assert all(other[file][0] != item[file][0] for file in item if file != "frames.csv")


def test_a_frame_that_takes_longer_than_its_header_reports_is_played_so(tmp_path: Path) -> None:
    path = scenario_file(tmp_path)
    path.write_text(path.read_text() + "effects: {wrong_row_time: {row_time_error: 0.1}}\n")
    assert frames(path, "--out", tmp_path / "out", "--frames", "0,1") == 0
    rows = list(csv.DictReader((tmp_path / "out" / "frames.csv").read_text().splitlines()))
    assert float(rows[1]["start_s"]) - float(rows[0]["start_s"]) == pytest.approx(1.1 * 23.67 + 0.4)
    assert float(rows[0]["row_time_s"]) == pytest.approx(23.67 / 221)  # as in the header
