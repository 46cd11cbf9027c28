"""Random text tables under random conventions: each is read right, or the table is refused.

Two judges decide what is right: the writer of the table has every number, and a slow reader that shares no code with
semlive (`table_oracle`) lists all readings of the bytes under any convention. Every fourth table is a disparity map with the names of a DIC
program, which takes the fast path of the import.

python tests/benchmarks/fuzz_tables.py [--tables N] [--first SEED] [--state FILE] [--write]

With `--state` the counts are stored every 1,000 tables and a later call continues there; `--write` writes them into the documentation.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from semlive.errors import BadInput
from semlive.formats.tables.disparity_table import read_disparity_table
from semlive.inputs.text_table import Column, Convention, is_blank, key_of, layout_of, lines_of, number_in, text_of

sys.path.insert(0, str(Path(__file__).parent))
from random_tables import Written, written, written_map
from table_oracle import readings

PAGE = Path(__file__).parents[2] / "docs" / "validation" / "text-tables.md"


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
