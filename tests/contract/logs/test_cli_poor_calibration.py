"""Translations in one direction only: no strain under load is given out, with the figures that show why, unless it is requested."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from semlive import open_log
from semlive.errors import PoorCalibration

Semlive = Callable[..., tuple[int, str, str]]
ALONG_Y = ("2", "4")


@pytest.fixture(scope="module")
def poor(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder without the pairs that moved along y; its table has no commanded shifts."""
    copy = Path(shutil.copytree(folder, tmp_path_factory.mktemp("poor") / "copy"))
    table = copy / "frames.csv"
    lines = table.read_text().splitlines()
    table.write_text("\n".join([*(line for line in lines if line.split(",")[1] not in ALONG_Y), ""]))
    return copy


def test_strain_under_load_is_refused_with_figures_and_given_when_requested(semlive: Semlive, poor: Path, tmp_path: Path) -> None:
    log = str(tmp_path / "poor.mcap")
    code, _, err = semlive("import", str(poor), "-o", log, "--specimen-area-mm2", "1.0")
    assert code == 0, err
    code, out, err = semlive("replay", log, "--json")
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert err.startswith(f"{log}: the calibration is refused: distortion not determined yet: needs translations in both directions")
    for figure in ("px along x and", "uncertain by", "add larger translations along y", "--set estimate.accept_poor_calibration=true"):
        assert figure in err
    code, _, err = semlive("export", log, "--format", "hdf5", "-o", str(tmp_path / "poor.h5"))
    assert code == 2
    assert "the calibration is refused" in err
    assert list(tmp_path.iterdir()) == [Path(log)]
    code, out, err = semlive("replay", log, "--json", "--set", "estimate.accept_poor_calibration=true")
    assert (code, err) == (0, "")
    reported = json.loads(out)
    assert any(item.startswith("WARNING, the load steps are corrected with it all the same") for item in reported["warnings"])
    reasons = [item for item in reported["warnings"] if "no elastic constants: " in item]
    assert (reported["elastic"] is None) == (len(reasons) == 1), reported["warnings"]


def test_so_is_it_by_the_published_procedure(semlive: Semlive, poor: Path, tmp_path: Path) -> None:
    log = str(tmp_path / "poor.mcap")
    assert semlive("import", str(poor), "-o", log)[0] == 0
    code, _, err = semlive("replay", log, "--json", "--method", "sutton2007")
    assert code == 2
    assert "at least 4 px along both are needed" in err


def test_nor_is_it_given_to_python(semlive: Semlive, poor: Path, tmp_path: Path) -> None:
    log = str(tmp_path / "poor.mcap")
    assert semlive("import", str(poor), "-o", log)[0] == 0
    with pytest.raises(PoorCalibration, match=r"the calibration is refused: .* estimate\.accept_poor_calibration=true"):
        open_log(log)
    opened = open_log(log, changes=["estimate.accept_poor_calibration=true"])
    assert any(item.startswith("WARNING, the load steps are corrected with it all the same") for item in opened.warnings)


def test_what_was_measured_before_the_load_is_given(semlive: Semlive, poor: Path, tmp_path: Path) -> None:
    log = str(tmp_path / "poor.mcap")
    assert semlive("import", str(poor), "-o", log)[0] == 0
    code, out, _ = semlive("replay", log, "--json", "--until", "3")
    assert code == 0
    assert any("distortion not determined yet" in item for item in json.loads(out)["warnings"])
