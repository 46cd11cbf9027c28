"""Search for the head of a text table: the line of names, the line of units, and the first lines of numbers."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace

from semlive.inputs.text_cells import (
    LONGEST_LINE,
    Column,
    comment_text,
    is_blank,
    is_decoration,
    is_head_comment,
    is_line_of_numbers,
    is_line_of_units,
    is_no_name,
    is_remark,
    is_unit,
    joined_units,
    split,
    units_stated,
)
from semlive.inputs.text_number import Sign, is_lost, sign_of

HEAD_LINES = 200
"""Number of lines of numbers that decide how a table is written."""
SEPARATORS = ("\t", ";", ",", " ")
"""Separators that are detected; a blank means any sequence of blanks."""
Rows = list[tuple[int, list[str]]]
"""Line number, from 1, and cells of each line of numbers."""
_UNIT_LINES = 3
_GROUPED = re.compile(r"[-+]?\d{1,3}(\.\d{3})+,\d*")
"""A number with groups of three digits and a decimal comma, which is refused by name."""
_ROW_NAME = re.compile(r'\s*("(?:[^"]|"")+")\s*(.*)', re.DOTALL)
_QUOTED = re.compile(r'"((?:[^"]|"")*)"')
_NOT_QUOTED = re.compile(r'"(?:[^"]|"")*"|\([^)]*\)|\[[^\]]*\]|\{[^}]*\}')


_MIN_NAMES = 5
"""Names above as many cells of a line of numbers, so that a decimal comma in a title is no explanation: ``Alarm 101,102 (mm)``."""


def is_above_as_many_cells(names: Sequence[str], lines: Sequence[str], start: int, separator: str) -> bool:
    """Whether all cells of a line are texts and the next line contains numbers in as many cells."""
    below = next((_cells(line, separator) for line in lines[start + 1 :] if not is_blank(line)), [])
    texts = all(any(map(str.isalpha, name)) and not is_lost(name) for name in names)
    return texts and len(names) == len(below) >= _MIN_NAMES and is_line_of_numbers(below)


def own_separator(line: str) -> str:
    """Return the separator of a line by itself: the first of tab, semicolon and comma outside quotes and brackets, or else blanks."""
    unquoted = _NOT_QUOTED.sub("", line.strip(" \r"))
    return next((sign for sign in SEPARATORS[:-1] if sign in unquoted), " ")


def contains_numbers(line: str, separator: str) -> bool:
    """Whether a line, split at a separator, is a line of numbers."""
    try:
        return is_possible_separator(separator, line) and is_line_of_numbers(split(line, separator))
    except ValueError:
        return False


def possible_starts(lines: Sequence[str], searched: int) -> Iterator[int]:
    """Yield the places of lines that may be the line of names or the first line of numbers."""
    count = 0
    for place, line in enumerate(lines):
        if not is_blank(line) and not is_remark(line):
            yield place
            count += 1
            if count == searched:
                return


def is_possible_separator(separator: str, line: str) -> bool:
    """Whether a separator is possible for a line: the first of tab, semicolon and comma that occurs outside quotes and brackets.

    Blanks are separators in lines without these, except in numbers with decimal commas; they are possible for a single column, too.
    """
    unquoted = _NOT_QUOTED.sub("", line.strip(" \r"))
    if separator != " ":
        return own_separator(line) == separator
    if any(sign in unquoted for sign in "\t;"):
        return False
    cells = split(unquoted, " ")
    # In "92.90,477 171.76" the comma separates, and a blank groups digits.
    plain = not any(cell.endswith(",") or cell.count(",") > 1 or ("," in cell and "." in cell and not _GROUPED.fullmatch(cell))
                    for cell in cells)  # fmt: skip
    return "," not in unquoted or (is_line_of_numbers(cells) and plain)


def names_above(lines: Sequence[str], start: int, separator: str, cells: int) -> tuple[list[str], int]:
    """Return the names in the comment above the numbers and its line number; no names and 0 if it is not a line of names.

    A comment of units is joined with the names in the comment above it.
    """
    for place in range(start - 1, -1, -1):
        if lines[place].strip() and not is_remark(lines[place]):
            break
        if is_head_comment(lines[place]) and not is_decoration(lines[place]):
            names, is_head = _names_in(comment_text(lines[place]), separator, cells, lines[start])
            if is_head and all(map(is_unit, names)) and any(map(is_no_name, names)):
                above, line = names_above(lines, place, separator, cells)
                above = above if len(above) == len(names) else [str(number) for number in range(1, len(names) + 1)]
                return [f"{name} ({unit})" for name, unit in zip(above, names, strict=True)], line or place + 1
            return (names, place + 1) if is_head else ([], 0)
    return [], 0


def separator_above(lines: Sequence[str], start: int, cells: int) -> str:
    """Return the separator of a comment above the numbers that has so many cells by itself; empty if it has another number."""
    for line in reversed(lines[:start]):
        if line.strip() and not is_remark(line):
            break
        if is_head_comment(line) and not is_decoration(line):
            text = comment_text(line)
            separator = own_separator(text)
            names = _cells(text, separator)
            return separator if len(joined_units(names) if separator == " " else names) == cells > 1 else ""
    return ""


def _names_in(text: str, separator: str, cells: int, below: str) -> tuple[list[str], bool]:
    """Return the cells of a comment above a line of so many cells, and whether they can be names."""
    barred = [name.strip() for name in text.strip("| ").split("|")]
    if len(barred) > 1 and len(barred) == cells:
        return barred, True
    try:
        if separator == " " and own_separator(text) != " ":
            own = own_separator(text)
            names = _before_units(text) if own == "," else []
            names = names or ([] if own in below else split(text, own))  # "# x,y" above "1 2"
            return names, len(names) == cells and (cells > 1 or own != ";")
        names = split(text, separator)
    except ValueError:
        return [], False
    joined = joined_units(names) if separator == " " else names
    # A title contains blanks, too.
    return joined, len(joined) == cells or (len(names) > 1 and (separator != " " or '"' in text))


def _before_units(text: str) -> list[str]:
    """Return the names of ``Time, s, Force, kN`` or ``Time, s Force, kN`` with their units; empty if a comma precedes something else."""
    names = joined_units(split(text, " "))
    if all("," not in name or is_no_name(name.rpartition(", ")[2]) for name in names):
        return names
    cells = split(text, ",")
    pairs = list(zip(cells[::2], cells[1::2], strict=False))
    complete = len(cells) % 2 == 0 and all(is_no_name(unit) and not is_no_name(name) for name, unit in pairs)
    return [f"{name}, {unit}" for name, unit in pairs] if complete else []


def with_units(columns: tuple[Column, ...], lines: Sequence[str], data_from: int, separator: str) -> tuple[tuple[Column, ...], int]:
    """Return the columns with the units of a line below the names, and the place of the first line of numbers.

    Of several lines of texts below the names, the first with a known unit is that of the units. The names may be there twice.
    """
    texts: list[list[str]] = []
    first = data_from
    for place in range(data_from, min(len(lines), data_from + _UNIT_LINES)):
        cells = _cells(lines[place], separator)
        if not lines[place].strip():
            continue
        if len(cells) != len(columns) or not is_line_of_units(cells):
            break
        texts += [cells] if cells != [column.raw for column in columns] else []
        first = place + 1
    units = next((cells for cells in texts if any(map(is_no_name, cells))), texts[0] if texts else [])
    return _with_units(columns, units), first


def with_title_units(columns: tuple[Column, ...], lines: Sequence[str], head: int) -> tuple[Column, ...]:
    """Return the columns; those without a unit with the units that the titles above state for all columns, or by a name."""
    stated = [(number, key, unit) for number, line in enumerate(lines[:head], 1) for key, unit in units_stated(line)]
    if not stated:
        return columns
    units = [tuple((at, unit) for at, key, unit in stated if key in ("", column.key or key)) for column in columns]
    return tuple(column if column.unit else replace(column, title_units=own) for column, own in zip(columns, units, strict=True))


def with_titles(
    columns: tuple[Column, ...], lines: Sequence[str], head_line: int, data_from: int, rows: Rows, separator: str
) -> tuple[Column, ...]:
    """Return the columns with the lines above the first line of numbers, without those of names and of units below them.

    Directly above numbers without names, a line with as many cells is one of names that were refused for another reason.
    """
    first = rows[0][0] - 1 if rows and head_line else data_from
    head = range(head_line - 1, data_from) if head_line else ()
    titles = [(place + 1, line) for place, line in enumerate(lines[:first]) if place not in head and line.strip()]
    if not head_line and titles and len(_cells(titles[-1][1], separator)) == len(columns):
        titles = titles[:-1]
    return tuple(replace(column, titles=tuple(titles)) for column in columns) if titles else columns


def with_units_above(columns: tuple[Column, ...], lines: Sequence[str], head: int, separator: str) -> tuple[Column, ...]:
    """Return the columns with the units of a line of texts directly above the names, if one of them is a known unit."""
    cells = _cells(lines[head - 1], separator) if head > 0 else []
    is_units = len(cells) == len(columns) > 1 and is_line_of_units(cells) and any(map(is_no_name, cells))
    return _with_units(columns, cells if is_units else [])


def _with_units(columns: tuple[Column, ...], cells: Sequence[str]) -> tuple[Column, ...]:
    """Return the columns with the units in the cells; two different units of a column are both named."""
    return tuple(
        replace(column, unit=_one_unit(column.unit, cell.strip("[](){}<> "))) for column, cell in zip(columns, cells, strict=True)
    ) if cells else columns  # fmt: skip


def _one_unit(unit: str, other: str) -> str:
    if not unit or not other or unit.casefold() == other.casefold():
        return unit or other
    return f"{unit} and {other}" if is_unit(unit) and is_unit(other) else other if is_unit(other) else unit


def _cells(line: str, separator: str) -> list[str]:
    try:
        return split(line, separator) if len(line) <= LONGEST_LINE else []
    except ValueError:
        return []


def number_rows(lines: Sequence[str], data_from: int, separator: str) -> Rows:
    """Return the first lines of numbers; without cells where the quotes are broken or the line is too long."""
    rows: Rows = []
    for number in range(data_from + 1, len(lines) + 1):
        line = lines[number - 1]
        if is_blank(line):
            continue
        rows.append((number, _cells(line, separator)))
        if len(rows) == HEAD_LINES:
            break
    return rows


def without_trailing(columns: tuple[Column, ...], rows: Rows, lines: Sequence[str], separator: str) -> tuple[Column, ...]:
    """Adapt the columns to programs that end every line but the head with a separator, or only the head.

    An empty cell in quotes is a cell. One line alone that has lost another value may also have gained a cell.
    """
    counts = {len(cells) for _, cells in rows}
    if counts == {len(columns) + 1} and columns[-1].raw and not any(cells[-1] for _, cells in rows):
        is_unquoted = all(lines[number - 1].rstrip(" \r\n").endswith(separator) for number, _ in rows)
        if is_unquoted and (len(rows) > 1 or not any(is_lost(cell) for cell in rows[0][1][:-1])):
            return (*columns, Column("", "", ""))
    unused = ("", "Comment") if separator == "\t" else ("",)  # LabVIEW writes few comments
    if counts == {len(columns) - 1} and len(columns) > 1 and columns[-1].raw in unused:
        return columns[:-1]
    return columns


def with_row_names(columns: tuple[Column, ...], rows: Rows, lines: Sequence[str], head_line: int, separator: str) -> tuple[Column, ...]:
    """Return the columns with one for the names of rows, which R writes (``write.table``) without a name in the head.

    R writes names in quotes and numbers without. Numbers that begin the lines without quotes may also be those of the first name, and a
    cell without a name the last. Between commas, a decimal point shows that none of the commas is a decimal sign. Lines that end with the
    separator may have no names, and one line alone may have gained a cell; of R it begins with "1".
    """
    if any(lines[number - 1].rstrip(" \r\n").endswith(separator) for number, _ in rows) or (len(rows) == 1 and rows[0][1][:1] != ["1"]):
        return columns
    if separator == "," and not any(sign_of(cell) is Sign.POINT for _, cells in rows for cell in cells):
        return columns
    if not head_line or not rows or {len(cells) for _, cells in rows} != {len(columns) + 1} or not _is_in_quotes(lines[head_line - 1]):
        return columns
    matches = [_ROW_NAME.fullmatch(lines[number - 1]) for number, _ in rows]
    names = {
        match[1]
        for match in matches
        if match is not None and not any(_is_number(cell) or is_lost(cell) for cell in _QUOTED.findall(match[2]))
    }
    return (Column("", "", ""), *columns) if len(names) == len(rows) else columns


def _is_in_quotes(line: str) -> bool:
    return '"' in line and not any(map(str.isalnum, _QUOTED.sub("", line)))


def _is_number(cell: str) -> bool:
    return is_line_of_numbers([cell]) if cell else False
