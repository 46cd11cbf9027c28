"""VTK's XML image data, one .vti for each frame and a collection over time: ParaView opens ``frames.pvd``."""

from __future__ import annotations

import base64
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

_TYPES = {"f8": "Float64", "i8": "Int64", "u1": "UInt8"}


class VtkWriter:
    """A folder with ``frame_<n>.vti``, ``frames.pvd``, ``distortion.vti``, and the series as CSV.

    Positions are px of frame 0 with y downwards, as everywhere: ParaView shows row 0 below.
    """

    def __init__(self, out: Path) -> None:
        self._out = out
        out.mkdir(parents=True, exist_ok=True)

    def write_frame(self, frame: FrameResult) -> None:
        """Write one frame: a vector `displacement`, strain, uncertainties, masks."""
        fields = frame_fields(frame)
        vector = np.stack([fields.pop("u"), fields.pop("v"), np.zeros(frame.displacement.grid.shape)], axis=-1)
        del fields["x"], fields["y"]
        write_image(self._out / _name(frame.summary.frame), frame.displacement.grid, {"displacement": vector, **fields})

    def write_metadata(self, metadata: RunMetadata) -> None:
        """Write the collection, the distortion and the series."""
        series = frame_series(metadata)
        files = "".join(
            f'<DataSet timestep="{start_s!r}" part="0" file="{_name(frame)}"/>'
            for frame, start_s in zip(series["frame"].tolist(), series["start_s"].tolist(), strict=True)
        )
        whole = f'<VTKFile type="Collection" version="1.0"><Collection>{files}</Collection></VTKFile>\n'
        (self._out / "frames.pvd").write_text('<?xml version="1.0"?>\n' + whole, encoding="ascii")
        fields = distortion_fields(metadata.result)
        del fields["x"], fields["y"]
        write_image(self._out / "distortion.vti", metadata.result.estimate.distortion.grid, fields)
        write_table(self._out / "series.csv", series, {"phase": phases(metadata)})
        write_table(self._out / "drift.csv", drift_series(metadata.result))
        if metadata.load is not None:
            write_table(self._out / "load.csv", load_series(metadata.load))
        write_json_files(self._out, metadata)

    def close(self, complete: bool) -> None:
        """Do nothing: no file is open."""


def write_image(path: Path, grid: Grid, fields: Mapping[str, Array]) -> None:
    """Fields (ny, nx) or (ny, nx, 3) as point data of one image."""
    extent = f"0 {grid.nx - 1} 0 {grid.ny - 1} 0 0"
    data = "".join(_array(name, values) for name, values in fields.items())
    path.write_text(
        '<?xml version="1.0"?>\n<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" header_type="UInt64">'
        f'<ImageData WholeExtent="{extent}" Origin="{grid.x0_px} {grid.y0_px} 0" Spacing="{grid.step_px} {grid.step_px} 1">'
        f'<Piece Extent="{extent}"><PointData>{data}</PointData></Piece></ImageData></VTKFile>\n',
        encoding="ascii",
    )


def _array(name: str, values: Array) -> str:
    stored = values.astype(np.uint8) if values.dtype == np.bool_ else values
    stored = np.ascontiguousarray(stored, dtype=stored.dtype.newbyteorder("<"))
    raw = np.uint64(stored.nbytes).tobytes() + stored.tobytes()
    parts = f' NumberOfComponents="{values.shape[2]}"' if values.ndim == 3 else ""
    kind = _TYPES[stored.dtype.str[1:]]
    return f'<DataArray type="{kind}" Name="{name}"{parts} format="binary">{base64.b64encode(raw).decode("ascii")}</DataArray>'


def _name(frame: int) -> str:
    return f"frame_{frame:05d}.vti"
