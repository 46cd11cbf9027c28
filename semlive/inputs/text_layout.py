"""Layout of a text table, and its lines split into cells."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from semlive.errors import BadInput
from semlive.inputs.text_cells import LONGEST_LINE, TOKEN, Column, is_line_of_numbers, split
from semlive.inputs.text_head import own_separator
from semlive.inputs.text_number import Sign, is_lost, is_whole, sign_of

SEPARATOR_NAMES = {"\t": "tabs", ";": "semicolons", ",": "commas", " ": "blanks"}
"""Names of separators in errors."""
_ONE_DIGIT = re.compile(r"[+-]?[0-9]")
_WHOLE_WITH_EXPONENT = re.compile(r"[0-9]+[eEdD][+-]?[0-9]+$")
_SIGN = re.compile(r"[+-]")
_GROUPED = re.compile(r"[+-]?[0-9]{1,3}(?: [0-9]{3})+(?:\.[0-9]*)?")
_BEGINS_WITH_DIGIT = re.compile(r"[0-9.,]")
_ONE_BLANK_IN_DIGITS = re.compile(r"(?:^|(?<=\s))([+-]?[1-9][0-9]{0,2})\s([0-9]{3}(?![0-9])\S*)")


class AmbiguousTable(BadInput):
    """A table with two possible meanings; the message contains both."""


class UnclearUnit(BadInput):
    """A column without a unit in a table whose titles state another unit than the usual one; no other layout changes this."""


@dataclass(frozen=True, slots=True)
class Convention:
    """Known parts of the layout of a table; empty parts are detected.

    Attributes:
        separator: between cells; several characters are one separator.
        decimal: ``.`` or ``,``.
        no_thousands: there are no thousands separators, because no value is that large: ``1.500`` is one and a half.
    """

    separator: str = ""
    decimal: str = ""
    no_thousands: bool = False


@dataclass(frozen=True, slots=True)
class Layout:
    """Layout of a table.

    Attributes:
        where: name of the table in errors.
        separator: between cells; a blank means any sequence of blanks.
        decimal: ``.`` or ``,``; empty as long as no number contains one.
        columns: columns of the head, one for each cell.
        number_places: places of the columns of numbers that the caller requires.
        head_line: number of the line of names, from 1; 0 if there is none.
        first_line: number of the first line that may hold numbers, from 1.
        spans: first and last place of each cell in a line of numbers whose cells are at least two blanks apart; empty without one.
    """

    where: str
    separator: str
    decimal: str
    columns: tuple[Column, ...]
    number_places: tuple[int, ...]
    head_line: int
    first_line: int
    spans: tuple[tuple[int, int], ...] = ()

    def cells(self, line: str, number: int | None = None) -> list[str]:
        """Split a line into cells.

        Args:
            line: the line without its end.
            number: number of the line, from 1, for errors; None for the newest line of a growing table.

        Raises:
            BadInput: it is too long, its quotes are broken, or it has another number of cells than the head.
        """
        place = f"{self.where}: {'the newest line' if number is None else f'line {number}'}"
        if len(line) > LONGEST_LINE:
            raise BadInput(f"{place}: is longer than {LONGEST_LINE} characters; export the table as lines of numbers.")
        try:
            cells = split(line, self.separator)
        except ValueError as error:
            raise BadInput(f"{place}: its quotes are broken ({error}); write it as CSV.") from error
        if len(cells) != len(self.columns):
            raise miscounted(place, cells, len(self.columns), self.separator, self.head_line)
        if self.separator == " ":
            self._check_blanks(line, place)
        if self.separator == " " or (self.separator == "," and self.decimal != "."):
            self._check_parts(cells, place)
        return cells

    def _check_blanks(self, line: str, place: str) -> None:
        """Refuse ``"0,01";"208 347"`` and ``0,5 994`` as two columns, where the blanks may group digits between other separators."""
        if ";" in line:
            raise AmbiguousTable(f"{place}: has blanks and semicolons; write one separator in all lines.")
        parts = [part.strip() for part in line.split(",")]
        if len(parts) == len(self.columns) > 1 and any(map(_GROUPED.fullmatch, parts)):
            raise AmbiguousTable(f"{place}: its blanks may group digits between commas; write no blanks in numbers.")
        grouped = _ONE_BLANK_IN_DIGITS.search(line) if self.spans else None
        if grouped is not None and not _is_aligned(spans_of(line), self.spans):
            both = f"{grouped[1]!r} and {grouped[2]!r}, or '{grouped[1]} {grouped[2]}'"
            raise AmbiguousTable(f"{place}: may mean {both}; other cells are more blanks apart; write no blanks in numbers.")

    def _check_parts(self, cells: Sequence[str], place: str) -> None:
        """Refuse ``-2,788e+01`` between commas and ``- 1.5`` between blanks, which are rather one number than two cells."""
        first_part, second_part = (_ONE_DIGIT, _WHOLE_WITH_EXPONENT) if self.separator == "," else (_SIGN, _BEGINS_WITH_DIGIT)
        for first, second in itertools.pairwise(cells):
            if first_part.fullmatch(first) and second_part.match(second):
                both = f"{first!r} and {second!r}, or '{first}{self.separator}{second}'"
                raise AmbiguousTable(f"{place}: may mean {both}; write decimal points, or specify the decimal sign.")

    def after(self, cells: Sequence[str]) -> Layout:
        """Return the layout with the decimal sign if the required cells of a line are the first to contain it."""
        if self.decimal:
            return self
        signs = {sign_of(cells[place]) for place in self.number_places}
        shown = [sign for sign, kind in ((".", Sign.POINT), (",", Sign.COMMA)) if kind in signs]
        return replace(self, decimal=shown[0]) if len(shown) == 1 else self


def spans_of(line: str) -> tuple[tuple[int, int], ...]:
    """Return the first and the last place of each cell of a line that is split at blanks."""
    return tuple((match.start(), match.end()) for match in TOKEN.finditer(line))


def wide_spans(lines: Iterable[str]) -> tuple[tuple[int, int], ...]:
    """Return the places of the cells in the first line whose cells are at least two blanks apart; empty if there is none."""
    for spans in map(spans_of, lines):
        if len(spans) > 1 and all(after[0] - before[1] > 1 for before, after in itertools.pairwise(spans)):
            return spans
    return ()


def _is_aligned(spans: Sequence[tuple[int, int]], others: Sequence[tuple[int, int]]) -> bool:
    """Whether the cells of two lines begin or end at the same places, as a program with columns of fixed width writes them."""
    return any([span[side] for span in spans] == [span[side] for span in others] for side in (0, 1))


def two_separators(names: str, numbers: str) -> str:
    """Return the reason for a refusal where names and numbers have different separators."""
    return (
        f"has {SEPARATOR_NAMES.get(numbers, repr(numbers))} between the numbers, but {SEPARATOR_NAMES.get(names, repr(names))} between "
        "the names; write one separator in all lines."
    )


def miscounted(place: str, cells: Sequence[str], expected: int, separator: str, named: int) -> BadInput:
    """Return the error for a line with another number of cells than the head, with a possible cause.

    Args:
        place: file and line.
        cells: cells of the line; empty if its quotes are broken.
        expected: number of cells.
        separator: between cells.
        named: number of the line of names; 0 without.
    """
    if not cells:
        return BadInput(f"{place}: its quotes are broken; write it as CSV.")
    other = own_separator(cells[0]) if len(cells) == 1 else separator
    numbers = cells[0].split(None if other == " " else other)
    if other != separator and len(numbers) == expected and is_line_of_numbers(numbers):
        return BadInput(f"{place}: {two_separators(separator, other)}")
    message = f"{place}: has {len(cells)} cells under {expected} {'names' if named else 'cells of the first line'}"
    if separator == "," and len(cells) > expected and all(is_whole(cell) or is_lost(cell) for cell in cells):
        return BadInput(f"{message}: the numbers seem to have decimal commas; write decimal points, or separate the columns by semicolons.")
    return BadInput(f"{message}, separated by {SEPARATOR_NAMES.get(separator, repr(separator))}; write as many cells in every line.")
