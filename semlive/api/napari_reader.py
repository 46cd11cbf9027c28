"""Reader of napari for exported fields: https://napari.org/stable/plugins/building_a_plugin/guides.html#readers.

napari finds it by the entry point ``napari.manifest``; neither napari nor npe2 is imported.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

Layer = tuple[NDArray[Any], dict[str, Any], str]
_FIELDS = {"eyy": "strain_valid", "exx": "strain_valid", "exy": "strain_valid", "u": "valid", "v": "valid"}
"""Fields, from the top layer to the bottom, and the masks of the HDF5 export."""
_NEXUS_FIELDS = "entry/roi1"
_HDF5_FIELDS = "stack"
_COLOUR_RANGE_PERCENT = (1.0, 99.0)


def napari_get_reader(path: str | Sequence[str]) -> Callable[[str | Sequence[str]], list[Layer]] | None:
    """Return the reader if a path is a NeXus or HDF5 export of semlive; None for other files and for several ones."""
    if not isinstance(path, str) or not h5py.is_hdf5(path):
        return None
    with h5py.File(path) as file:
        return read_layers if _is_nexus(file) or _is_hdf5(file) else None


def read_layers(path: str | Sequence[str]) -> list[Layer]:
    """Return one image layer for each field, (frames, ny, nx), placed on the px of frame 0 and NaN where not measured."""
    with h5py.File(Path(str(path))) as file:
        layers = [
            _layer(name, *(_nexus_field(file, name) if _is_nexus(file) else _hdf5_field(file, name, mask)))
            for name, mask in reversed(_FIELDS.items())
        ]
    for _, options, _ in layers[:-1]:
        options["visible"] = False
    return layers


def _is_nexus(file: h5py.File) -> bool:
    return file.attrs.get("creator") == "semlive" and _NEXUS_FIELDS in file


def _is_hdf5(file: h5py.File) -> bool:
    return file.attrs.get("format") == "semlive export" and _HDF5_FIELDS in file


def _nexus_field(file: h5py.File, name: str) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], str]:
    field = f"{_NEXUS_FIELDS}/{name}"
    data = _values(file, f"{field}/{name}"), _values(file, f"{field}/y"), _values(file, f"{field}/x")
    return *data, str(file[f"{field}/{name}"].attrs["units"])


def _hdf5_field(file: h5py.File, name: str, mask: str) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], str]:
    values = np.where(_values(file, f"{_HDF5_FIELDS}/{mask}") != 0, _values(file, f"{_HDF5_FIELDS}/{name}"), np.nan)
    return values, _values(file, "stack/y"), _values(file, "stack/x"), str(file[f"{_HDF5_FIELDS}/{name}"].attrs["units"])


def _values(file: h5py.File, path: str) -> NDArray[Any]:
    data = file[path]
    assert isinstance(data, h5py.Dataset)  # as semlive writes it
    return data[()]


def _layer(name: str, values: NDArray[Any], y: NDArray[Any], x: NDArray[Any], units: str) -> Layer:
    steps = [float(axis[1] - axis[0]) if axis.size > 1 else 1.0 for axis in (y, x)]
    options: dict[str, Any] = {
        "name": name,
        "axis_labels": ("frame", "y", "x"),
        "scale": (1.0, *steps),
        "translate": (0.0, float(y[0]), float(x[0])),
        "colormap": "viridis",
        "metadata": {"units": units},
    }
    measured = values[np.isfinite(values)]
    if measured.size:
        low, high = (float(limit) for limit in np.percentile(measured, _COLOUR_RANGE_PERCENT))
        options["contrast_limits"] = (low, high if high > low else low + 1.0)
    return values, options, "image"
