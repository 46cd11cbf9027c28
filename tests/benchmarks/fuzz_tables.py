"""Random text tables under random conventions: each is read right, or the table is refused.

Two judges decide what is right: the writer of the table has every number, and a slow reader that shares no code with
semlive (`table_oracle`) lists all readings of the bytes under any convention. Every fourth table is a disparity map with the names of a DIC
program, which takes the fast path of the import.

python tests/benchmarks/fuzz_tables.py [--tables N] [--first SEED] [--state FILE] [--write]

With `--state` the counts are stored every 1,000 tables and a later call continues there; `--write` writes them into the documentation.
"""

from __future__ import annotations

import argparse
import itertools
import json
import random
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from pathlib import Path

from semlive.errors import BadInput
from semlive.formats.tables.disparity_table import read_disparity_table
from semlive.inputs.text_table import Column, Convention, is_blank, key_of, layout_of, lines_of, number_in, text_of

sys.path.insert(0, str(Path(__file__).parent))
from table_oracle import readings

PAGE = Path(__file__).parents[2] / "docs" / "validation" / "text-tables.md"
NAMES = ("Time", "Force", "Ext", "Strain", "Kraft", "u", "v", "x_1", "Load cell", "Weg")
UNITS = ("s", "N", "kN", "mm", "um", "%", "px", "MPa")
LOST = ("", "nan", "NaN", "-nan(ind)", "#N/A", "--", "1.#QNAN")
WORDS = ("OK", "running", "26.11.2026", "12:03:44", "7", "ramp up", "hold, step 2", "A;B", "2026-11-26 12:03")
PLAIN_WORDS = 5
COMMENTS = ("#", "#", "%", "!")


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
    selected: tuple[str | int, ...]
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
        style = replace(style, torn=0.0)  # the first line alone determines how many cells there are
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
    selected: tuple[str | int, ...]
    chosen = sorted(rng.sample(range(count), rng.randint(1, min(2, count))))
    by_number = rng.random() < 0.3 or style.head == "none"
    shift = [place + (text_at is not None and place >= text_at) for place in chosen]
    selected = tuple(place + 1 for place in shift) if by_number else tuple(names[place] for place in chosen)
    head = _head(names, units, text_at, style, rng)
    text = style.end.join([*head, *rows]) + style.end
    meant = {
        number: None if row is None else tuple(row[place] for place in chosen)
        for number, (line, row) in enumerate(zip(rows, truth, strict=True), len(head) + 1)
        if line.strip(" \t;,")
    }
    return Written(text.encode(style.encoding), style, selected, meant)


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
        return [f"{random.Random(lines[0]).choice(COMMENTS)} {lines[0]}"]
    if style.head == "told":
        return [f"sep={style.separator[0]}", *lines]
    if style.head == "preamble":
        return [rng.choice(("Tensile test 7", "Operator: A. Smith", "Rate: 0,5 mm/min", "Date;26.11.2026")), *lines]
    return lines


def values_read(table: Written, head_lines: int | None = None) -> dict[int, tuple[float | None, ...]]:
    """What the reader makes of a table, by the number of the line.

    Args:
        table: the table.
        head_lines: the layout is decided from so many lines, as of a file that grows; None: from the complete file.

    Raises:
        BadInput: it refuses the table.
    """

    def places(columns: tuple[Column, ...]) -> tuple[int, ...]:
        found = []
        for column in table.selected:
            if isinstance(column, int):
                if column > len(columns):
                    raise BadInput("{head}: too few columns.")
                found.append(column - 1)
                continue
            matching = [place for place, one in enumerate(columns) if key_of(column) in (one.key, key_of(one.raw))]
            if len(matching) != 1:
                raise BadInput("{head}: no such column.")
            found.append(matching[0])
        return tuple(found)

    lines = lines_of(text_of(table.data, "table"))[:-1]
    lines_read = len(lines) if head_lines is None else head_lines
    layout = layout_of(lines[:lines_read], "table", places, Convention(), 200)
    while lines_read < len(lines) and all(is_blank(line) for line in lines[layout.first_line - 1 : lines_read]):
        lines_read += 1  # as long as there is no line of numbers, nothing is decided
        layout = layout_of(lines[:lines_read], "table", places, Convention(), 200)
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
    """Return `right`, `refused` or `wrong` by the writer of the table, and the table."""
    found, table, _ = verdict_and_values(seed)
    return found, table


def verdict_and_values(seed: int) -> tuple[str, Written, dict[int, tuple[float | None, ...]]]:
    """Return the verdict of the writer, the table, and what was read.

    A line that lost or gained a cell has no truth: it must be refused.
    """
    table = written(seed)
    try:
        read = values_read(table, random.Random(seed + 1).choice((None, 2, 3, 5)))
    except BadInput:
        return "refused", table, {}
    if any(table.truth.get(number) != row and any(value is not None for value in row) for number, row in read.items()):
        return "wrong", table, read
    # Numbers without names may be taken for names while they are all that there is.
    return ("right" if len(read) == len(table.truth) else "refused"), table, read


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
        and all(isinstance(one, str) for one in table.selected)
    )


def agrees_with_oracle(table: Written, read: dict[int, tuple[float | None, ...]]) -> bool:
    """Whether a reading is one of those that the slow reader finds; a table without lines of numbers has none."""
    return not read or any(
        {line: row for line, row in possible if line in read} == read for possible in readings(table.data, table.selected)
    )


MAP_NAMES = {
    "semlive": ("x", "y", "u", "v"),
    "vic2d": ("x", "y", "u", "v", "sigma"),
    "dice": ("COORDINATE_X", "COORDINATE_Y", "DISPLACEMENT_X", "DISPLACEMENT_Y", "SIGMA"),
    "matchid": ("Coordinates.Image X [Pixel]", "Coordinates.Image Y [Pixel]", "disp.Horizontal Displacement U [Pixel]",
                "disp.Vertical Displacement V [Pixel]"),
    "mudic": ("coord_x", "coord_y", "ux", "uy"),
    "davis": ("x [px]", "y [px]", "Displacement x [px]", "Displacement y [px]"),
    "ncorr": ("X", "Y", "u_ref", "v_ref"),
}  # fmt: skip


def written_map(seed: int) -> Written:
    """Return a disparity map of its own for each seed, with `selected` x, y, u and v."""
    rng = random.Random(seed)
    style = replace(a_style(rng), units="none", text_column=False, trailing=False)
    program = rng.choice(tuple(MAP_NAMES))
    blanks = not style.separator.strip(" ")
    names = [name.replace(" ", "_").replace("_[", " [") if blanks else name for name in MAP_NAMES[program]]
    step, x0, y0 = rng.choice((5, 10, 20)), rng.randint(0, 999), rng.randint(0, 999)
    rows, truth = list[str](), list[tuple[float | None, ...] | None]()
    for y, x in itertools.product(range(y0, y0 + 3 * step, step), range(x0, x0 + 4 * step, step)):
        lost = rng.random() < style.lost
        pair = [(rng.choice(LOST[1:]), None) if lost else a_number(rng, 30.0, style) for _ in "uv"]
        cells = [
            str(x),
            str(y),
            *(text for text, _ in pair),
            *(["-1" if lost else "0.01".replace(".", style.decimal)] if len(names) == 5 else []),
        ]
        torn = rng.random() < style.torn
        if torn:
            cells = cells[: rng.randrange(len(cells))] if rng.random() < 0.5 else [*cells, cells[0]]
        rows.append(style.separator.join(quoted(cell, style) for cell in cells))
        truth.append(None if torn else (float(x), float(y), *(value for _, value in pair)))
    head = [style.separator.join(quoted(name, style) for name in names)]
    if style.head == "comment":
        head[0] = f"{random.Random(head[0] + style.encoding).choice(COMMENTS)} {head[0]}"
    elif style.head == "told":
        head.insert(0, f"sep={style.separator[0]}")
    elif style.head == "none":
        head = []
    data = (style.end.join([*head, *rows]) + style.end).encode(style.encoding)
    meant = {line: row for line, (text, row) in enumerate(zip(rows, truth, strict=True), len(head) + 1) if text.strip(" \t;,")}
    return Written(data, style, MAP_NAMES[program][:4], meant)


def map_read(table: Written) -> dict[int, tuple[float | None, ...]]:
    """Return the points that the import reads, by the number of the line.

    Raises:
        BadInput: it refuses the map.
    """
    found = read_disparity_table(table.data, "map")
    lines = range(found.first_line, found.first_line + len(found.x_px)) if found.lines is None else found.lines.tolist()
    values = zip(lines, found.x_px, found.y_px, found.u_px, found.v_px, found.valid, strict=True)
    return {int(line): (float(x), float(y), float(u) if ok else None, float(v) if ok else None) for line, x, y, u, v, ok in values}


def map_verdict(seed: int) -> tuple[str, Written]:
    """Return `right`, `refused` or `wrong`, and the map; a point with one lost displacement is lost."""
    table = written_map(seed)
    try:
        read = map_read(table)
    except BadInput:
        return "refused", table
    return ("right" if read == {line: row for line, row in table.truth.items() if row is not None} == table.truth else "wrong"), table


def judged(seed: int) -> tuple[str, Written]:
    """Return `right`, `refused`, `wrong`, or `unknown to the slow reader`, and the table."""
    if seed % 4 == 3:
        return map_verdict(seed)
    found, table, read = verdict_and_values(seed)
    if found == "right" and not agrees_with_oracle(table, read):
        return "unknown to the slow reader", table
    return found, table


@dataclass
class Campaign:
    """Counts of a campaign, which may be continued.

    Attributes:
        first: first seed.
        next: next seed.
        verdicts: number of tables by verdict.
        maps: number of maps by verdict.
        plain: number of tables of careful programs by verdict.
        seconds: processor time.
    """

    first: int
    next: int
    verdicts: Counter[str] = field(default_factory=Counter[str])
    maps: Counter[str] = field(default_factory=Counter[str])
    plain: Counter[str] = field(default_factory=Counter[str])
    seconds: float = 0.0

    def run(self, until: int) -> None:
        """Judge the tables up to a seed."""
        began_s = time.process_time()
        for seed in range(self.next, until):
            found, table = judged(seed)
            is_map = seed % 4 == 3
            (self.maps if is_map else self.verdicts)[found] += 1
            if not is_map and is_plain(table):
                self.plain[found] += 1
            if found not in ("right", "refused"):
                begin = list(table.truth.items())[:3]
                shown = f"seed {seed}: {found}: {table.style}\n{table.data[:400]!r}\nselected {table.selected}, truth {begin}"
                sys.stdout.write(f"{shown}\n")
        self.next = until
        self.seconds += time.process_time() - began_s

    @property
    def wrong(self) -> int:
        """Number of tables that were accepted with a wrong number, or with a reading that the slow reader does not know."""
        return sum(count for counts in (self.verdicts, self.maps) for name, count in counts.items() if name not in ("right", "refused"))

    def page(self) -> str:
        """Return the page of the documentation."""
        rows = (("tables", self.verdicts), ("of these written by a careful program", self.plain), ("disparity maps", self.maps))
        lines = "".join(
            f"| {name} | {counts.total():,} | {counts['right']:,} | {counts['refused']:,} | "
            f"{counts.total() - counts['right'] - counts['refused']:,} |\n"
            for name, counts in rows
        )
        return f"""# Text tables

`python tests/benchmarks/fuzz_tables.py --tables {self.next - self.first} --write` writes this page. It writes random
tables under random conventions (separator, decimal sign, thousands, quotes, units, line ends, encodings, lost values,
lines with a missing or additional cell, lines above the names) and reads them with the reader of the load file, the csv
parts, imported maps and `frames.csv`.

Two judges decide what is right. The writer of a table has every number. A slow reader that shares no code with
semlive lists every reading of the bytes under any convention, and an accepted reading must be one of them. A table with
two readings may be refused.

| input | number | read right | refused | wrong |
|---|---|---|---|---|
{lines}
A careful program writes one line of names, tabs or semicolons, one decimal sign and numbers that cannot be thousands.
Seeds {self.first} to {self.next - 1}, {self.seconds:.0f} s of processor time.
"""


def main() -> int:
    """Run the campaign."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tables", type=int, default=100_000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--state", type=Path)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    campaign = Campaign(options.first, options.first)
    if options.state is not None and options.state.exists():
        stored = json.loads(options.state.read_text(encoding="utf-8"))
        counts = {name: Counter[str](stored[name]) for name in ("verdicts", "maps", "plain")}
        campaign = Campaign(stored["first"], stored["next"], **counts, seconds=stored["seconds"])
    until = campaign.first + options.tables
    while campaign.next < until:
        campaign.run(min(campaign.next + 1000, until))
        if options.state is not None:
            options.state.write_text(json.dumps(vars(campaign)), encoding="utf-8")
    sys.stdout.write(f"{campaign.next - campaign.first} tables in {campaign.seconds:.0f} s: {dict(campaign.verdicts)}; ")
    sys.stdout.write(f"maps {dict(campaign.maps)}; of {campaign.plain.total()} plain ones {dict(campaign.plain)}\n")
    if options.write:
        PAGE.write_text(campaign.page(), encoding="utf-8")
    return int(campaign.wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
