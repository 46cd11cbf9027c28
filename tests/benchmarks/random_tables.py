"""Random text tables and disparity maps under random conventions, with the numbers that their writer meant."""

from __future__ import annotations

import itertools
import random
from collections.abc import Sequence
from dataclasses import dataclass, replace
from decimal import Decimal

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
