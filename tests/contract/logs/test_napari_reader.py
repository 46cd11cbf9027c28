"""napari opens exported fields: the manifest leads to a reader, and the reader returns layers."""

from __future__ import annotations

import importlib
import tomllib
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import yaml

import semlive.api
from semlive.api.napari_reader import napari_get_reader
from semlive.report.export import Format, export_log
from semlive.service.replay.replay import ReplayRequest, ReplayResult

MANIFEST = Path(semlive.api.__file__).with_name("napari.yaml")


@pytest.fixture(scope="module", params=[Format.NEXUS, Format.HDF5])
def opened(short: Path, request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ReplayResult]:
    out = tmp_path_factory.mktemp("napari") / f"run.{'nxs' if request.param is Format.NEXUS else 'h5'}"
    return out, export_log(ReplayRequest(short, until=1), request.param, out)


def test_every_field_is_a_layer_on_the_pixels_of_frame_0(opened: tuple[Path, ReplayResult]) -> None:
    path, done = opened
    read = napari_get_reader(str(path))
    assert read is not None
    layers: dict[str, tuple[Any, dict[str, Any]]] = {options["name"]: (values, options) for values, options, kind in read(str(path))}
    grid = done.analysis.grid
    assert list(layers) == ["v", "u", "exy", "exx", "eyy"]
    values, options = layers["eyy"]
    assert values.shape == (4, *grid.shape)
    assert options["axis_labels"] == ("frame", "y", "x")
    assert options["scale"] == (1.0, grid.step_px, grid.step_px)
    assert options["translate"] == (0.0, grid.y0_px, grid.x0_px)
    assert options["contrast_limits"][0] < options["contrast_limits"][1]
    assert [name for name, (_, shown) in layers.items() if shown.get("visible", True)] == ["eyy"]
    assert layers["u"][1]["metadata"] == {"units": "pixel" if path.suffix == ".nxs" else "px"}
    moved = layers["v"][0]
    assert np.isfinite(moved).any()
    with h5py.File(path) as file:
        stored = file["entry/roi1/v/v" if path.suffix == ".nxs" else "stack/v"][()]
    np.testing.assert_array_equal(moved[np.isfinite(moved)], stored[np.isfinite(moved)])


def test_files_of_other_programs_are_not_read(tmp_path: Path) -> None:
    text, other = tmp_path / "a.h5", tmp_path / "b.h5"
    text.write_text("no HDF5")
    h5py.File(other, "w").close()
    assert napari_get_reader(str(text)) is None
    assert napari_get_reader(str(other)) is None
    assert napari_get_reader([str(other), str(other)]) is None


def test_the_manifest_names_the_reader() -> None:
    manifest = yaml.safe_load(MANIFEST.read_text(encoding="utf-8"))
    commands = {command["id"]: command["python_name"] for command in manifest["contributions"]["commands"]}
    (reader,) = manifest["contributions"]["readers"]
    module, function = commands[reader["command"]].split(":")
    assert getattr(importlib.import_module(module), function) is napari_get_reader
    assert all(command.startswith(f"{manifest['name']}.") for command in commands)


@pytest.mark.checkout
def test_napari_finds_the_manifest() -> None:
    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    module, name = project["entry-points"]["napari.manifest"]["semlive"].split(":")
    assert Path(importlib.import_module(module).__file__ or "").with_name(name) == MANIFEST
