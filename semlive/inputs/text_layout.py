"""How a text table is written, and its lines read by that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from semlive.errors import BadInput
from semlive.inputs.text_cells import LONGEST_LINE, Column, split
from semlive.inputs.text_number import Sign, is_lost, is_whole, sign_of

WORDS = {"\t": "tabs", ";": "semicolons", ",": "commas", " ": "blanks"}
"""What separators are called in errors."""


class AmbiguousTable(BadInput):
    """A table that can be read in two ways; the message gives both."""


@dataclass(frozen=True, slots=True)
class Convention:
    """What is known of a table beforehand; empty is found out.

    Attributes:
        separator: between cells; more than one character is taken literally.
        decimal: ``.`` or ``,``.
        no_thousands: thousands cannot be separated, as no value is that large: ``1.500`` is one and a half.
    """

    separator: str = ""
    decimal: str = ""
    no_thousands: bool = False


@dataclass(frozen=True, slots=True)
class Layout:
    """How a table is written.

    Attributes:
        where: what to call the table in errors.
        separator: between cells; a blank stands for any run of blanks.
        decimal: ``.`` or ``,``; empty while no number of the table has shown it.
        columns: of the head, one for each cell.
        wanted: places of the columns that the caller needs.
        head_line: number of the line of names, from 1; 0 if there is none.
        first_line: number of the first line that may hold numbers, from 1.
    """

    where: str
    separator: str
    decimal: str
    columns: tuple[Column, ...]
    wanted: tuple[int, ...]
    head_line: int
    first_line: int

    def cells(self, line: str, number: int | None = None) -> list[str]:
        """The cells of a line.

        Args:
            line: without its end.
            number: of the line, from 1, for errors; None for the newest of a growing table.

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
            raise miscounted(place, cells, len(self.columns), self.separator, self.head_line > 0)
        return cells

    def after(self, cells: Sequence[str]) -> Layout:
        """The same layout, with the decimal sign if a line's wanted cells show it for the first time."""
        if self.decimal:
            return self
        signs = {sign_of(cells[place]) for place in self.wanted}
        shown = [sign for sign, word in ((".", Sign.POINT), (",", Sign.COMMA)) if word in signs]
        return replace(self, decimal=shown[0]) if len(shown) == 1 else self


def miscounted(place: str, cells: Sequence[str], expected: int, separator: str, named: bool) -> BadInput:
    """The error for a line with another number of cells than the head, and what would explain it.

    Args:
        place: file and line.
        cells: of the line; empty if its quotes are broken.
        expected: number of cells.
        separator: between cells.
        named: whether the head is a line of names.
    """
    if not cells:
        return BadInput(f"{place}: its quotes are broken; write it as CSV.")
    message = f"{place}: has {len(cells)} cells under {expected} {'names' if named else 'cells of the first line'}"
    if separator == "," and len(cells) > expected and all(is_whole(cell) or is_lost(cell) for cell in cells):
        return BadInput(f"{message}: the numbers seem to have decimal commas; write decimal points, or separate the columns by semicolons.")
    return BadInput(f"{message}, separated by {WORDS.get(separator, repr(separator))}; write as many cells in every line.")
