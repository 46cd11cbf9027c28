"""`semlive export`: what other programs open holds the very fields."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pandas as pd
import pytest
import scipy.io
import xarray as xr
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOXML import vtkXMLImageDataReader, vtkXMLUnstructuredGridReader

from semlive.data.grid import Grid
from semlive.data.results import RunResult
from semlive.estimate import correction_sigmas
from semlive.report.export.vtk_arrays import write_mesh
from semlive.service.analysis.result_json import result_json
from semlive.service.replay.replay import ReplayRequest, replay

Semlive = Callable[..., tuple[int, str, str]]
NAMES = ("u", "v", "exx", "eyy", "exy", "sigma_u", "sigma_v")


@pytest.fixture(scope="module")
def summary(imported: Path) -> Any:
    return replay(ReplayRequest(imported, until=5))


@pytest.fixture(scope="module")
def written() -> dict[str, Path]:
    """What was exported so far, by format: tests only read it, and the estimate of each export takes a second."""
    return {}


@pytest.fixture
def exported(semlive: Semlive, imported: Path, written: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    def export(kind: str) -> Path:
        if kind in written:
            return written[kind]
        folder = tmp_path_factory.mktemp("exported")
        out = folder / f"out.{kind}"
        code, printed, err = semlive("export", str(imported), "--format", kind, "-o", str(out), "--until", "5", "--json")
        assert (code, err) == (0, "")
        assert json.loads(printed) == {"out": str(out), "format": kind, "frames": list(range(12))}
        assert [path for path in folder.iterdir()] == [out]
        written[kind] = out
        return out

    return export


def fields(result: RunResult, number: int) -> dict[str, np.ndarray]:
    frame = result.frames[number]
    moved, strain = frame.displacement, frame.strain
    return {
        "u": moved.u_px,
        "v": moved.v_px,
        "exx": strain.exx,
        "eyy": strain.eyy,
        "exy": strain.exy,
        "sigma_u": np.where(moved.valid, moved.sigma_u_px, 0.0),
        "sigma_v": np.where(moved.valid, moved.sigma_v_px, 0.0),
    }


def test_hdf5_holds_fields_series_units_and_configuration(exported: Callable[[str], Path], summary: Any) -> None:
    path = exported("hdf5")
    with h5py.File(path) as file:
        assert set(file) == {"frames", "stack", "drift", "distortion", "series", "elastic", "configuration", "settings", "result"}
        assert list(file["frames"]) == sorted(str(item) for item in range(12))
        group = file["frames/11"]
        assert set(group) >= {"x", "y", "u", "v", "exx", "eyy", "exy", "sigma_u", "sigma_v", "valid"}
        x, y = summary.analysis.grid.mesh()
        np.testing.assert_array_equal(group["x"], x)
        np.testing.assert_array_equal(group["y"], y)
        for name, values in fields(summary.result, 11).items():
            np.testing.assert_array_equal(group[name], values)
        dmap = next(item for item in summary.analysis.maps_from_reference if item.current == 11)
        for name, values in zip(("systematic_u", "systematic_v"), next(correction_sigmas(summary.solution, (dmap,))), strict=True):
            np.testing.assert_allclose(group[name], np.where(group["valid"], values, 0.0), rtol=1e-9)
        assert float(group["systematic_u"][()].max()) > 0.0
        assert not file["frames/0/systematic_u"][()].any()
        np.testing.assert_array_equal(group["valid"], summary.result.frames[11].displacement.valid)
        assert group["u"].attrs["units"] == "px"
        assert group["eyy"].attrs["units"] == "1"
        assert (group.attrs["pair"], group.attrs["phase"]) == (5, "tension")
        drift = summary.result.estimate.drift
        np.testing.assert_array_equal(file["drift/time_s"], drift.time_s)
        np.testing.assert_array_equal(np.stack([file["drift/dx_px"], file["drift/dy_px"]], axis=1), drift.drift_px)
        assert file["drift/sigma_px"].shape == drift.time_s.shape
        for name, values in (("dx_px", "ex_px"), ("dy_px", "ey_px"), ("sigma_px", "sigma_px")):
            np.testing.assert_array_equal(file["distortion"][name], getattr(summary.result.estimate.distortion, values))
        assert json.loads(file["result"].asstr()[()]) == result_json(summary.result, summary.settings)
        assert json.loads(file["configuration"].asstr()[()])["imported"]["engines"] == ["semlive"]
        assert json.loads(file["settings"].asstr()[()])["estimate.window_points"] == 9


def test_hdf5_presents_all_frames_as_one_array_without_storing_them_twice(exported: Callable[[str], Path], summary: Any) -> None:
    with h5py.File(exported("hdf5")) as file:
        stack = file["stack"]
        assert stack["eyy"].is_virtual
        assert stack["eyy"].shape == (12, *summary.analysis.grid.shape)
        assert stack["u"].attrs["units"] == "px"
        assert stack["frame"][()].tolist() == list(range(12))
        np.testing.assert_array_equal(stack["x"], summary.analysis.grid.x_px)
        for name, values in fields(summary.result, 11).items():
            np.testing.assert_array_equal(stack[name][11], values)


def test_xarray_reads_the_hdf5(exported: Callable[[str], Path], summary: Any) -> None:
    with h5py.File(exported("hdf5")) as file:
        group = file["frames/3"]
        frame = xr.Dataset({name: (("y", "x"), group[name][()], dict(group[name].attrs)) for name in NAMES})
    assert float(frame.eyy.max()) == summary.result.frames[3].strain.eyy.max()


def test_pandas_reads_the_csv(exported: Callable[[str], Path], summary: Any) -> None:
    out = exported("csv")
    frame, series = pd.read_csv(out / "frame_00011.csv"), pd.read_csv(out / "series.csv")
    for name, values in fields(summary.result, 11).items():
        column = name if name.startswith("e") else f"{name}_px"
        np.testing.assert_array_equal(frame[column], values.ravel())
    assert list(series["frame"]) == list(range(12))
    assert list(series["phase"])[-1] == "tension"
    assert series["eyy_mean"].iloc[-1] == summary.result.summaries[-1].mean.eyy
    assert series["load_n"].isna().sum() == 10  # no load before the first load step
    assert len(pd.read_csv(out / "drift.csv")) == len(summary.result.estimate.drift.time_s)
    assert len(pd.read_csv(out / "distortion.csv")) == frame.shape[0]


def test_scipy_reads_the_mat_file_as_octave_would(exported: Callable[[str], Path], summary: Any) -> None:
    held = scipy.io.loadmat(exported("mat"), simplify_cells=True)
    for name, values in fields(summary.result, 11).items():
        np.testing.assert_array_equal(held["frame_00011"][name], values)
    assert held["units"]["u"] == "px"
    assert list(held["series"]["phase"])[-1] == "tension"
    assert json.loads(held["result_json"])["pairs"] == 6
    assert scipy.io.whosmat(exported("mat"))[0] == ("frame_00000", (1, 1), "struct")


def test_vtk_reads_the_image_data(exported: Callable[[str], Path], summary: Any) -> None:
    out = exported("vtk")
    reader = vtkXMLImageDataReader()
    reader.SetFileName(os.fspath(out / "frame_00011.vti"))
    reader.Update()
    image, grid = reader.GetOutput(), summary.analysis.grid
    assert image.GetDimensions() == (grid.nx, grid.ny, 1)
    assert image.GetOrigin()[:2] == (grid.x0_px, grid.y0_px)
    assert image.GetSpacing()[:2] == (grid.step_px, grid.step_px)
    held = image.GetPointData()
    expected = fields(summary.result, 11)
    moved = vtk_to_numpy(held.GetArray("displacement"))
    np.testing.assert_array_equal(moved[:, 0], expected["u"].ravel())
    np.testing.assert_array_equal(moved[:, 1], expected["v"].ravel())
    for name in ("exx", "eyy", "exy", "sigma_u"):
        np.testing.assert_array_equal(vtk_to_numpy(held.GetArray(name)), expected[name].ravel())
    assert (out / "frames.pvd").read_text().count("<DataSet ") == 12
    assert (out / "distortion.vti").is_file()


def test_vtk_reads_the_mesh_of_the_measured_points(exported: Callable[[str], Path], summary: Any) -> None:
    out = exported("vtu")
    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(os.fspath(out / "frame_00011.vtu"))
    reader.Update()
    mesh, valid = reader.GetOutput(), summary.result.frames[11].displacement.valid
    assert mesh.GetNumberOfPoints() == valid.sum()
    assert mesh.GetNumberOfCells() == (valid[:-1, :-1] & valid[:-1, 1:] & valid[1:, 1:] & valid[1:, :-1]).sum()
    assert mesh.GetCell(0).GetBounds()[1] - mesh.GetCell(0).GetBounds()[0] == summary.analysis.grid.step_px
    held = mesh.GetPointData()
    moved = vtk_to_numpy(held.GetArray("displacement"))
    np.testing.assert_array_equal(moved[:, 1], summary.result.frames[11].displacement.v_px[valid])
    np.testing.assert_array_equal(vtk_to_numpy(held.GetArray("eyy")), summary.result.frames[11].strain.eyy[valid])
    assert (out / "frames.pvd").read_text().count("frame_00011.vtu") == 1


def test_a_mesh_has_no_cell_at_a_gap(tmp_path: Path) -> None:
    grid = Grid(0, 0, 10, 4, 3, 21)
    valid = np.ones(grid.shape, dtype=bool)
    valid[1, 1] = False
    write_mesh(tmp_path / "gap.vtu", grid, valid, {"valid": valid})
    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(os.fspath(tmp_path / "gap.vtu"))
    reader.Update()
    assert (reader.GetOutput().GetNumberOfPoints(), reader.GetOutput().GetNumberOfCells()) == (11, 2)


def test_images(semlive: Semlive, short: Path, tmp_path: Path) -> None:
    code, _, err = semlive("export", str(short), "--format", "png", "-o", str(tmp_path / "maps"), "--until", "0")
    assert (code, err) == (0, "")
    names = {path.name for path in (tmp_path / "maps").glob("*.png")}
    assert names == {"frame_00000.png", "frame_00001.png", "drift.png", "distortion.png"}
    picture = cv2.imread(str(tmp_path / "maps" / "frame_00001.png"))
    assert picture is not None
    assert picture.shape[1] > 1000
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 256  # maps, not a blank sheet


def test_a_failed_export_gives_one_error_line_and_no_file(semlive: Semlive, imported: Path, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    code, out, err = semlive("export", str(imported), "--format", "csv", "-o", str(tmp_path / "taken" / "out"))
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    code, out, err = semlive("export", str(imported), "--format", "hdf5", "-o", str(tmp_path / "taken" / "out.h5"))
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    code, out, err = semlive("export", str(imported), "--format", "hdf5", "-o", str(tmp_path / "out.h5"), "--set", "estimate.window=500")
    assert code == 2 or code == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["taken"]
