"""Checks of a possible layout of a text table: cell counts, decimal sign, and other possible meanings."""

from __future__ import annotations

import re
from collections.abc import Sequence

from semlive.errors import BadInput
from semlive.inputs.text_cells import (
    comment_text,
    is_decoration,
    is_head_comment,
    is_no_name,
    joined_units,
    separator_declared,
    split,
    states_unit,
)
from semlive.inputs.text_head import Rows, own_separator
from semlive.inputs.text_layout import AmbiguousTable, Layout, miscounted
from semlive.inputs.text_number import Sign, is_lost, is_whole, number_in, sign_of

DEFINITE = 10**6
"""Weight of a problem in a layout that fits the head in all other respects."""
_NUMBER_AND_MORE = re.compile(r"[+-]?[0-9.]+(?:[eE][+-]?[0-9]+)?\s+\S")
_FIRST_GROUP = re.compile(r"(?:.*\s)?[+-]?[1-9][0-9]{0,2}")
_NEXT_GROUP = re.compile(r"[0-9]{3}(?![0-9])")
LINES_BELOW_A_TITLE = 3
"""This many lines with equal numbers of cells show that the text above them is a title; an incomplete line does not occur twice."""


class Misfit(Exception):
    """A layout that does not fit the table; the larger the weight, the more of the table it explains."""

    def __init__(self, weight: int, error: BadInput) -> None:
        self.weight, self.error = weight, error


def check_counts(layout: Layout, rows: Rows) -> None:
    """Refuse lines with another number of cells than the head.

    Raises:
        Misfit: a line does not fit.
    """
    expected = len(layout.columns)
    fitting = sum(len(cells) == expected for _, cells in rows)
    for number, cells in rows:
        if len(cells) != expected:
            error = miscounted(f"{layout.where}: line {number}", cells, expected, layout.separator, layout.head_line)
            raise Misfit(1000 * (1 + fitting) + expected, error)


def check_first_line(layout: Layout, rows: Rows) -> None:
    """Refuse a factor with a unit, such as ``10^3 N``, above the numbers of a required column.

    Raises:
        Misfit: the first line has such a cell, and the second has a number.
    """
    if not layout.head_line or len(rows) < 2:
        return
    (line, cells), (_, below) = rows[:2]
    for place in layout.number_places:
        text = cells[place]
        if number_in(text, "") is None and _may_be_number(below[place]) and is_no_name(text.split()[-1]):
            message = f"{layout.where}: line {line}: {text[:40]!r} below the names is neither a number nor a known unit; write the unit."
            raise Misfit(DEFINITE, BadInput(message))


def check_above(lines: Sequence[str], start: int, layout: Layout, rows: Rows, given: str) -> None:
    """Refuse numbers without names below a line of several cells, which may be a line of names above an incomplete line.

    A line of names that did not fit, and a comment with another number of cells, are such lines.

    Args:
        lines: lines of the table.
        start: place of the first line of numbers.
        layout: layout of the numbers.
        rows: first lines of numbers.
        given: separator in the settings; empty if it was detected.

    Raises:
        Misfit: there is such a line.
    """
    place = next((place for place in range(start - 1, -1, -1) if _is_text(lines[place])), None)
    if place is None:
        return
    is_comment = is_head_comment(lines[place])
    above = comment_text(lines[place]) if is_comment else lines[place]
    for separator in dict.fromkeys((layout.separator, given or own_separator(above))):
        try:
            names = split(above, separator)
        except ValueError:
            continue
        names = joined_units(names) if separator == " " else names
        if len(names) == 1 or (is_comment and len(names) == len(layout.columns)):
            continue
        occurs = separator != " " and any(separator in lines[number - 1] for number, _ in rows)
        is_title = (is_comment or separator != layout.separator) and not states_unit(above)
        if is_title and len(rows) >= LINES_BELOW_A_TITLE and not occurs:
            continue
        raise Misfit(1, miscounted(f"{layout.where}: line {start + 1}", ["?"] * len(layout.columns), len(names), separator, place + 1))


def _is_text(line: str) -> bool:
    return not is_decoration(line) and not line.startswith("***") and not separator_declared(line)


def check_pairs(layout: Layout, rows: Rows, by_name: bool, quoted: bool) -> None:
    """Refuse integers between commas that may be numbers with decimal commas.

    Without names this is always possible; with names only if commas precede units, ``Time, s,Force, N``, or end the lines: ``24,63,``.

    Args:
        layout: layout of the table.
        rows: first lines of numbers.
        by_name: the columns are required by their names.
        quoted: there are quotes in these lines.

    Raises:
        Misfit: both meanings are possible.
    """
    if layout.separator != "," or len(layout.columns) < 2 or not rows:
        return
    line, cells = rows[0]
    numeric = [place for place in range(len(layout.columns)) if all(_may_be_number(cells[place]) for _, cells in rows)]
    if any(sign_of(cells[place]) is Sign.POINT for place in numeric for _, cells in rows):
        doubtful = False
    elif layout.head_line:
        units = [is_no_name(column.raw) for column in layout.columns] + [False]
        doubtful = any(units[place + 1] for place in layout.number_places) if by_name else any(units)
        doubtful = doubtful or any(_NUMBER_AND_MORE.match(cell) for cell in cells)
        doubtful = doubtful or (not quoted and not layout.columns[-1].raw and _may_lack_last_value(rows))
    else:
        doubtful = True
    if doubtful:
        place = min(layout.number_places[0], len(cells) - 2)
        both = f"{cells[place]!r} and {cells[place + 1]!r}, or '{cells[place]},{cells[place + 1]}'"
        message = f"{layout.where}: line {line}: may mean {both}; write decimal points, or specify the decimal sign."
        raise Misfit(DEFINITE, AmbiguousTable(message))


def check_groups(layout: Layout, rows: Rows) -> None:
    """Refuse cells such as 91 and 205.5 that may be one number with the column separator between thousands.

    Raises:
        Misfit: both meanings are possible.
    """
    if layout.separator not in (",", " ") or not rows:
        return
    if layout.separator == "," and all(_is_grouped_line(cells) for _, cells in rows):
        line, cells = rows[0]
        both = f"{cells[0]} and {cells[1]}"
        message = f"{layout.where}: line {line}: {both} may be one number; write no sign between thousands."
        raise Misfit(DEFINITE, AmbiguousTable(message))
    # Without a name, the last column may be a lost value of the column before it.
    certain = layout.columns[-1].raw != "" and not any(is_no_name(column.raw) for column in layout.columns)
    if layout.separator == "," and layout.head_line and certain:
        return
    rule = all if layout.head_line else any
    for place in range(len(layout.columns) - 1):
        if rule(_FIRST_GROUP.fullmatch(cells[place]) and _NEXT_GROUP.match(cells[place + 1]) for _, cells in rows):
            line, cells = rows[0]
            both = " and ".join(cells[place : place + 2])
            message = f"{layout.where}: line {line}: {both} may be one number; write no sign between thousands, and name the columns."
            raise Misfit(DEFINITE, AmbiguousTable(message))


def _is_grouped_line(cells: Sequence[str]) -> bool:
    """Whether all cells of a line, two by two, may be groups of digits of one number, and a zero begins one of the second groups."""
    firsts, seconds = cells[::2], cells[1::2]
    return (
        len(firsts) == len(seconds)
        and all(map(_FIRST_GROUP.fullmatch, firsts))
        and all(map(_NEXT_GROUP.match, seconds))
        and any(second.startswith("0") for second in seconds)
    )


def check_description(layout: Layout, rows: Rows) -> None:
    """Refuse lines such as ``Specimen;7``, which may be a description above a table that is not written yet.

    A column of states, such as ``OK;7``, repeats its texts.

    Raises:
        Misfit: the first column is not required, and has another text in each of two columns, or few lines for each text without names.
    """
    texts = [cells[0] for _, cells in rows if cells and cells[0][:1].isalpha() and not is_lost(cells[0])]
    if not texts or 0 in layout.number_places:
        return
    different = len(set(texts))
    if (len(layout.columns) == 2 and different == len(rows)) or (not layout.head_line and LINES_BELOW_A_TITLE * different > len(texts)):
        message = f"{layout.where}: line {rows[0][0]}: may be the description of a test; name the column, or wait for lines of numbers."
        raise Misfit(DEFINITE, AmbiguousTable(message))


def check_bars(layout: Layout, rows: Rows) -> None:
    """Refuse numbers between vertical bars, which are detected as cells between blanks.

    Raises:
        Misfit: a cell contains a bar.
    """
    if layout.separator == " ":
        for line, cells in rows:
            if any("|" in cell for cell in cells):
                message = f"{layout.where}: line {line}: is separated by '|'; write tabs or semicolons, or specify the separator."
                raise Misfit(DEFINITE, BadInput(message))


def _may_lack_last_value(rows: Rows) -> bool:
    """Whether two neighbouring cells of all lines may be one number, and the last value of all lines may be lost."""
    if any(sign_of(cell) is not Sign.NONE for _, cells in rows for cell in cells):
        return False
    return any(all(is_whole(cells[place]) and cells[place + 1].isdecimal() for _, cells in rows) for place in range(len(rows[0][1]) - 1))


def _may_be_number(cell: str) -> bool:
    return is_lost(cell) or is_whole(cell) or sign_of(cell) is not Sign.NONE


def decimal_sign(layout: Layout, rows: Rows, no_thousands: bool) -> str:
    """Return the decimal sign of the head, from the required columns or else from the others; empty if no cell contains one.

    Raises:
        Misfit: both signs occur, or one that may separate thousands.
    """
    required: dict[Sign, tuple[int, str]] = {}
    optional: set[Sign] = set()
    for number, cells in rows:
        for place, cell in enumerate(cells):
            if place in layout.number_places:
                required.setdefault(sign_of(cell), (number, cell))
            else:
                optional.add(sign_of(cell))
    if Sign.POINT in required and Sign.COMMA in required:
        (line, point), (_, comma) = required[Sign.POINT], required[Sign.COMMA]
        message = f"{layout.where}: line {line}: both {point!r} and {comma!r} are numbers; write one decimal sign in all lines."
        raise Misfit(DEFINITE, AmbiguousTable(message))
    for signs in (required, optional):
        if (Sign.POINT in signs) != (Sign.COMMA in signs):
            return "." if Sign.POINT in signs else ","
    doubtful = [sign for sign in (Sign.POINT_OR_THOUSANDS, Sign.COMMA_OR_THOUSANDS) if sign in required]
    if no_thousands and len(doubtful) == 1:
        return "." if doubtful == [Sign.POINT_OR_THOUSANDS] else ","
    if doubtful:
        line, cell = required[doubtful[0]]
        small, large = cell.replace(",", "."), re.sub("[.,]", "", cell)
        raise Misfit(
            DEFINITE, AmbiguousTable(f"{layout.where}: line {line}: {cell!r} may mean {small} or {large}; specify the decimal sign.")
        )
    return ""
