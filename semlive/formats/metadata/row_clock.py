"""Measured times of the rows of a frame: a text table with the name of the image, or the clock channel of an instrument."""

from __future__ import annotations

import io
import re
import zipfile
import zlib
from typing import IO

import numpy as np
from numpy.typing import NDArray

from semlive.data.scan import RowClock
from semlive.errors import BadInput
from semlive.inputs.text_number import is_lost
from semlive.inputs.text_table import Column, is_blank, key_of, layout_of, lines_of, number_in, text_of

ROW_START, PIXEL_TIME = "row_start_s", "pixel_time_s"
MAX_DEVIATION = 0.5
"""Largest distance of a clock channel from a straight row, in pixels' times."""
_MARK = re.compile(rb"^\W*row[ _]?start[ _(\[]*s", re.IGNORECASE)
_NUMPY = (b"\x93NUMPY", b"PK\x03\x04")
_MAX_ROWS = 10**5


def is_row_clock(data: bytes) -> bool:
    """Whether a text file is a table of row starts: its first name is ``row_start_s``."""
    return _MARK.match(data[:100]) is not None


def read_row_clock(data: bytes, where: str, width_px: int, rows: int) -> RowClock:
    """Read a table with the column ``row_start_s`` (and ``pixel_time_s``), one line for each row, or a clock channel as NPY or NPZ.

    Args:
        data: bytes of the file.
        where: name of the file, for errors.
        width_px: width of the frame.
        rows: rows of the frame.

    Raises:
        BadInput: the file is no clock of such a frame; one sentence with line and remedy.
    """
    clock = _of_channel(data, where, (rows, width_px)) if data.startswith(_NUMPY) else _of_table(data, where)
    if len(clock.row_start_s) != rows:
        raise BadInput(f"{where}: holds {len(clock.row_start_s)} rows, and the frame has {rows}; give the start of every row.")
    return clock


def _of_table(data: bytes, where: str) -> RowClock:
    lines = lines_of(text_of(data, where))
    layout = layout_of(lines, where, lambda columns: tuple(range(len(columns))))
    keys = [_key(column) for column in layout.columns]
    if key_of(ROW_START) not in keys:
        raise BadInput(f"{where}: column {ROW_START} is missing; give the start of each row in s.")
    names = [name for name in (ROW_START, PIXEL_TIME) if key_of(name) in keys]
    values: dict[str, list[float]] = {name: [] for name in names}
    for number, line in enumerate(lines[layout.first_line - 1 :], layout.first_line):
        if is_blank(line):
            continue
        cells = layout.cells(line, number)
        layout = layout.after(cells)
        for name in names:
            cell = cells[keys.index(key_of(name))].strip()
            value = None if is_lost(cell) else number_in(cell, layout.decimal)
            if value is None or not np.isfinite(value):
                raise BadInput(f"{where}: line {number}, column {name}: {cell[:40]!r} is no number; give the time in s.")
            values[name].append(value)
    return _clock(values[ROW_START], values.get(PIXEL_TIME, []), where)


def _key(column: Column) -> str:
    full = key_of(column.name + column.unit)
    return full if full in (key_of(ROW_START), key_of(PIXEL_TIME)) else column.key


def _of_channel(data: bytes, where: str, shape: tuple[int, int]) -> RowClock:
    width_px = shape[1]
    time_s = _array(data, where, shape)
    if not np.isfinite(time_s).all():
        raise BadInput(f"{where}: holds times that are not finite; give one time for each pixel.")
    clock = RowClock.of_channel(time_s)
    straight = np.add.outer(np.asarray(clock.row_start_s), np.zeros(width_px)) + np.outer(clock.pixel_time_s, np.arange(width_px))
    limit_s = MAX_DEVIATION * float(np.median(np.abs(clock.pixel_time_s)))
    worst_s = float(np.max(np.abs(time_s - straight)))
    if worst_s > limit_s:
        raise BadInput(
            f"{where}: its times deviate by {worst_s:.3g} s from an even scan of each row; the columns must be at equal distances in time."
        )
    return _clock(list(clock.row_start_s), list(clock.pixel_time_s), where)


def _array(data: bytes, where: str, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Times in s; the file is unpacked only if its head states the shape of the frame, so a small file cannot fill the memory."""
    try:
        if data.startswith(_NUMPY[0]):
            return _read_array(io.BytesIO(data), where, shape)
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            names = archive.namelist()
            if len(names) != 1 or names[0] not in ("time_s.npy", "time_ms.npy"):
                raise BadInput(f"{where}: holds {', '.join(names)[:100] or 'nothing'}; store one array, time_s or time_ms.")
            with archive.open(names[0]) as stream:
                return (1e-3 if names[0] == "time_ms.npy" else 1.0) * _read_array(stream, where, shape)
    except (ValueError, OSError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
        raise BadInput(f"{where}: is no NumPy array ({error}); write it with numpy.save or numpy.savez.") from error


def _read_array(stream: IO[bytes], where: str, shape: tuple[int, int]) -> NDArray[np.float64]:
    version = np.lib.format.read_magic(stream)
    head = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    found, is_fortran, dtype = head(stream)
    if found != shape or dtype.kind not in "fiu":
        raise BadInput(f"{where}: has the shape {found} of {dtype}, and the frame {shape} pixels; give one number for each pixel.")
    size = shape[0] * shape[1] * dtype.itemsize
    content = stream.read(size)
    if len(content) < size:
        raise BadInput(f"{where}: ends after {len(content)} of {size} bytes; write it with numpy.save or numpy.savez.")
    return np.frombuffer(content, dtype).reshape(shape, order="F" if is_fortran else "C").astype(np.float64)


def _clock(row_start_s: list[float], pixel_time_s: list[float], where: str) -> RowClock:
    if len(row_start_s) > _MAX_ROWS:
        raise BadInput(f"{where}: holds more than {_MAX_ROWS} rows; give one line for each row.")
    try:
        clock = RowClock(tuple(row_start_s), tuple(pixel_time_s))
    except ValueError as error:
        raise BadInput(f"{where}: {error}; give one line for each row.") from error
    if not np.all(np.isfinite(row_start_s)) or min(row_start_s) < 0.0:
        raise BadInput(f"{where}: a row starts before the scan; give times since the start of the frame.")
    return clock
