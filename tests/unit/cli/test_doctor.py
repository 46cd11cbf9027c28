"""`semlive doctor` finds what is wrong, names the remedy, and changes nothing."""

from __future__ import annotations

import json
import socket
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
import yaml
from scipy import ndimage
from typer.testing import CliRunner

from semlive.cli.app import app
from semlive.data.checks import Verdict
from semlive.errors import SemliveError
from semlive.service.checks import computer, instrument
from semlive.service.runtime.jit_cache import VARIABLE, configure_jit_cache

LIMITS = {
    "force_min_n": 0, "force_max_n": 100, "extension_min_mm": 0, "extension_max_mm": 1,
    "force_rate_max_n_s": 1, "force_step_max_n": 10, "stage_travel_um": 1,
}  # fmt: skip


def config(folder: Path, **changes: Any) -> Path:
    """A configuration whose export folder exists."""
    (folder / "export").mkdir()
    given = {
        "run": {"folder": "log"},
        "sem": {"folder": "export", "pixel_size_um": 1.0},
        "stage": {"driver": "null"},
        "limits": LIMITS,
        "protocol": {"calibration_shifts_px": [[0, 0], [8, 0]]},
    }
    path = folder / "run.yaml"
    path.write_text(yaml.safe_dump({**given, **changes}), encoding="utf-8")
    return path


def doctor_report(path: Path) -> tuple[dict[str, dict[str, str]], Any]:
    done = CliRunner().invoke(app, ["doctor", str(path), "--json"])
    return {item["what"]: item for item in json.loads(done.stdout)["findings"]}, done


def test_a_healthy_setup_passes_and_no_file_remains(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        frame = {"driver": "modbus", "settings": {"host": "127.0.0.1", "port": server.getsockname()[1]}}
        findings, done = doctor_report(config(tmp_path, load_frame=frame))
    assert findings["load_frame"]["verdict"] == "good"
    assert {"processor", "JIT cache", "clock", "time service", "disk", "log folder", "drivers", "export folder"} <= set(findings)
    assert "the run may need 0.1 GB" in findings["disk"]["said"]  # two pairs
    assert done.exit_code == 0, done.output
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["export", "run.yaml"]


def test_what_is_wrong_is_reported_with_what_to_do(tmp_path: Path) -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        port = unused.getsockname()[1]
        parts = {"cell": {"serial": {"port": str(tmp_path / "ttyNone")}}, "drive": {"host": "127.0.0.1", "port": port}}
        path = config(tmp_path, load_frame={"driver": "assembled", "settings": parts}, stage={"driver": "teleport"})
        (tmp_path / "export").rmdir()
        _, done = doctor_report(path)
    bad = [item for item in json.loads(done.stdout)["findings"] if item["verdict"] == "bad"]
    assert len(bad) == 4, bad
    assert all(item["advice"] for item in bad)
    assert isinstance(done.exception, SemliveError)
    assert "4 of" in str(done.exception)


def test_ends_are_found_however_deep() -> None:
    settings = {"cell": {"host": "a", "port": 1}, "drive": {"link": {"serial": {"port": "COM3"}}}, "host": "b", "gage": {"host": "b"}}
    assert list(instrument.endpoints_in(settings)) == [("b", 502, 1), ("a", 1, 1), "COM3"]


def test_a_share_is_recognised_by_its_mount(tmp_path: Path) -> None:
    mounts = tmp_path / "mounts"
    mounts.write_text(f"/dev/sda1 / ext4 rw 0 0\n//sem/export {tmp_path}/sem cifs rw 0 0\n", encoding="utf-8")
    assert instrument.file_system(tmp_path / "sem" / "today", mounts) == "cifs"
    assert instrument.file_system(tmp_path / "semantics", mounts) == "ext4"
    assert instrument.file_system(tmp_path, tmp_path / "absent") == ""


def test_a_full_disk_is_bad(tmp_path: Path) -> None:
    room, stored = computer.disk(tmp_path / "not" / "yet", 10**18)
    assert (room.verdict, stored.verdict) == (Verdict.FAILED, Verdict.OK)
    assert "run.folder" in room.advice


def test_a_log_folder_that_cannot_be_written_is_bad(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert computer.disk(tmp_path / "file", None)[1].verdict is Verdict.FAILED


def test_kernels_are_cached_next_to_the_package_where_it_is_writable(tmp_path: Path) -> None:
    environ: dict[str, str] = {}
    assert configure_jit_cache(environ, tmp_path) == tmp_path / "__pycache__"
    assert environ == {}


@pytest.mark.parametrize("variable", ["CACHE_DIRECTORY", "XDG_CACHE_HOME", "HOME"])
def test_a_read_only_installation_keeps_them_elsewhere(tmp_path: Path, variable: str) -> None:
    (tmp_path / "file").touch()  # no folder can be made below it, by nobody
    environ = {"CACHE_DIRECTORY": str(tmp_path / "file"), variable: str(tmp_path / "own")}
    chosen = configure_jit_cache(environ, tmp_path / "file")
    assert chosen.is_relative_to(tmp_path / "own")
    assert environ[VARIABLE] == str(chosen)


def test_what_the_user_reports_of_the_cache_holds(tmp_path: Path) -> None:
    environ = {VARIABLE: str(tmp_path / "mine")}
    assert configure_jit_cache(environ, tmp_path) == tmp_path / "mine"


def test_without_a_cache_folder_kernels_are_cached_until_the_next_boot(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    environ = {"HOME": str(tmp_path / "file")}
    chosen = configure_jit_cache(environ, tmp_path / "file")
    assert chosen.is_dir()
    chosen.rmdir()


@pytest.mark.parametrize(("contrast", "verdict", "method"), [(40.0, "good", "subset"), (1.5, "open", "global")])
def test_a_test_frame_is_judged_without_a_configuration(tmp_path: Path, contrast: float, verdict: str, method: str) -> None:
    rng = np.random.default_rng(5)
    speckle = ndimage.gaussian_filter(rng.standard_normal((240, 260)), 2.0)
    image = np.clip(128 + contrast * speckle / speckle.std() + 3.0 * rng.standard_normal(speckle.shape), 0, 255).astype(np.uint8)
    tifffile.imwrite(tmp_path / "frame.tif", image)
    done = CliRunner().invoke(app, ["doctor", "--test-frame", str(tmp_path / "frame.tif"), "--json"])
    printed = json.loads(done.stdout)
    finding = next(item for item in printed["findings"] if item["what"] == "pattern")
    assert finding["verdict"] == verdict
    assert finding["said"].startswith(f"method {method}, subset ")
    assert ("global method" in finding["advice"]) == (method == "global")
    assert printed["recommended"]["method"] == method
    shown = CliRunner().invoke(app, ["doctor", "--test-frame", str(tmp_path / "frame.tif")])
    assert "pattern" in shown.stdout


def test_a_test_frame_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["doctor", "--test-frame", str(tmp_path / "none.tif")])
    assert "cannot be read" in str(done.exception)


def with_load_file(folder: Path, text: str) -> Path:
    load_file = {"file": str(folder / "load.csv"), "force": {"column": "Force"}, "extension": {"column": "Ext"}}
    settings = {"program": "MICROTEST", "arrived_n": 3, "load_file": load_file}
    path = config(folder, load_frame={"driver": "operator", "settings": settings})
    (folder / "load.csv").write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("text", "verdict", "observation"),
    [
        ("Time;Force (kN);Ext (mm)\n0,1;0,1342;0,5\n", "good", "the newest line is force 134.2 N, extension 0.5 mm"),
        ("Time,Force,Ext\n1,WRONG,2\n", "bad", "holds 'WRONG' in column Force, which is no reading"),
        ("Time,Force,Ext\n12,4,134,2,0,5\n", "bad", "the numbers seem to have decimal commas"),
        ("Time,Force,Ext\n", "open", "no line of numbers yet"),
    ],
)
def test_the_load_file_is_read_as_in_a_run(tmp_path: Path, text: str, verdict: str, observation: str) -> None:
    findings, done = doctor_report(with_load_file(tmp_path, text))
    assert findings["load_file"]["verdict"] == verdict
    assert observation in findings["load_file"]["said"]
    assert (done.exit_code == 0) is (verdict != "bad")


def test_a_part_that_is_a_file_is_read_as_in_a_run(tmp_path: Path) -> None:
    cell = {"protocol": "csv", "file": str(tmp_path / "load.csv"), "force": {"column": "Force"}}
    findings, _ = doctor_report(config(tmp_path, load_frame={"driver": "assembled", "settings": {"cell": cell}}))
    assert findings["cell"]["verdict"] == "bad"
    assert "there is no such file" in findings["cell"]["said"]


def test_files_that_a_run_does_not_take_are_named(tmp_path: Path) -> None:
    path = config(tmp_path)
    export = tmp_path / "export"
    (export / "2026-11-26").mkdir()
    for name in ("a_001.jpg", "a_003.jpg", "a_002.bmp", "2026-11-26/s_001.tif", "a.txt"):
        (export / name).write_bytes(b"x" * 1000)
    done = CliRunner().invoke(app, ["doctor", str(path), "--json"])
    findings = json.loads(done.stdout)["findings"]
    [folder] = [one for one in findings if one["what"] == "export folder"]
    assert "0 images that a run would take" in folder["said"]
    untaken = [one["said"] for one in findings if one["what"] == "not taken"]
    assert untaken == ["1 .bmp (a_002.bmp)", "2 .jpg (a_001.jpg)", "1 folder with images (2026-11-26/s_001.tif)"]
    assert done.exit_code == 0


@pytest.mark.parametrize(("profile", "verdict"), [({}, "open"), ({"dwell_time_s": 1e-6, "row_time_s": 1e-3, "pixel_size_m": 1e-6}, "good")])
def test_the_newest_image_is_inspected_as_in_a_run(tmp_path: Path, profile: dict[str, float], verdict: str) -> None:
    path = config(tmp_path, sem={"folder": "export", "pixel_size_um": 1.0, "profile": profile})
    tifffile.imwrite(tmp_path / "export" / "a.tif", np.random.default_rng(1).integers(0, 255, (88, 102), dtype=np.uint8))
    findings, _ = doctor_report(path)
    assert findings["newest image"]["verdict"] == verdict
    assert ("does not contain its dwell time" in findings["newest image"]["said"]) is (verdict == "open")
