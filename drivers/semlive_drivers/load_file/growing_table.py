"""The newest line of a text table that another program writes. The head determines the layout, which every later line must have."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from semlive.errors import BadInput
from semlive.inputs.files import open_regular
from semlive.inputs.text_cells import SPREADSHEETS
from semlive.inputs.text_table import (
    TITLE_LINES,
    ColumnSelector,
    Convention,
    Layout,
    decoded,
    encoding_of,
    is_blank,
    layout_of,
    lines_of,
    number_in,
)
from semlive_drivers.load_file.later_heads import LaterHeads

_WINDOW_BYTES = 65_536
"""Bytes at the beginning in which the head is searched, and at the end in which the newest line is searched."""
_CONTINUATION_BYTES = bytes(range(0x80, 0xC0))
"""Bytes within a character of UTF-8."""


@dataclass(frozen=True, slots=True)
class NewestLine:
    """The newest complete line of a table.

    Attributes:
        path: path of the file.
        end: byte after the end of the line; it grows with the file.
        layout: layout of the table.
        cells: cells of the line.
        number: number of the line, from 1; None in a file of which only the end is read.
    """

    path: Path
    end: int
    layout: Layout
    cells: list[str]
    number: int | None

    @property
    def line(self) -> str:
        """The line, for messages."""
        return "the newest line" if self.number is None else f"line {self.number}"


class GrowingTable:
    """Reads the newest complete line of a file; between two calls the file is closed.

    Args:
        number_columns: selects the columns that must hold numbers.
        convention: separator and decimal sign, if they are configured.
        encoding: encoding of a file without a byte order mark.
    """

    def __init__(self, number_columns: ColumnSelector, convention: Convention, encoding: str) -> None:
        self._number_columns, self._convention, self._encoding = number_columns, convention, encoding
        self._path: Path | None = None
        self._layout: Layout | None = None
        self._layout_head = b""
        self._begins_with_text = False
        self._later_heads: LaterHeads | None = None

    def newest(self, path: Path) -> NewestLine | None:
        """The newest complete line of numbers; None while there is none. Text after the last line feed is ignored.

        Raises:
            BadInput: if the file is no regular file or no table, its head is ambiguous, or the line does not match the head.
            OSError: if the file cannot be read.
        """
        with open_regular(path) as stream:
            return self._newest_in(path, stream)

    def _newest_in(self, path: Path, stream: BinaryIO) -> NewestLine | None:
        size = os.fstat(stream.fileno()).st_size
        start = stream.read(_WINDOW_BYTES)
        mark, encoding = encoding_of(start, self._encoding)
        width = 2 if encoding.startswith("utf-16") else 1
        offset = max(0, size - _WINDOW_BYTES) // width * width
        if offset:
            stream.seek(offset)
        window = stream.read(_WINDOW_BYTES + width) if offset else start
        head = start[: _end_of_lines(start, width)]
        if path != self._path or self._layout is None or not start.startswith(self._layout_head):
            self._path, self._layout, self._layout_head = path, None, b""
            _check_text(path, start, head, width)
            self._detect_layout(path, head, mark, encoding)
        if self._layout is None:
            return None
        end = _end_of_lines(window, width)
        # The window may begin within a character, which would not be UTF-8.
        complete = window[:end].lstrip(_CONTINUATION_BYTES) if offset and width == 1 else window[0 if offset else mark : end]
        text = decoded(complete, encoding)
        # The window may begin within a line.
        lines = lines_of(text)[1 if offset else 0 : -1]
        if not lines:
            raise BadInput(f"{path}: its newest line is longer than {_WINDOW_BYTES} bytes; record lines of numbers.")
        first = 0 if offset else self._layout.first_line - 1
        index = next((index for index in range(len(lines) - 1, first - 1, -1) if not is_blank(lines[index])), None)
        if index is None:
            return None
        self._check_later_heads(path, stream, offset + end)
        cells = self._layout.cells(lines[index], None if offset else index + 1)
        self._layout = self._layout.after(cells)
        for _ in lines[index + 1 :]:  # blank lines and comments are no reading, so the file does not grow by them
            end = _end_of_lines(window, width, end - width)
        newest = NewestLine(path, offset + end, self._layout, cells, None if offset else index + 1)
        if _is_text(cells[0]) and not self._begins_with_text:
            raise BadInput(f"{path}: {newest.line} begins with {cells[0][:40]!r} and not with a number; record lines of readings only.")
        return newest

    def _check_later_heads(self, path: Path, stream: BinaryIO, end: int) -> None:
        """Refuse a table with other names or units below the first, as a program writes that begins another test in one file."""
        changed = self._later_heads.changed_in(stream, end) if self._later_heads is not None else ""
        if changed:
            raise BadInput(f"{path}: holds {changed[:60]!r} below other names or units; record each test in a file of its own.")

    def _detect_layout(self, path: Path, head: bytes, mark: int, encoding: str) -> None:
        """Detect the layout from the complete lines at the beginning, if one of them holds numbers."""
        lines = lines_of(decoded(head[mark:], encoding))[:-1]
        if not any(line.strip() for line in lines):
            if len(head) == 0 and path.stat().st_size > _WINDOW_BYTES:
                raise BadInput(f"{path}: its first line is longer than {_WINDOW_BYTES} bytes; record lines of numbers.")
            return
        layout = layout_of(lines, str(path), self._number_columns, self._convention, TITLE_LINES)
        first = next((line for line in lines[layout.first_line - 1 :] if not is_blank(line)), None)
        if first is not None:
            self._layout, self._layout_head = layout, head
            self._later_heads = LaterHeads(layout, lines[: layout.first_line - 1], mark, encoding)
            self._begins_with_text = _is_text(layout.cells(first)[0])


def _is_text(cell: str) -> bool:
    """Whether a cell is a text, as in ``Mean;;0.5``, and neither a number nor a lost value."""
    return cell[:1].isalpha() and number_in(cell, "") is None


def _check_text(path: Path, start: bytes, head: bytes, width: int) -> None:
    """Refuse a file that will never have a line of numbers.

    Args:
        path: path of the file.
        start: its first bytes.
        head: its complete lines in them.
        width: bytes of a line feed.

    Raises:
        BadInput: it is no text, or its lines end in carriage returns.
    """
    if start.startswith(SPREADSHEETS) or (width == 1 and b"\0" in head):
        raise BadInput(f"{path}: is no plain text, but a spreadsheet or another binary file; record lines of text (CSV).")
    if width == 1 and not head and b"\r" in start.rstrip(b"\r\0"):
        raise BadInput(f"{path}: its lines end in carriage returns without line feeds; write line feeds.")


def _end_of_lines(data: bytes, width: int, end: int | None = None) -> int:
    """End of the last complete line in the first `end` bytes, or in all; 0 if there is none."""
    end = len(data) if end is None else end
    while (end := data.rfind(b"\n", 0, end)) >= 0:
        if width == 1:
            return end + 1
        # The two bytes of a line feed in UTF-16, in either order, at an even position: not bytes of two letters.
        begin = end - end % 2
        if data[begin : begin + 2] in (b"\n\0", b"\0\n"):
            return begin + 2
    return 0
