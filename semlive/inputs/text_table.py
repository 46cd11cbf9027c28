"""The strict reader of text tables: how a table is written is decided once from its head; every line is read by that, or refused.

A table has a line of names, perhaps a line of units, and lines with as many cells as names. Separator (tab, semicolon, comma, blanks) and
decimal sign are those under which all lines of the head agree. Where two readings agree with the head and differ in a value, the table is
refused with both; so are thousands separators and any line with another number of cells. RFC 4180 quotes, ``sep=;`` lines and names in
comments (``# x,y,u,v``) are understood. Everything here is a function of text: `semlive.inputs.files` opens files.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

from semlive.errors import BadInput
from semlive.inputs.text_cells import (
    LONGEST_LINE,
    Column,
    columns_of,
    encoding_of,
    is_blank,
    is_comment,
    is_line_of_numbers,
    is_line_of_units,
    is_no_name,
    is_remark,
    key_of,
    lines_of,
    separator_declared,
    split,
    text_of,
)
from semlive.inputs.text_layout import WORDS, AmbiguousTable, Convention, Layout, miscounted
from semlive.inputs.text_number import Sign, is_lost, is_whole, number_in, sign_of

__all__ = [
    "LONGEST_LINE",
    "SEPARATORS",
    "AmbiguousTable",
    "Column",
    "Convention",
    "Layout",
    "Wanted",
    "encoding_of",
    "is_blank",
    "key_of",
    "layout_of",
    "lines_of",
    "number_in",
    "text_of",
]

HEAD_LINES = 200
"""So many lines of numbers decide how a table is written."""
Wanted = Callable[[tuple[Column, ...]], tuple[int, ...]]
"""Places of the columns with numbers that a caller needs; raises BadInput if the head does not name them (``{head}`` is its line)."""

SEPARATORS = ("\t", ";", ",", " ")
"""Those that are found out; a blank stands for any run of blanks."""
_NOT_QUOTED = re.compile(r'"(?:[^"]|"")*"|\([^)]*\)|\[[^\]]*\]')
_NUMBER_AND_MORE = re.compile(r"[+-]?[0-9.]+(?:[eE][+-]?[0-9]+)?\s+\S")
_FIRST_GROUP = re.compile(r"(?:.*\s)?[+-]?[1-9][0-9]{0,2}")
_NEXT_GROUP = re.compile(r"[0-9]{3}(?![0-9])")
_DEFINITE = 10**6
"""Weight of what is wrong with a reading that fits the head in all else."""
_Rows = list[tuple[int, list[str]]]


@dataclass(frozen=True, slots=True)
class _Reading:
    """A layout that fits the head, and the wanted cells under it."""

    layout: Layout
    values: tuple[tuple[float | str, ...], ...]

    @property
    def is_numeric(self) -> bool:
        """Whether all wanted cells are numbers or lost values."""
        return all(not isinstance(value, str) or not value for row in self.values for value in row)


class _Misfit(Exception):
    """A reading that does not fit; the heavier, the more of the table it explains."""

    def __init__(self, weight: int, error: BadInput) -> None:
        self.weight, self.error = weight, error


def layout_of(lines: Sequence[str], where: str, wanted: Wanted, given: Convention | None = None, searched: int = 1) -> Layout:
    """How a table is written.

    Args:
        lines: of the table, from its first; those beyond the head are not looked at.
        where: what to call it in errors.
        wanted: which columns must hold numbers.
        given: what is known beforehand.
        searched: the line of names is looked for in so many lines that are no comments; the first that fits counts.

    Raises:
        BadInput: no reading fits the head, or several do and differ.
    """
    known = _with_declared_separator(lines, given or Convention())
    refused: list[tuple[int, BadInput]] = []
    in_numbers = False
    for start in _starts(lines, searched):
        if in_numbers and not _needs_names(wanted):
            break  # the first line of numbers did not fit: no later one is taken for the first
        readings, here = list[_Reading](), list[tuple[int, BadInput]]()
        for separator in (known.separator,) if known.separator else SEPARATORS:
            try:
                readings += _readings(lines, start, separator, wanted, where, known)
            except _Misfit as misfit:
                here.append((misfit.weight, misfit.error))
        doubt = [error for weight, error in here if weight >= _DEFINITE]
        if doubt:
            raise doubt[0]
        if readings:
            return _only_one(readings, where)
        refused += here
        in_numbers = in_numbers or any(_is_line_of_numbers(lines[start], separator) for separator in SEPARATORS)
    if not refused:
        raise BadInput(f"{where}: line 1: holds no header; the first line must name the columns.")
    raise max(refused, key=lambda one: one[0])[1]


def _needs_names(wanted: Wanted) -> bool:
    """Whether columns are wanted by their names, which only the right line of a table can have."""
    try:
        wanted((Column("", "", ""),) * 1000)
    except BadInput:
        return True
    return False


def _is_line_of_numbers(line: str, separator: str) -> bool:
    try:
        return _is_used(separator, line) and is_line_of_numbers(split(line, separator))
    except ValueError:
        return False


def _with_declared_separator(lines: Sequence[str], given: Convention) -> Convention:
    """With the separator of a ``sep=;`` line."""
    declared = next((separator_declared(line) for line in lines if line.strip()), "")
    return replace(given, separator=declared) if declared and not given.separator else given


def _starts(lines: Sequence[str], searched: int) -> Iterator[int]:
    """Places of the lines that may be the line of names, or the first of numbers."""
    found = 0
    for place, line in enumerate(lines):
        if not is_blank(line) and not is_remark(line):
            yield place
            found += 1
            if found == searched:
                return


def _readings(lines: Sequence[str], start: int, separator: str, wanted: Wanted, where: str, given: Convention) -> Iterator[_Reading]:
    """The table under one separator, its head beginning at a line; nothing where that separator does not occur."""
    if not given.separator and not _is_used(separator, lines[start]):
        return
    if not given.separator and separator == "," and given.decimal == "," and '"' not in lines[start]:
        return
    at = f"{where}: line {start + 1}"
    if len(lines[start]) > LONGEST_LINE:
        raise _Misfit(0, BadInput(f"{at}: is longer than {LONGEST_LINE} characters; export the table as lines of numbers."))
    try:
        head = split(lines[start], separator)
    except ValueError as error:
        raise _Misfit(0, BadInput(f"{at}: its quotes are broken ({error}); write it as CSV.")) from error
    names, head_line, data_from = head, start + 1, start + 1
    if is_line_of_numbers(head):
        names, head_line = _names_above(lines, start, separator, len(head))
        data_from = start
    elif start and any(is_whole(cell) or sign_of(cell) is not Sign.NONE for cell in head):
        # Below a first line that did not fit, a line with a number in it is hardly one of names.
        raise _Misfit(0, BadInput(f"{at}: is no line of names; write one above the numbers."))
    columns, data_from = _with_units(columns_of(names or [""] * len(head), separator), lines, data_from, separator)
    rows = _rows(lines, data_from, separator)
    columns = _without_trailing(columns, rows)
    try:
        places = wanted(columns)
    except BadInput as error:
        raise _Misfit(len(columns), BadInput(f"{where}: {str(error).replace('{head}', f'line {head_line or start + 1}')}")) from error
    layout = Layout(where, separator, given.decimal, columns, places, head_line, data_from + 1)
    _check_counts(layout, rows)
    if not head_line and given.separator != " ":
        _check_above(lines, start, layout)
    if not given.decimal:
        _check_pairs(layout, rows, _needs_names(wanted))
        _check_groups(layout, rows)
    layout = replace(layout, decimal=given.decimal or _decimal(layout, rows, given.no_thousands))
    yield _Reading(layout, tuple(tuple(_value(cells[place], layout.decimal) for place in places) for _, cells in rows))


def _is_used(separator: str, line: str) -> bool:
    """Whether a line's columns may be separated so: the first of tab, semicolon and comma that occurs outside quotes and brackets.

    Blanks separate nothing beside these, but numbers with decimal commas; they stand for a single column, too.
    """
    bare = _NOT_QUOTED.sub("", line.strip(" \r"))
    if separator != " ":
        return next((sign for sign in SEPARATORS[:-1] if sign in bare), "") == separator
    if any(sign in bare for sign in "\t;"):
        return False
    cells = split(bare, " ")
    return "," not in bare or (is_line_of_numbers(cells) and not any(cell.endswith(",") for cell in cells))


def _names_above(lines: Sequence[str], start: int, separator: str, cells: int) -> tuple[list[str], int]:
    """The names in the comment above the numbers, and the number of its line; nothing if it is no line of names."""
    for place in range(start - 1, -1, -1):
        if lines[place].strip() and not is_remark(lines[place]):
            break
        if is_comment(lines[place]):
            line = lines[place].strip().lstrip("#").strip()
            try:
                names = split(line, separator)
            except ValueError:
                return [], 0
            # Blanks separate the words of a title, too.
            is_head = len(columns_of(names, separator)) == cells or (len(names) > 1 and (separator != " " or '"' in line))
            return (names, place + 1) if is_head else ([], 0)
    return [], 0


def _with_units(columns: tuple[Column, ...], lines: Sequence[str], data_from: int, separator: str) -> tuple[tuple[Column, ...], int]:
    """With the units of a line below the names, and where the numbers begin."""
    for place in range(data_from, min(len(lines), data_from + 3)):
        if lines[place].strip():
            cells = [] if '"' in lines[place] else split(lines[place], separator)
            if len(cells) == len(columns) and is_line_of_units(cells):
                units = [cell.strip("[]() ") for cell in cells]
                return tuple(replace(one, unit=one.unit or unit) for one, unit in zip(columns, units, strict=True)), place + 1
            break
    return columns, data_from


def _rows(lines: Sequence[str], data_from: int, separator: str) -> _Rows:
    """Numbers of the head's lines of numbers, and their cells; none where the quotes are broken or the line is too long."""
    rows: _Rows = []
    for number in range(data_from + 1, len(lines) + 1):
        line = lines[number - 1]
        if is_blank(line):
            continue
        try:
            rows.append((number, split(line, separator) if len(line) <= LONGEST_LINE else []))
        except ValueError:
            rows.append((number, []))
        if len(rows) == HEAD_LINES:
            break
    return rows


def _without_trailing(columns: tuple[Column, ...], rows: _Rows) -> tuple[Column, ...]:
    """Some programs end every line with a separator but not the head, or the other way round."""
    counts = {len(cells) for _, cells in rows}
    if counts == {len(columns) + 1} and not any(cells[-1] for _, cells in rows):
        return (*columns, Column("", "", ""))
    if counts == {len(columns) - 1} and len(columns) > 1 and not columns[-1].raw:
        return columns[:-1]
    return columns


def _check_counts(layout: Layout, rows: _Rows) -> None:
    expected = len(layout.columns)
    fitting = sum(len(cells) == expected for _, cells in rows)
    for number, cells in rows:
        if len(cells) != expected:
            error = miscounted(f"{layout.where}: line {number}", cells, expected, layout.separator, layout.head_line > 0)
            raise _Misfit(1000 * (1 + fitting) + expected, error)


def _check_above(lines: Sequence[str], start: int, layout: Layout) -> None:
    """Numbers without names below a line of several cells, which would be their names if it had as many, are refused."""
    above = next((line for line in reversed(lines[:start]) if line.strip() and not is_remark(line)), "")
    try:
        names = split(above, layout.separator)
    except ValueError:
        names = []
    if len(names) > 1:
        error = miscounted(f"{layout.where}: line {start + 1}", ["?"] * len(layout.columns), len(names), layout.separator, True)
        raise _Misfit(1, error)


def _check_pairs(layout: Layout, rows: _Rows, by_name: bool) -> None:
    """Whole numbers between commas may be numbers with decimal commas, where the names do not exclude it.

    Without names they can always be; with names only if a comma stands before units: ``Time, s,Force, N``.
    """
    if layout.separator != "," or len(layout.columns) < 2 or not rows:
        return
    line, cells = rows[0]
    numeric = [place for place in range(len(layout.columns)) if all(_may_be_number(cells[place]) for _, cells in rows)]
    if any(sign_of(cells[place]) is Sign.POINT for place in numeric for _, cells in rows):
        doubtful = False
    elif layout.head_line:
        units = [is_no_name(column.raw) for column in layout.columns] + [False]
        doubtful = any(units[place + 1] for place in layout.wanted) if by_name else any(units)
        doubtful = doubtful or any(_NUMBER_AND_MORE.match(cell) for cell in cells)
    else:
        doubtful = True
    if doubtful:
        place = min(layout.wanted[0], len(cells) - 2)
        both = f"{cells[place]!r} and {cells[place + 1]!r}, or '{cells[place]},{cells[place + 1]}'"
        message = f"{layout.where}: line {line}: may mean {both}; write decimal points, or say the decimal sign."
        raise _Misfit(_DEFINITE, AmbiguousTable(message))


def _check_groups(layout: Layout, rows: _Rows) -> None:
    """Cells such as 91 and 205.5 may be one number whose thousands are separated as the columns are, where no names exclude it."""
    if layout.separator not in (",", " ") or not rows:
        return
    if layout.separator == "," and layout.head_line and not any(is_no_name(column.raw) for column in layout.columns):
        return
    rule = all if layout.head_line else any
    for place in range(len(layout.columns) - 1):
        if rule(_FIRST_GROUP.fullmatch(cells[place]) and _NEXT_GROUP.match(cells[place + 1]) for _, cells in rows):
            line, cells = rows[0]
            both = " and ".join(cells[place : place + 2])
            message = f"{layout.where}: line {line}: {both} may be one number; write no sign between thousands, and name the columns."
            raise _Misfit(_DEFINITE, AmbiguousTable(message))


def _may_be_number(cell: str) -> bool:
    return is_lost(cell) or is_whole(cell) or sign_of(cell) is not Sign.NONE


def _decimal(layout: Layout, rows: _Rows, no_thousands: bool) -> str:
    """The decimal sign that the head shows: by the wanted cells, or else by the others; empty if nothing shows it.

    Raises:
        _Misfit: both signs, or one that may separate thousands.
    """
    found: dict[Sign, tuple[int, str]] = {}
    others: set[Sign] = set()
    for number, cells in rows:
        for place, cell in enumerate(cells):
            if place in layout.wanted:
                found.setdefault(sign_of(cell), (number, cell))
            else:
                others.add(sign_of(cell))
    if Sign.POINT in found and Sign.COMMA in found:
        (line, point), (_, comma) = found[Sign.POINT], found[Sign.COMMA]
        message = f"{layout.where}: line {line}: both {point!r} and {comma!r} are numbers; write one decimal sign in all lines."
        raise _Misfit(_DEFINITE, AmbiguousTable(message))
    for signs in (found, others):
        if (Sign.POINT in signs) != (Sign.COMMA in signs):
            return "." if Sign.POINT in signs else ","
    doubtful = [one for one in (Sign.POINT_OR_THOUSANDS, Sign.COMMA_OR_THOUSANDS) if one in found]
    if no_thousands and len(doubtful) == 1:
        return "." if doubtful == [Sign.POINT_OR_THOUSANDS] else ","
    if doubtful:
        line, cell = found[doubtful[0]]
        small, large = cell.replace(",", "."), re.sub("[.,]", "", cell)
        raise _Misfit(
            _DEFINITE, AmbiguousTable(f"{layout.where}: line {line}: {cell!r} may mean {small} or {large}; say the decimal sign.")
        )
    return ""


def _value(cell: str, decimal: str) -> float | str:
    """To be compared between readings: lost values are equal."""
    number = number_in(cell, decimal)
    return cell if number is None else "" if number != number else number


def _only_one(readings: Sequence[_Reading], where: str) -> Layout:
    """The reading, if all give the same values.

    Raises:
        BadInput: two differ.
    """
    kept = [one for one in readings if one.is_numeric] or list(readings)
    first = kept[0]
    for other in kept[1:]:
        if other.values != first.values:
            shown = [next((str(value) for row in one.values for value in row if value != ""), "nothing") for one in (first, other)]
            words = [WORDS.get(one.layout.separator, one.layout.separator) for one in (first, other)]
            both = f"{shown[0]}, separated by {words[0]}, or {shown[1]}, separated by {words[1]}"
            raise AmbiguousTable(f"{where}: line {first.layout.first_line}: may mean {both}; write one kind of separator.")
    return max(kept, key=lambda one: len(one.layout.columns)).layout
