"""Search for a second line of names or units in a growing table, which may give the columns another meaning."""

from __future__ import annotations

import re
from typing import BinaryIO

from semlive.inputs.text_cells import columns_of, is_no_name, split
from semlive.inputs.text_table import Layout, decoded, number_in

_BLOCK_BYTES = 1 << 20
_BEGINS_WITH_LETTER = re.compile(r"^\W{0,2}[^\W\d_].*", re.MULTILINE)


class LaterHeads:
    """Searches each byte of a file once.

    Args:
        layout: layout of the table.
        head: lines above the numbers, which may be repeated.
        begin: byte at which the search begins, the first of a line.
        encoding: encoding of the file.
    """

    def __init__(self, layout: Layout, head: list[str], begin: int, encoding: str) -> None:
        self._layout, self._encoding, self._searched = layout, encoding, begin
        self._known = {line.strip() for line in head}
        self._names = {key for column in layout.columns for key in (column.key, column.raw.casefold()) if key}
        self._found = ""

    def changed_in(self, stream: BinaryIO, end: int) -> str:
        """Return a line of other names or units than in the head; empty if there is none up to a byte, the end of a line."""
        while not self._found and self._searched < end:
            stream.seek(self._searched)
            block = stream.read(min(_BLOCK_BYTES, end - self._searched))
            if not block:
                break
            complete = block[: block.rfind(b"\n") + 1] if self._searched + len(block) < end else block
            complete = complete[: len(complete) - len(complete) % 2] if self._encoding.startswith("utf-16") else complete
            complete = complete or block
            self._searched += len(complete)
            lines = _BEGINS_WITH_LETTER.findall(decoded(complete, self._encoding).replace("\r", ""))
            self._found = next((line for line in lines if self._is_other_head(line)), "")
        return self._found

    def _is_other_head(self, line: str) -> bool:
        if line.strip() in self._known:
            return False
        try:
            columns = columns_of(split(line, self._layout.separator), self._layout.separator)
        except ValueError:
            return False
        if len(columns) != len(self._layout.columns):
            return False
        required = [columns[place] for place in self._layout.number_places]
        is_text = all(number_in(column.raw, "") is None for column in required)
        return is_text and any(column.key in self._names or is_no_name(column.raw) for column in required)
