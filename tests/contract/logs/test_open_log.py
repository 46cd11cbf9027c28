"""`semlive.open_log` and its example."""

from __future__ import annotations

import json
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import semlive
from semlive.api import OpenLog
from semlive.errors import BadConfig

EXAMPLE = Path(__file__).parents[3] / "docs" / "examples" / "open_log.py"


@pytest.fixture(scope="module")
def log(imported: Path) -> OpenLog:
    return semlive.open_log(imported)


def test_frames_are_arrays_on_the_grid(log: OpenLog) -> None:
    assert len(log.frames) == 24
    frame = log.frames[23]
    assert frame.u.shape == frame.valid.shape == (24, 30)
    assert frame.x[0].tolist() == list(range(101, 101 + 30 * 25, 25))
    assert frame.number == log.frames[-1].number == 23
    assert frame.phase == "tension"
    assert frame.load_n == pytest.approx(213.3)
    slope = np.polyfit(frame.y[frame.valid], frame.v[frame.valid], 1)[0]
    assert slope == pytest.approx(frame.strain_mean["eyy"], abs=1e-4)
    assert [one.number for one in log.frames[20:22]] == [20, 21]
    with pytest.raises(IndexError, match=r"there is no frame 24; the numbers are 0 \.\.\. 23"):
        log.frames[24]


def test_series_estimate_and_configuration(log: OpenLog) -> None:
    assert log.elastic["youngs_modulus_gpa"] == pytest.approx(71.1, abs=4 * log.elastic["youngs_modulus_gpa_sigma"])
    assert log.drift.time_s.shape == log.drift.dx_px.shape == log.drift.sigma_px.shape
    assert log.distortion.dx_px.shape == (24, 30)
    assert log.configuration["imported"]["format"] == 1
    assert log.settings["specimen.area_mm2"] == 1.0
    assert log.load is None
    table = pd.DataFrame(log.series)
    assert table["load_n"].max() == pytest.approx(213.3)
    assert json.dumps(log.result)
    assert "12 pairs, 30 x 24 points 25 px apart" in repr(log)


def test_xarray_has_units_coordinates_and_nan_where_nothing_was_measured(log: OpenLog) -> None:
    cube = log.to_xarray([0, 22, 23])
    assert cube.u.dims == ("frame", "y", "x")
    assert cube.u.attrs["units"] == "px"
    np.testing.assert_array_equal(np.isnan(cube.v.sel(frame=23)), ~log.frames[23].valid)
    assert cube.load_n.sel(frame=23).item() == pytest.approx(213.3)
    assert float(cube.eyy.sel(frame=22).mean()) == pytest.approx(3e-3, rel=0.05)


def test_another_window(short: Path) -> None:
    assert semlive.open_log(str(short), changes=["estimate.window=5"]).result["vsg_px"] == 200
    with pytest.raises(BadConfig, match=r"did you mean estimate\.window_points"):
        semlive.open_log(short, changes=["estimate.windw=5"])


@pytest.mark.checkout
def test_the_example_runs(imported: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", [str(EXAMPLE), str(imported)])
    runpy.run_path(str(EXAMPLE), run_name="__main__")
    said = capsys.readouterr().out
    assert "youngs_modulus_gpa: 7" in said
    assert "{'frame': 2, 'y': 24, 'x': 30}" in said


def test_the_package_stays_light() -> None:
    script = "import sys, semlive; print(len([m for m in ('numpy', 'scipy', 'numba', 'h5py', 'matplotlib') if m in sys.modules]))"
    assert subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout == "0\n"
    with pytest.raises(AttributeError, match="has no attribute 'open_book'"):
        semlive.open_book  # noqa: B018
