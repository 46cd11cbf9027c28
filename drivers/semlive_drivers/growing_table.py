"""The newest line of a text table that another program writes: its head decides how it is written, each later line is held to that."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from semlive.errors import BadInput
from semlive.inputs.files import open_regular
from semlive.inputs.text_table import ColumnSelector, Convention, Layout, encoding_of, is_blank, layout_of, lines_of

_WINDOW_BYTES = 65_536
"""The head is decided from so many bytes at the beginning, the newest line looked for in so many at the end."""
_HEAD_SEARCHED = 200
"""Lines in which the names are looked for: programs write a description of the test above them."""


@dataclass(frozen=True, slots=True)
class Newest:
    """The newest whole line of a table.

    Attributes:
        path: of the file.
        end: byte behind the line's end; it grows with the file.
        layout: how the table is written.
        cells: of the line.
    """

    path: Path
    end: int
    layout: Layout
    cells: list[str]


class GrowingTable:
    """Reads the newest whole line of a file as often as asked; between two calls no file is kept open.

    Args:
        select: selects the columns that must contain numbers.
        given: separator and decimal sign, where they are known.
        encoding: of a file without a byte order mark.
    """

    def __init__(self, select: ColumnSelector, given: Convention, encoding: str) -> None:
        self._select, self._given, self._encoding = select, given, encoding
        self._path: Path | None = None
        self._layout: Layout | None = None
        self._decided_by = b""

    def newest(self, path: Path) -> Newest | None:
        """The newest whole line of numbers; None while there is none. What follows the last line feed is never looked at.

        Raises:
            BadInput: the file is no regular file or no table, its head can be read in several ways, or the line does not fit the head.
            OSError: it cannot be read.
        """
        with open_regular(path) as stream:
            size = os.fstat(stream.fileno()).st_size
            start = stream.read(_WINDOW_BYTES)
            mark, encoding = encoding_of(start, self._encoding)
            width = len("\n".encode(encoding)) if mark else 1
            offset = max(0, size - _WINDOW_BYTES) // width * width
            if offset:
                stream.seek(offset)
            window = stream.read(_WINDOW_BYTES + width) if offset else start
        head = start[: _end_of_lines(start, width)]
        if path != self._path or self._layout is None or not start.startswith(self._decided_by):
            self._path, self._layout, self._decided_by = path, None, b""
            self._decide(path, head[mark:].decode(encoding, errors="replace"), head)
        if self._layout is None:
            return None
        end = _end_of_lines(window, width)
        text = window[0 if offset else mark : end].decode(encoding, errors="replace")
        # The window may begin within a line.
        lines = lines_of(text)[1 if offset else 0 : -1]
        if not lines:
            raise BadInput(f"{path}: its newest line is longer than {_WINDOW_BYTES} bytes; record lines of numbers.")
        first = 0 if offset else self._layout.first_line - 1
        place = next((place for place in range(len(lines) - 1, first - 1, -1) if not is_blank(lines[place])), None)
        if place is None:
            return None
        cells = self._layout.cells(lines[place], None if offset else place + 1)
        self._layout = self._layout.after(cells)
        return Newest(path, offset + end, self._layout, cells)

    def _decide(self, path: Path, text: str, head: bytes) -> None:
        """From the whole lines at the beginning, once there is one of numbers."""
        lines = lines_of(text)[:-1]
        if not any(line.strip() for line in lines):
            if len(head) == 0 and path.stat().st_size > _WINDOW_BYTES:
                raise BadInput(f"{path}: its first line is longer than {_WINDOW_BYTES} bytes; record lines of numbers.")
            return
        layout = layout_of(lines, str(path), self._select, self._given, _HEAD_SEARCHED)
        if any(not is_blank(line) for line in lines[layout.first_line - 1 :]):
            self._layout, self._decided_by = layout, head


def _end_of_lines(data: bytes, width: int) -> int:
    """Where the last whole line ends: half a line is none, whatever stands in it."""
    end = len(data)
    while (end := data.rfind(b"\n", 0, end)) >= 0:
        if width == 1:
            return end + 1
        # The two bytes of a line feed in UTF-16, in either order, and never the halves of two letters.
        begin = end - end % 2
        if data[begin : begin + 2] in (b"\n\0", b"\0\n"):
            return begin + 2
    return 0
