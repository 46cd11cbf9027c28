"""The last line of a table without a line feed, which may be a part of a line that was copied while it was written."""

from __future__ import annotations

import re
from collections.abc import Sequence

from semlive.errors import BadInput
from semlive.inputs.text_table import Layout, is_blank

_FORM = re.compile(r"[+-]?[0-9]+(?:[.,]([0-9]*))?(?:[eEdD][+-]?([0-9]*))?")
_COMPARED_LINES = 20
_MIN_LINES = 8
"""Lines whose last numbers have equal numbers of digits, so that a program with a fixed format wrote them."""


def check_last_line(lines: Sequence[str], layout: Layout) -> None:
    """Refuse a table that ends in a part of a number: one with fewer digits than all before it, without a line feed.

    Args:
        lines: lines of the table; the last is empty if the text ends with a line feed.
        layout: layout of the table.

    Raises:
        BadInput: the last number is incomplete.
    """
    last = len(lines) - 1
    if is_blank(lines[last]) or last < layout.first_line:
        return
    before = [place for place in range(max(layout.first_line - 1, last - _COMPARED_LINES), last) if not is_blank(lines[place])]
    forms = {form for place in before if (form := _form(layout.cells(lines[place], place + 1)[-1])) is not None}
    cell = layout.cells(lines[last], last + 1)[-1]
    form = _form(cell)
    if len(before) < _MIN_LINES or len(forms) != 1 or form is None:
        return
    [(decimals, exponent)] = forms
    if form[0] < decimals or form[1] < exponent:
        problem = f"ends with {cell!r} without a line feed, fewer digits than in the lines before; its end is missing"
        raise BadInput(f"{layout.where}: line {last + 1}: {problem}; export it again, or end the line.")


def _form(cell: str) -> tuple[int, int] | None:
    """Return the digits behind the decimal sign and of the exponent; None for a text or a lost value."""
    match = _FORM.fullmatch(cell)
    return None if match is None else (len(match[1] or ""), len(match[2] or ""))
