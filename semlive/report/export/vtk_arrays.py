"""Arrays and files of VTK's XML formats: https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from semlive.data.grid import Grid
from semlive.report.export.fields import Array, storable

_TYPES = {"f8": "Float64", "i8": "Int64", "u1": "UInt8"}
_QUAD = 9
"""VTK's number of a cell with four corners."""


def write_image(path: Path, grid: Grid, fields: Mapping[str, Array]) -> None:
    """Fields (ny, nx) or (ny, nx, 3) as point data of one image, ``.vti``."""
    extent = f"0 {grid.nx - 1} 0 {grid.ny - 1} 0 0"
    data = "".join(_array(name, values) for name, values in fields.items())
    place = f'WholeExtent="{extent}" Origin="{grid.x0_px} {grid.y0_px} 0" Spacing="{grid.step_px} {grid.step_px} 1"'
    _write(path, "ImageData", place, f'<Piece Extent="{extent}"><PointData>{data}</PointData></Piece>')


def write_mesh(path: Path, grid: Grid, valid: Array, fields: Mapping[str, Array]) -> None:
    """Valid points as point data of a mesh, ``.vtu``: a quadrilateral where four neighbouring points are valid.

    Args:
        path: file to write.
        grid: points.
        valid: (ny, nx) points that the mesh contains.
        fields: (ny, nx) or (ny, nx, 3) by name.
    """
    x, y = grid.mesh()
    points = np.stack([x[valid], y[valid], np.zeros(int(valid.sum()))], axis=-1).astype(np.float64)
    number = np.full(grid.shape, -1, dtype=np.int64)
    number[valid] = np.arange(len(points))
    corners = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], axis=-1).reshape(-1, 4)
    cells = corners[(corners >= 0).all(axis=1)]
    topology = _array("connectivity", cells.ravel()) + _array("offsets", np.arange(4, 4 * len(cells) + 1, 4, dtype=np.int64))
    topology += _array("types", np.full(len(cells), _QUAD, dtype=np.uint8))
    data = "".join(_array(name, values[valid]) for name, values in fields.items())
    content = f"<PointData>{data}</PointData><Points>{_array('Points', points)}</Points><Cells>{topology}</Cells>"
    _write(path, "UnstructuredGrid", "", f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{len(cells)}">{content}</Piece>')


def _write(path: Path, kind: str, place: str, pieces: str) -> None:
    path.write_text(
        f'<?xml version="1.0"?>\n<VTKFile type="{kind}" version="1.0" byte_order="LittleEndian" header_type="UInt64">'
        f"<{kind}{place and ' '}{place}>{pieces}</{kind}></VTKFile>\n",
        encoding="ascii",
    )


def _array(name: str, values: Array) -> str:
    stored = storable(values)
    stored = np.ascontiguousarray(stored, dtype=stored.dtype.newbyteorder("<"))
    raw = np.uint64(stored.nbytes).tobytes() + stored.tobytes()
    parts = f' NumberOfComponents="{stored.shape[-1]}"' if stored.shape[-1:] == (3,) and stored.ndim > 1 else ""
    kind = _TYPES[stored.dtype.str[1:]]
    return f'<DataArray type="{kind}" Name="{name}"{parts} format="binary">{base64.b64encode(raw).decode("ascii")}</DataArray>'
