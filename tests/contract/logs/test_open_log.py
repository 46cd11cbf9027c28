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
from semlive.api.libraries import optional_library
from semlive.api.plots import FigureKind
from semlive.errors import BadConfig, BadInput

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
    assert [item.number for item in log.frames[20:22]] == [20, 21]
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
    assert cube.u.attrs["units"] == cube.x.attrs["units"] == "px"
    assert ("x_um" in cube.coords) is (log.pixel_size_um is not None)
    np.testing.assert_array_equal(np.isnan(cube.v.sel(frame=23)), ~log.frames[23].valid)
    assert cube.load_n.sel(frame=23).item() == pytest.approx(213.3)
    assert float(cube.eyy.sel(frame=22).mean()) == pytest.approx(3e-3, rel=0.05)


def test_data_frames_have_one_row_for_each_frame_or_point(log: OpenLog) -> None:
    table = log.to_pandas()
    assert table.index.tolist() == list(range(24))
    assert table.loc[23, "load_n"] == pytest.approx(213.3)
    frame = log.frames[23]
    points = frame.to_pandas()
    assert len(points) == frame.valid.sum()
    np.testing.assert_array_equal(points["v"], frame.v[frame.valid])
    np.testing.assert_array_equal(points["eyy"].isna(), ~frame.strain_valid[frame.valid])


def test_a_notebook_shows_tables(log: OpenLog) -> None:
    shown = log._repr_html_()
    assert "tension.mcap" in shown
    assert "<th style='text-align:left'>Young&#x27;s modulus</th>" in shown
    assert "213.3 N" in log.frames[23]._repr_html_()
    assert log.pixel_size_um is None or f"{log.pixel_size_um:.4g} µm" in shown


@pytest.mark.parametrize(("kind", "axes"), [("drift", 1), ("distortion", 3), ("stress_strain", 1), ("fields", 12)])
def test_standard_figures_are_drawn(log: OpenLog, kind: FigureKind, axes: int) -> None:
    assert len(log.plot(kind).axes) == axes


def test_what_the_log_lacks_is_refused_with_the_reason(log: OpenLog) -> None:
    with pytest.raises(BadInput, match=r"plot\('load'\): the log has no data for it"):
        log.plot("load")
    with pytest.raises(BadInput, match="the figures are load, drift, distortion, stress_strain, fields"):
        log.plot("pie")  # type: ignore[arg-type]
    with pytest.raises(IndexError, match="there is no frame 24"):
        log.plot("fields", frame=24)
    with pytest.raises(BadInput, match=r"image\(3\): the log has no image of this frame; frames are 0 to 23"):
        log.image(3)
    with pytest.raises(BadInput, match=r"to_cube: no_such_library is not installed; pip install semlive\[no_such_library\]"):
        optional_library("no_such_library", "to_cube")


def test_another_window(short: Path) -> None:
    assert semlive.open_log(str(short), changes=["estimate.window=5"]).result["vsg_px"] == 200
    with pytest.raises(BadConfig, match=r"did you mean estimate\.window_points"):
        semlive.open_log(short, changes=["estimate.windw=5"])


@pytest.mark.checkout
def test_the_example_runs(imported: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", [str(EXAMPLE), str(imported)])
    runpy.run_path(str(EXAMPLE), run_name="__main__")
    printed = capsys.readouterr().out
    assert "youngs_modulus_gpa: 7" in printed
    assert "{'frame': 2, 'y': 24, 'x': 30}" in printed


def test_the_package_stays_light() -> None:
    script = "import sys, semlive; print(len([m for m in ('numpy', 'scipy', 'numba', 'h5py', 'matplotlib') if m in sys.modules]))"
    assert subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout == "0\n"
    with pytest.raises(AttributeError, match="has no attribute 'open_book'"):
        semlive.open_book  # noqa: B018
