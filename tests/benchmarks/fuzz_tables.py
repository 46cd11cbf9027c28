"""Random text tables under random conventions, whose writer knows every number: each is read right, or the table is refused.

python tests/benchmarks/fuzz_tables.py [TABLES] [FIRST_SEED]
"""

from __future__ import annotations

import random
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from decimal import Decimal

from semlive.errors import BadInput
from semlive.inputs.text_table import Column, Convention, is_blank, key_of, layout_of, lines_of, number_in, text_of

NAMES = ("Time", "Force", "Ext", "Strain", "Kraft", "u", "v", "x_1", "Load cell", "Weg")
UNITS = ("s", "N", "kN", "mm", "um", "%", "px", "MPa")
LOST = ("", "nan", "NaN", "-nan(ind)", "#N/A", "--", "1.#QNAN")
WORDS = ("OK", "running", "26.11.2026", "12:03:44", "7", "ramp up", "hold, step 2", "A;B", "2026-11-26 12:03")
PLAIN_WORDS = 5


@dataclass(frozen=True)
class Style:
    """How a table is written."""

    separator: str
    decimal: str
    thousands: str
    digits: int
    trim: bool
    quotes: str
    units: str
    head: str
    end: str
    trailing: bool
    text_column: bool
    lost: float
    torn: float
    encoding: str


@dataclass(frozen=True)
class Written:
    """A table as bytes, and what its writer meant."""

    data: bytes
    style: Style
    wanted: tuple[str | int, ...]
    truth: dict[int, tuple[float | None, ...] | None]
    """By the number of the line; None for a line that lost or gained a cell."""


def a_style(rng: random.Random) -> Style:
    """Most are as programs write, some as none should."""
    decimal = rng.choice(".,")
    odd = rng.random() < 0.25
    return Style(
        separator=rng.choice(("\t", ";", ",", ",", " ", "  ", ", ", "; ")),
        decimal=decimal,
        thousands=rng.choice(("." if decimal == "," else ",", "'", " ")) if odd and rng.random() < 0.5 else "",
        digits=rng.choice((0, 0, 1, 2, 3, 3, 3, 5)),
        trim=rng.random() < 0.25,
        quotes=rng.choice(("none", "none", "needed", "all")),
        units=rng.choice(("none", "none", "brackets", "square", "slash", "line", "comma")),
        head=rng.choice(("names", "names", "names", "comment", "none", "told", "preamble")),
        end=rng.choice(("\n", "\r\n")),
        trailing=rng.random() < 0.1,
        text_column=rng.random() < 0.3,
        lost=rng.choice((0.0, 0.0, 0.0, 0.1)),
        torn=rng.choice((0.0, 0.0, 0.05)),
        encoding=rng.choice(("utf-8", "utf-8", "utf-8-sig", "utf-16")),
    )


def a_number(rng: random.Random, scale: float, style: Style) -> tuple[str, float]:
    """A number as written, and its value."""
    value = rng.choice((1, 1, 1, -1)) * scale * rng.random()
    if rng.random() < 0.05:
        text = f"{value:.3e}"
    else:
        text = f"{value:.{style.digits}f}"
        if style.trim and "." in text:
            text = text.rstrip("0").rstrip(".")
    truth = float(Decimal(text))
    whole, point, rest = text.partition(".")
    if style.thousands and "e" not in text:
        sign, whole = ("-", whole[1:]) if whole.startswith("-") else ("", whole)
        whole = sign + f"{int(whole):,}".replace(",", style.thousands)
    return whole + (style.decimal if point else "") + rest, truth


def quoted(cell: str, style: Style) -> str:
    """The cell as RFC 4180 has it, or as a program without quotes writes it."""
    needed = any(sign in cell for sign in (style.separator.strip() or style.separator[0], '"'))
    if style.quotes == "all" or (style.quotes == "needed" and needed):
        return '"' + cell.replace('"', '""') + '"'
    return cell


def written(seed: int) -> Written:
    """A table of its own for each seed."""
    rng = random.Random(seed)
    style = a_style(rng)
    blanks = not style.separator.strip(" ")
    count, lines_count = rng.randint(1, 6), rng.choice((1, 2, 3, 8, 30))
    if count == 1 or style.head == "none":
        style = replace(style, torn=0.0)  # the first line alone says how many cells there are
    if style.separator.strip() == style.decimal and style.quotes == "none":
        style = replace(style, torn=0.0)  # a lost cell and a decimal comma make up for each other
    if style.torn:
        style = replace(style, trailing=False)  # a lost cell and one more separator make up for each other
    names = [name.replace(" ", "_") if blanks else name for name in rng.sample(NAMES, count)]
    scales = [10 ** rng.uniform(-2, 6) for _ in names]
    text_at = rng.randrange(count + 1) if style.text_column else None
    units = [rng.choice(UNITS) for _ in names]
    rows, truth = [], list[tuple[float | None, ...] | None]()
    for _ in range(lines_count):
        cells, values = [], list[float | None]()
        for scale in scales:
            if rng.random() < style.lost:
                cells.append(rng.choice(LOST[1:] if blanks else LOST))
                values.append(None)
            else:
                cell, value = a_number(rng, scale, style)
                cells.append(cell)
                values.append(value)
        if text_at is not None:
            # A text with the separator in it and a lost cell can make up for each other.
            cells.insert(text_at, rng.choice(WORDS[:PLAIN_WORDS] if style.torn or style.lost or blanks or style.head == "none" else WORDS))
        torn = rng.random() < style.torn
        if torn:
            cells = cells[: rng.randrange(len(cells))] if rng.random() < 0.5 else [*cells, cells[0]]
        rows.append(style.separator.join(quoted(cell, style) for cell in cells) + (style.separator if style.trailing else ""))
        truth.append(None if torn else tuple(values))
    wanted: tuple[str | int, ...]
    chosen = sorted(rng.sample(range(count), rng.randint(1, min(2, count))))
    by_number = rng.random() < 0.3 or style.head == "none"
    shift = [place + (text_at is not None and place >= text_at) for place in chosen]
    wanted = tuple(place + 1 for place in shift) if by_number else tuple(names[place] for place in chosen)
    head = _head(names, units, text_at, style, rng)
    text = style.end.join([*head, *rows]) + style.end
    meant = {
        number: None if row is None else tuple(row[place] for place in chosen)
        for number, (line, row) in enumerate(zip(rows, truth, strict=True), len(head) + 1)
        if line.strip(" \t;,")
    }
    return Written(text.encode(style.encoding), style, wanted, meant)


def _head(names: Sequence[str], units: Sequence[str], text_at: int | None, style: Style, rng: random.Random) -> list[str]:
    forms = {"none": "{n}", "brackets": "{n} ({u})", "square": "{n} [{u}]", "slash": "{n} / {u}", "line": "{n}", "comma": "{n}, {u}"}
    full = [forms[style.units].format(n=name, u=unit) for name, unit in zip(names, units, strict=True)]
    below = list(units)
    if text_at is not None:
        full.insert(text_at, "Remark")
        below.insert(text_at, "")
    line = style.separator.join(quoted(cell, style) for cell in full)
    lines = [line, *([style.separator.join(quoted(cell, style) for cell in below)] if style.units == "line" else [])]
    if style.head == "none":
        return []
    if style.head == "comment":
        return ["# " + lines[0]]
    if style.head == "told":
        return [f"sep={style.separator[0]}", *lines]
    if style.head == "preamble":
        return [rng.choice(("Tensile test 7", "Operator: A. Smith", "Rate: 0,5 mm/min", "Date;26.11.2026")), *lines]
    return lines


def values_read(table: Written, head_lines: int | None = None) -> dict[int, tuple[float | None, ...]]:
    """What the reader makes of a table, by the number of the line.

    Args:
        table: the table.
        head_lines: the layout is decided from so many lines, as of a file that grows; None: from the whole file.

    Raises:
        BadInput: it refuses the table.
    """

    def places(columns: tuple[Column, ...]) -> tuple[int, ...]:
        found = []
        for wanted in table.wanted:
            if isinstance(wanted, int):
                if wanted > len(columns):
                    raise BadInput("{head}: too few columns.")
                found.append(wanted - 1)
                continue
            alike = [place for place, one in enumerate(columns) if key_of(wanted) in (one.key, key_of(one.raw))]
            if len(alike) != 1:
                raise BadInput("{head}: no such column.")
            found.append(alike[0])
        return tuple(found)

    lines = lines_of(text_of(table.data, "table"))[:-1]
    known = len(lines) if head_lines is None else head_lines
    layout = layout_of(lines[:known], "table", places, Convention(), 200)
    while known < len(lines) and all(is_blank(line) for line in lines[layout.first_line - 1 : known]):
        known += 1  # as long as there is no line of numbers, nothing is decided
        layout = layout_of(lines[:known], "table", places, Convention(), 200)
    read: dict[int, tuple[float | None, ...]] = {}
    for number, line in enumerate(lines[layout.first_line - 1 :], layout.first_line):
        if is_blank(line):
            continue
        cells = layout.cells(line, number)
        layout = layout.after(cells)
        row = [number_in(cells[place], layout.decimal) for place in layout.number_places]
        if None in row:
            raise BadInput(f"table: line {number}: no number.")
        read[number] = tuple(None if value is None or value != value else value for value in row)
    return read


def verdict(seed: int) -> tuple[str, Written]:
    """`right`, `refused` or `wrong`, and the table.

    A line that lost or gained a cell has no truth: it must be refused.
    """
    table = written(seed)
    try:
        read = values_read(table, random.Random(seed + 1).choice((None, 2, 3, 5)))
    except BadInput:
        return "refused", table
    if any(table.truth.get(number) != row and any(value is not None for value in row) for number, row in read.items()):
        return "wrong", table
    # Numbers without names may be taken for names while they are all that there is.
    return "right" if len(read) == len(table.truth) else "refused", table


def is_plain(table: Written) -> bool:
    """A table that a careful program writes: nothing in it can be misread, so it must be read."""
    style = table.style
    return (
        style.thousands == ""
        and style.head in ("names", "told", "comment")
        and style.units in ("none", "brackets", "square", "slash")
        and style.separator in ("\t", ";", "; ")
        and style.torn == 0.0
        and style.digits not in (0, 3)
        and not style.trim
        and not style.text_column
        and not style.trailing
        and len(table.truth) >= 8
        and all(isinstance(one, str) for one in table.wanted)
    )


def main() -> int:
    tables = int(sys.argv[1]) if len(sys.argv) > 1 else 100_000
    first = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    began_s, counts, plain = time.monotonic(), Counter[str](), Counter[str]()
    for seed in range(first, first + tables):
        said, table = verdict(seed)
        counts[said] += 1
        if is_plain(table):
            plain[said] += 1
        if said == "wrong":
            begin = list(table.truth.items())[:3]
            shown = f"seed {seed}: {table.style}\n{text_of(table.data, '')[:400]!r}\nwanted {table.wanted}, truth {begin}"
            sys.stdout.write(f"{shown}\n")
    passed_s = time.monotonic() - began_s
    sys.stdout.write(f"{tables} tables in {passed_s:.0f} s: {dict(counts)}; of {plain.total()} plain ones {dict(plain)}\n")
    return int(counts["wrong"] > 0)


if __name__ == "__main__":
    sys.exit(main())
