"""HDF5: fields by frame, series, estimate, configuration; h5py, MATLAB and ParaView's readers open it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

import h5py
import numpy as np

from semlive.data.results import FrameResult
from semlive.data.settings import MEASURES
from semlive.report.export import fields
from semlive.report.export.fields import Array, PartFile, RunMetadata, storable


class Hdf5Writer:
    """One file.

    ``/frames/<n>/{x, y, u, v, exx, eyy, exy, sigma_u, sigma_v, systematic_u, systematic_v, valid, strain_valid}``, ``/drift``,
    ``/distortion``, ``/series``, ``/load``, ``/elastic``, JSON texts ``/result``, ``/settings``, ``/configuration``, and ``/stack``, which
    presents the fields of all frames as arrays (frames, ny, nx).
    """

    def __init__(self, out: Path) -> None:
        self._part = PartFile(out)
        self._part.path.unlink(missing_ok=True)
        self._file = h5py.File(self._part.path, "w")
        self._frames = self._file.create_group("frames")

    def write_frame(self, frame: FrameResult) -> None:
        """Write one frame's group."""
        group = self._frames.create_group(str(frame.summary.frame))
        write_arrays(group, fields.frame_fields(frame))
        group.attrs["vsg_px"] = frame.summary.vsg_px
        for name, value in (("strain_mean", frame.summary.mean), ("strain_mean_sigma", frame.summary.mean_sigma)):
            for component in ("exx", "eyy", "exy"):
                group.attrs[f"{name}_{component}"] = getattr(value, component)

    def write_metadata(self, metadata: RunMetadata) -> None:
        """Write series, estimate and configuration."""
        write_metadata(self._file, metadata)
        for entry in metadata.result_json["frames"]:
            attrs = self._frames[str(entry["frame"])].attrs
            attrs["pair"], attrs["phase"] = entry["pair"], entry["phase"]
            if entry["load_n"] is not None:
                attrs["load_n"] = entry["load_n"]
        add_stack(self._file)

    def close(self, complete: bool) -> None:
        """Rename the complete file to its final name, or remove an incomplete one."""
        self._file.close()
        self._part.finish(complete)


def write_arrays(group: h5py.Group, arrays: Mapping[str, Array]) -> None:
    """Arrays as data sets with their units; masks as 0 and 1."""
    for name, array in arrays.items():
        values = storable(array)
        data = group.create_dataset(name, data=values, compression="lzf" if values.size > 1 else None, shuffle=values.size > 1)
        if name in fields.UNITS:
            data.attrs["units"] = fields.UNITS[name]


def add_stack(group: h5py.Group) -> None:
    """Add ``stack``: the fields of all frames as arrays (frames, ny, nx), with the axes ``frame``, ``y`` and ``x``.

    They are virtual data sets, which read the groups of the frames: no value is stored twice.

    Args:
        group: group of the export with its ``frames``, in an open file.
    """
    folder = group["frames"]
    assert isinstance(folder, h5py.Group)  # as written above
    frames = {int(name): frame for name, frame in folder.items()}
    numbers = sorted(frames)
    if not numbers:
        return
    stack = group.create_group("stack")
    first = frames[numbers[0]]
    for name in first:
        shape, units = first[name].shape, first[name].attrs.get("units")
        if name not in ("x", "y") and all(name in frames[number] for number in numbers):
            layout = h5py.VirtualLayout((len(numbers), *shape), first[name].dtype)
            for at, number in enumerate(numbers):
                layout[at] = h5py.VirtualSource(".", frames[number][name].name, shape)
            data = stack.create_virtual_dataset(name, layout)
            data.attrs["units"] = units
    write_arrays(stack, {"frame": np.array(numbers), "y": first["y"][:, 0], "x": first["x"][0, :]})


def write_metadata(group: h5py.Group, metadata: RunMetadata) -> None:
    """Write series, estimate and configuration."""
    group.attrs["format"] = "semlive export"
    group.attrs["format_version"] = fields.FORMAT_VERSION
    group.attrs["semlive"] = version("semlive")
    measure = MEASURES[metadata.settings["estimate.strain.measure"]]
    group.attrs["conventions"] = (
        f"x right, y down, px of frame 0; u and v corrected, from frame 0; {measure}, tension positive; exy tensor shear"
    )
    group.attrs["noise_floor_px"] = metadata.result_json["noise_floor_px"]
    write_arrays(group.create_group("drift"), fields.drift_series(metadata.result))
    write_arrays(group.create_group("distortion"), fields.distortion_fields(metadata.result))
    series = group.create_group("series")
    write_arrays(series, fields.frame_series(metadata))
    series.create_dataset("phase", data=fields.phases(metadata), dtype=h5py.string_dtype())
    if metadata.load is not None:
        write_arrays(group.create_group("load"), fields.load_series(metadata.load))
    elastic = group.create_group("elastic")
    for name, value in fields.constants(metadata).items():
        elastic.attrs[name] = value
    for name, value in (("configuration", metadata.configuration), ("settings", metadata.settings), ("result", metadata.result_json)):
        group.create_dataset(name, data=json.dumps(value), dtype=h5py.string_dtype())
