"""`semlive inspect` as other programs call it: one JSON object, one table, one line for bad input."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from semlive.cli.before_run.inspect import inspect
from semlive.errors import BadImage
from semlive_simulators.exporters.image_metadata import ImageMetadata
from semlive_simulators.exporters.settings import Export, Vendor, WriteStyle
from semlive_simulators.scenario import load_scenario

KEYS = ["file", "vendor", "width", "height", "databar_rows", "dwell_time_s", "row_time_s", "frame_time_s", "integrations"]
KEYS += ["pixel_size_m", "acquired", "complete", "problems", "geometry"]
END_NS = 1_772_439_825_123_456_789


def semlive(*arguments: object) -> tuple[int, str, str]:
    command = [sys.executable, "-m", "semlive", "inspect", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    return done.returncode, done.stdout, done.stderr


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An FEI file, a JEOL pair, and a Zeiss file half filled with zeros."""
    where = tmp_path_factory.mktemp("exports")
    scan = load_scenario("paper_x200").scan
    image = np.random.default_rng(1).integers(0, 256, (scan.height_px, scan.width_px), dtype=np.uint8)
    for vendor in (Vendor.FEI, Vendor.JEOL, Vendor.ZEISS):
        made = Export(WriteStyle.DIRECT, 0.5, 1.5, 6, 60, "a", vendor).encode(image, ImageMetadata(scan, END_NS, 0, 0, 4, f"{vendor}.tif"))
        (where / f"{vendor}.tif").write_bytes(made.image)
        if made.sidecar is not None:
            (where / f"{vendor}.txt").write_bytes(made.sidecar)
    zeiss = (where / "zeiss.tif").read_bytes()
    (where / "half.tif").write_bytes(zeiss[: len(zeiss) // 2].ljust(len(zeiss), b"\0"))
    return where


def test_json_is_one_object_with_the_documented_keys(folder: Path) -> None:
    code, out, err = semlive(folder / "fei.tif", folder / "jeol.tif", folder / "half.tif", "--json")
    assert (code, err) == (0, "")
    fei, jeol, half = json.loads(out)["files"]
    assert [list(one) for one in (fei, jeol, half)] == [KEYS] * 3
    assert fei["file"] == str(folder / "fei.tif")
    assert (fei["vendor"], fei["width"], fei["height"], fei["databar_rows"]) == ("fei", 1024, 884, 60)
    assert fei["row_time_s"] == {"value": 94.67 / 884, "from": "file"}
    assert fei["acquired"] == {"value": "2026-03-02T08:23:45.123456", "from": "file"}
    assert fei["complete"] is True
    assert fei["problems"] == []
    assert jeol["row_time_s"] == {"value": None, "from": "unknown"}
    assert "sem.scan_profiles for its scan speed 9" in jeol["problems"][0]
    assert half["complete"] is False
    assert "the scan was not finished" in half["problems"][0]


def test_a_sidecar_text_represents_its_image_and_a_configuration_fills_gaps(folder: Path, tmp_path: Path) -> None:
    config = {
        "sem": {
            "folder": "export",
            "pixel_size_um": 1.25,
            "scan_profiles": [{"scan_speed": "9", "dwell_time_s": 1e-4, "row_time_s": 0.108}],
        },
        "stage": {"driver": "null"},
        "protocol": {"calibration_shifts_px": [[0, 0]]},
    }
    (tmp_path / "run.yaml").write_text(yaml.safe_dump(config))
    code, out, _ = semlive(folder / "jeol.txt", "--json", "--config", tmp_path / "run.yaml")
    assert code == 0
    [jeol] = json.loads(out)["files"]
    assert (jeol["vendor"], jeol["width"], jeol["height"]) == ("jeol", 1024, 884)
    assert jeol["row_time_s"] == {"value": 0.108, "from": "config"}
    assert jeol["frame_time_s"]["from"] == "derived"


def test_the_table_shows_values_sources_and_advice(folder: Path) -> None:
    code, out, err = semlive(folder / "fei.tif", folder / "jeol.tif")
    assert (code, err) == (0, "")
    text = " ".join(out.split())  # lines break where the folder's name makes them
    for words in ("fei, complete", "107.093 ms", "1250 nm", "fly-back of a pass", "2026-03-02T08:23:45.123456", "unknown", "micron bar"):
        assert words in text
    assert "set sem.profile.dwell_time_s" in text


def test_bad_input_is_one_line_and_code_2(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("hello")
    code, out, err = semlive(folder / "fei.tif", tmp_path / "notes.txt", "--json")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert str(tmp_path / "notes.txt") in err
    for name in (tmp_path / "none.tif", tmp_path):
        with pytest.raises(BadImage, match="give an exported image file"):
            inspect([name], True, None)


@pytest.mark.parametrize("json_too", [False, True])
def test_names_with_control_characters_are_printed_escaped(folder: Path, tmp_path: Path, json_too: bool) -> None:
    name = "a\x1b[2J\n[red]\u202eb.tif"
    (tmp_path / name).write_bytes((folder / "half.tif").read_bytes())
    code, out, err = semlive(tmp_path / name, *(["--json"] if json_too else []))
    assert (code, err) == (0, "")
    assert "\x1b" not in out
    assert "\u202e" not in out
    if json_too:
        assert json.loads(out)["files"][0]["file"] == str(tmp_path / name)
    else:
        assert "a\\x1b[2J" in out
        assert "[red]\\u202eb.tif" in "".join(out.split())
    code, out, err = semlive(tmp_path / f"no-{name}")
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert "no-a\\x1b[2J\\n[red]\\u202eb.tif: cannot be read" in err
