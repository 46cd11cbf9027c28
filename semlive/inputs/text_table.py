"""Strict reader of text tables: the layout is decided once from the head; every line is read by this layout, or refused.

A table has a line of names, optionally a line of units, and lines with as many cells as names. Separator (tab, semicolon, comma, blanks)
and decimal sign are those under which all lines of the head agree. If two layouts fit the head and differ in a value, the table is
refused with both; thousands separators and lines with another number of cells are refused too. RFC 4180 quotes, ``sep=;`` lines and names
in comments (``# x,y,u,v``) are supported. All functions are pure functions of text: `semlive.inputs.files` opens files.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

from semlive.errors import BadInput
from semlive.inputs.text_ambiguity import (
    DEFINITE,
    LINES_BELOW_A_TITLE,
    Misfit,
    check_above,
    check_bars,
    check_counts,
    check_description,
    check_first_line,
    check_groups,
    check_pairs,
    decimal_sign,
)
from semlive.inputs.text_cells import (
    LONGEST_LINE,
    Column,
    columns_of,
    decoded,
    encoding_of,
    is_blank,
    is_line_of_numbers,
    is_no_line_of_names,
    is_no_name,
    is_unit,
    key_of,
    lines_of,
    separator_declared,
    split,
    text_of,
)
from semlive.inputs.text_head import (
    SEPARATORS,
    Rows,
    contains_numbers,
    is_above_as_many_cells,
    is_possible_separator,
    names_above,
    number_rows,
    possible_starts,
    separator_above,
    with_row_names,
    with_title_units,
    with_titles,
    with_units,
    with_units_above,
    without_trailing,
)
from semlive.inputs.text_layout import SEPARATOR_NAMES, AmbiguousTable, Convention, Layout, UnclearUnit, two_separators, wide_spans
from semlive.inputs.text_number import Sign, is_whole, number_in, sign_of

__all__ = [
    "LONGEST_LINE",
    "SEPARATORS",
    "TITLE_LINES",
    "AmbiguousTable",
    "Column",
    "ColumnSelector",
    "Convention",
    "Layout",
    "UnclearUnit",
    "decoded",
    "encoding_of",
    "is_blank",
    "key_of",
    "layout_of",
    "lines_of",
    "number_in",
    "text_of",
]

_GROUP_SIGNS = str.maketrans("", "", "'\u2019\u00a0\u202f")
_NO_NAMES = 50
"""Weight of numbers without names, more than that of a title above them."""
_QUOTES = 100
"""Weight of broken quotes in a possible line of names, more than that of numbers without names below."""
_ABOVE_NUMBERS = 500
"""Weight of a line with as many cells as the line of numbers below it: names, not a title."""
TITLE_LINES = 200
"""Lines in which the names of columns are searched below titles, for tables whose columns are required by names."""
ColumnSelector = Callable[[tuple[Column, ...]], tuple[int, ...]]
"""Returns the places of the columns of numbers that a caller requires; raises BadInput if the head does not name them (``{head}`` is its
line)."""


@dataclass(frozen=True, slots=True)
class _Reading:
    """A layout that fits the head, and the cells of the required columns under it."""

    layout: Layout
    values: tuple[tuple[float | str, ...], ...]

    @property
    def is_numeric(self) -> bool:
        """Whether all required cells are numbers or lost values."""
        return all(not isinstance(value, str) or not value for row in self.values for value in row)

    @property
    def has_thousands(self) -> bool:
        """Whether all required cells are numbers or lost values once signs between thousands are left out, as in ``15'825,9``."""
        texts = [value.translate(_GROUP_SIGNS) for row in self.values for value in row if isinstance(value, str) and value]
        return all(is_whole(text) or sign_of(text) is not Sign.NONE for text in texts)


def layout_of(lines: Sequence[str], where: str, select: ColumnSelector, given: Convention | None = None, searched: int = 1) -> Layout:
    """Determine the layout of a table.

    Args:
        lines: lines of the table from the first; those beyond the head are not used.
        where: name of the table in errors.
        select: selects the columns that must contain numbers.
        given: known parts of the layout.
        searched: number of lines, without comments, in which the line of names is searched; the first that fits is used.

    Raises:
        BadInput: no layout fits the head, or several fit and differ in a value.
    """
    convention = _with_declared_separator(lines, given or Convention())
    by_name = _needs_names(select)
    refused: list[tuple[int, BadInput]] = []
    in_numbers = False
    for start in possible_starts(lines, searched):
        if in_numbers and not by_name:
            break  # the first line of numbers did not fit, so no later line can be the first
        readings, here = list[_Reading](), list[tuple[int, BadInput]]()
        for separator in (convention.separator,) if convention.separator else SEPARATORS:
            try:
                readings += _readings(lines, start, separator, select, by_name, where, convention)
            except Misfit as misfit:
                here.append((misfit.weight, misfit.error))
        doubt = [error for weight, error in here if weight >= DEFINITE]
        if doubt:
            raise doubt[0]
        if readings:
            return _only_one(readings, where)
        refused += here
        in_numbers = in_numbers or any(contains_numbers(lines[start], separator) for separator in SEPARATORS)
    raise max(refused, key=lambda item: item[0])[1] if refused else BadInput(f"{where}: {_without_table(lines)}")


def _without_table(lines: Sequence[str]) -> str:
    """Return why text is no table, if it contains only comments and blank lines."""
    bar = next((number for number, line in enumerate(lines, 1) if line.lstrip().startswith("|")), 0)
    if bar:
        return f"line {bar}: is separated by '|'; write tabs or semicolons."
    if not any(lines):
        return "is empty; write the table again." if len(lines) < 2 else "holds blank lines only; write the table again."
    if all(map(is_blank, lines)) and not any(line.strip(" \t;,") for line in lines):
        return "holds blank lines only; write the table again."
    return "holds comments only; write a line that names the columns, and the numbers below it."


def _needs_names(select: ColumnSelector) -> bool:
    """Whether columns are required by their names, which only the line of names contains."""
    try:
        select((Column("", "", ""),) * 1000)
    except BadInput:
        return True
    return False


def _selects_number(select: ColumnSelector, cells: Sequence[str]) -> bool:
    """Whether a column that is required by its place has a number in a line."""
    try:
        return any(is_whole(cells[place]) or sign_of(cells[place]) is not Sign.NONE for place in select(columns_of(cells, "")))
    except BadInput:
        return False


def _with_declared_separator(lines: Sequence[str], given: Convention) -> Convention:
    """Return the convention with the separator of a ``sep=;`` line."""
    declared = next((separator_declared(line) for line in lines if line.strip()), "")
    return replace(given, separator=declared) if declared and not given.separator else given


def _readings(
    lines: Sequence[str], start: int, separator: str, select: ColumnSelector, by_name: bool, where: str, given: Convention
) -> Iterator[_Reading]:
    """Yield the table under one separator, with the head beginning at a line; nothing if the separator does not occur.

    Raises:
        Misfit: the table does not fit.
    """
    if not given.separator and not is_possible_separator(separator, lines[start]):
        return
    if not given.separator and separator == "," and given.decimal == "," and '"' not in lines[start]:
        return
    at = f"{where}: line {start + 1}"
    if len(lines[start]) > LONGEST_LINE:
        raise Misfit(0, BadInput(f"{at}: is longer than {LONGEST_LINE} characters; export the table as lines of numbers."))
    try:
        head = split(lines[start], separator)
    except ValueError as error:
        raise Misfit(_QUOTES, BadInput(f"{at}: its quotes are broken ({error}); write it as CSV.")) from error
    names, head_line, data_from = head, start + 1, start + 1
    if is_line_of_numbers(head):
        names, head_line = names_above(lines, start, separator, len(head))
        data_from = start
    elif start and any(is_whole(cell) or sign_of(cell) is not Sign.NONE for cell in head):
        # Below a first line that did not fit, a line that contains a number is not a line of names.
        raise Misfit(0, BadInput(f"{at}: is no line of names; write one above the numbers."))
    elif (
        is_no_line_of_names(head, lines[start], separator) and not (by_name and is_above_as_many_cells(head, lines, start, separator))
    ) or (not by_name and _selects_number(select, head)):
        raise Misfit(0, BadInput(f"{at}: is no line of names, because it contains numbers or lost values; write one above the numbers."))
    named_from = data_from
    columns = with_units_above(columns_of(names or [""] * len(head), separator), lines, head_line - 1, separator)
    columns, data_from = with_units(columns, lines, data_from, separator)
    if separator == "," and data_from > named_from and not all(is_unit(column.unit) for column in columns) and not by_name:
        message = f"{where}: line {data_from}: may hold units or names; name the columns, or specify the separator."
        raise Misfit(DEFINITE, AmbiguousTable(message))
    rows = number_rows(lines, data_from, separator)
    columns = without_trailing(columns, rows, lines, separator)
    columns = with_titles(with_title_units(columns, lines, start), lines, head_line, data_from, rows, separator)
    columns = with_row_names(columns, rows, lines, head_line, separator) if by_name else columns
    try:
        places = select(columns)
    except BadInput as error:
        other = "" if head_line else separator_above(lines, start, len(head))
        if other not in ("", separator):
            raise Misfit(DEFINITE - 1, BadInput(f"{at}: {two_separators(other, separator)}")) from error
        if not names and by_name and all(number_in(cell, "") is not None or sign_of(cell) is not Sign.NONE for cell in head):
            message = f"{at}: holds numbers without names; write a line above it that names the columns."
            raise Misfit(_NO_NAMES, BadInput(message)) from error
        message = f"{where}: {str(error).replace('{head}', f'line {head_line or start + 1}')}"
        if isinstance(error, UnclearUnit):
            raise Misfit(DEFINITE, BadInput(message)) from error
        raise Misfit(_weight(columns, rows) if head_line else 0, BadInput(message)) from error
    spans = wide_spans(lines[number - 1] for number, _ in rows) if separator == " " else ()
    layout = Layout(where, separator, given.decimal, columns, places, head_line, data_from + 1, spans)
    layout = _checked(layout, rows, lines, start, by_name, given)
    yield _Reading(layout, tuple(tuple(_value(cells[place], layout.decimal) for place in places) for _, cells in rows))


def _checked(layout: Layout, rows: Rows, lines: Sequence[str], start: int, by_name: bool, given: Convention) -> Layout:
    """Return a layout with its decimal sign if the first lines fit it in all respects.

    Raises:
        Misfit: they do not, or another meaning is possible.
    """
    check_counts(layout, rows)
    check_first_line(layout, rows)
    # A line of units above so few lines may be that of longer names, and the lines incomplete.
    only_units = len(rows) < LINES_BELOW_A_TITLE and all(is_no_name(column.raw) for column in layout.columns)
    if (not layout.head_line or only_units) and given.separator != " ":
        check_above(lines, start, layout, rows, given.separator)
    if not by_name:
        check_description(layout, rows)
    if not given.separator:
        check_bars(layout, rows)
    if not given.decimal:
        check_pairs(layout, rows, by_name, any('"' in lines[number - 1] for number, _ in rows))
        check_groups(layout, rows)
    return replace(layout, decimal=given.decimal or decimal_sign(layout, rows, given.no_thousands))


def _weight(columns: Sequence[Column], rows: Rows) -> int:
    """Return the weight of a line of names without a required column: large above a line of numbers with as many cells."""
    above_numbers = bool(rows) and len(rows[0][1]) == len(columns) and is_line_of_numbers(rows[0][1])
    return len(columns) + (_ABOVE_NUMBERS if above_numbers and not all(is_no_name(column.raw) for column in columns) else 0)


def _value(cell: str, decimal: str) -> float | str:
    """Return a value that can be compared between layouts: lost values are equal."""
    number = number_in(cell, decimal)
    return cell if number is None else "" if number != number else number


def _only_one(readings: Sequence[_Reading], where: str) -> Layout:
    """Return the layout if all readings have the same values.

    Raises:
        BadInput: two differ.
    """
    is_any_numeric = any(reading.is_numeric for reading in readings)
    candidates = [reading for reading in readings if not is_any_numeric or reading.is_numeric or reading.has_thousands]
    first = candidates[0]
    for second in candidates[1:]:
        if second.values != first.values:
            pair = (first, second)
            shown = [next((str(value) for row in reading.values for value in row if value != ""), "nothing") for reading in pair]
            names = [SEPARATOR_NAMES.get(reading.layout.separator, reading.layout.separator) for reading in pair]
            both = f"{shown[0]}, separated by {names[0]}, or {shown[1]}, separated by {names[1]}"
            raise AmbiguousTable(f"{where}: line {first.layout.first_line}: may mean {both}; write one kind of separator.")
    return max(candidates, key=lambda reading: len(reading.layout.columns)).layout
