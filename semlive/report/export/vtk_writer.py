"""VTK's XML formats, one image or mesh for each frame and a collection over time: ParaView opens ``frames.pvd``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from semlive.data.grid import Grid
from semlive.data.results import FrameResult
from semlive.report.export.csv_writer import write_json_files, write_table
from semlive.report.export.fields import (
    Array,
    RunMetadata,
    distortion_fields,
    drift_series,
    frame_fields,
    frame_series,
    load_series,
    phases,
)
from semlive.report.export.vtk_arrays import write_image, write_mesh


class VtkWriter:
    """A folder with ``frame_<n>.vti``, ``frames.pvd``, ``distortion.vti``, and the series as CSV.

    Positions are px of frame 0 with y downwards, as everywhere: ParaView shows row 0 below.
    """

    _ending = "vti"

    def __init__(self, out: Path) -> None:
        self._out = out
        out.mkdir(parents=True, exist_ok=True)

    def write_frame(self, frame: FrameResult) -> None:
        """Write one frame: a vector `displacement`, strain, uncertainties, masks."""
        fields = frame_fields(frame)
        vector = np.stack([fields.pop("u"), fields.pop("v"), np.zeros(frame.displacement.grid.shape)], axis=-1)
        del fields["x"], fields["y"]
        self._write_fields(self._name(frame.summary.frame), frame.displacement.grid, {"displacement": vector, **fields})

    def write_metadata(self, metadata: RunMetadata) -> None:
        """Write the collection, the distortion and the series."""
        series = frame_series(metadata)
        files = "".join(
            f'<DataSet timestep="{start_s!r}" part="0" file="{self._name(frame)}"/>'
            for frame, start_s in zip(series["frame"].tolist(), series["start_s"].tolist(), strict=True)
        )
        whole = f'<VTKFile type="Collection" version="1.0"><Collection>{files}</Collection></VTKFile>\n'
        (self._out / "frames.pvd").write_text('<?xml version="1.0"?>\n' + whole, encoding="ascii")
        fields = distortion_fields(metadata.result)
        del fields["x"], fields["y"]
        self._write_fields(f"distortion.{self._ending}", metadata.result.estimate.distortion.grid, fields)
        write_table(self._out / "series.csv", series, {"phase": phases(metadata)})
        write_table(self._out / "drift.csv", drift_series(metadata.result))
        if metadata.load is not None:
            write_table(self._out / "load.csv", load_series(metadata.load))
        write_json_files(self._out, metadata)

    def close(self, complete: bool) -> None:
        """Do nothing: no file is open."""

    def _write_fields(self, name: str, grid: Grid, fields: Mapping[str, Array]) -> None:
        write_image(self._out / name, grid, fields)

    def _name(self, frame: int) -> str:
        return f"frame_{frame:05d}.{self._ending}"


class VtuWriter(VtkWriter):
    """The folder of `VtkWriter` with meshes, ``.vtu``, that contain the measured points only; meshio opens them too."""

    _ending = "vtu"

    def _write_fields(self, name: str, grid: Grid, fields: Mapping[str, Array]) -> None:
        write_mesh(self._out / name, grid, fields["valid"], fields)
