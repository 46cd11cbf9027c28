"""Slow, independent reader of text tables: every reading of a table under any convention.

It shares no code with `semlive.inputs`: it tries all separators, decimal signs, thousands separators and lines of names, splits and
converts character by character, and never prefers one reading. A reading that the strict reader accepts must be one of these.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from functools import lru_cache

Row = tuple[float | None, ...]
Reading = tuple[tuple[int, Row], ...]
"""Line number, from 1, and selected values of each line of numbers; None for a lost value."""

SEPARATORS = ("\t", ";", ",", " ")
CONVENTIONS = tuple((decimal, thousands) for decimal in ".," for thousands in ("", "'", " ", ".", ",") if thousands != decimal)
LOST = ("", "nan", "-nan", "-nan(ind)", "nan(ind)", "1.#qnan", "-1.#ind", "1,#qnan", "#n/a", "#nv", "n/a", "null", "--", "-")
MAX_HEAD_LINES = 4
COMMENTS = ("#", "%", "!")


def decoded(data: bytes) -> str:
    """Return the text of a table in UTF-8 or in UTF-16 with a byte order mark."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16")
    return data.decode("utf-8-sig")


def cells_of(line: str, separator: str) -> list[str] | None:
    """Split a line character by character; None if a quote is open at its end, or text follows a closing quote."""
    cells, place = list[str](), 0
    while place <= len(line):
        while place < len(line) and line[place] == " ":
            place += 1
        if separator == " " and place == len(line):
            break
        cell = ""
        if line[place : place + 1] == '"':
            place += 1
            while line[place : place + 1] != '"' or line[place + 1 : place + 2] == '"':
                if place >= len(line):
                    return None
                cell += line[place]
                place += 2 if line[place] == '"' else 1
            place += 1
            while separator != " " and line[place : place + 1] == " ":
                place += 1
            if place < len(line) and line[place] != separator:
                return None
        else:
            while place < len(line) and line[place] != separator:
                cell += line[place]
                place += 1
        cells.append(cell.strip())
        place += 1
    return cells


@lru_cache(4096)  # every cell is tried in many readings
def value_of(cell: str, decimal: str, thousands: str) -> tuple[bool, float | None]:
    """Return whether a cell is a value under a convention, and the value; None for a lost one."""
    if cell.lower() in LOST:
        return True, None
    body, _, exponent = cell.lower().partition("e")
    if "e" in cell.lower() and not exponent.lstrip("+-").isdecimal():
        return False, None
    sign, digits = (-1, body[1:]) if body[:1] == "-" else (1, body[1:] if body[:1] == "+" else body)
    whole, point, rest = digits.partition(decimal)
    if thousands and thousands in whole:
        groups = whole.split(thousands)
        if not (1 <= len(groups[0]) <= 3 and groups[0][:1] != "0" and all(len(group) == 3 for group in groups[1:])):
            return False, None
        whole = "".join(groups)
    if not (whole + rest) or any(character not in "0123456789" for character in whole + rest) or (point and decimal == "," and not rest):
        return False, None
    number = sign * Fraction(int(whole + rest), 10 ** len(rest)) * Fraction(10) ** int(exponent or 0)
    return True, float(number)


def readings(data: bytes, selected: Sequence[str | int], head_lines: int = MAX_HEAD_LINES) -> set[Reading]:
    """Return every reading of a table: all conventions under which every line has the same number of cells and the selected are values.

    Args:
        data: the file.
        selected: names of columns, or numbers from 1.
        head_lines: number of first lines that may be the line of names.
    """
    text = decoded(data)
    lines = [line[:-1] if line.endswith("\r") else line for line in text.split("\n")]
    conventions = [(decimal, thousands) for decimal, thousands in CONVENTIONS if thousands in text]
    found: set[Reading] = set()
    for separator in SEPARATORS:
        split = [
            None if not line.strip(" \t;,") else cells_of(line.lstrip("#%!").strip(" ") if line[:1] in COMMENTS else line, separator)
            for line in lines
        ]
        for start in range(-1, min(head_lines, len(lines))):
            for places, width in _heads(lines, split, start, selected):
                for decimal, thousands in conventions:
                    if thousands == separator or (decimal == separator and '"' not in text):
                        continue
                    for with_units in (False, True):
                        reading = _reading(lines, split, start, places, width, decimal, thousands, with_units)
                        if reading:
                            found.add(reading)
    return found


def _heads(
    lines: Sequence[str], split: Sequence[list[str] | None], start: int, selected: Sequence[str | int]
) -> Iterator[tuple[tuple[int, ...], int]]:
    """Yield the places of the selected columns and the number of names, if a line may be that of the names."""
    if start < 0:
        if all(isinstance(name, int) for name in selected):
            yield tuple(int(name) - 1 for name in selected), 0
        return
    names = split[start]
    if names is None:
        return
    unbracketed = [
        name
        for place, name in enumerate(names)
        if name[:1] not in ("(", "[", "/") and not (place and (names[place - 1] == "/" or names[place - 1][-1:] == ","))
    ]
    if all(isinstance(name, int) for name in selected):
        yield from ((tuple(int(name) - 1 for name in selected), width) for width in {len(names), len(unbracketed)})
        return
    keys = [_key(name) for name in names]
    for candidates in (keys, [_key(name) for name in unbracketed]):
        at = [[place for place, key in enumerate(candidates) if key == _key(str(name))] for name in selected]
        if all(len(places) == 1 for places in at):
            yield tuple(places[0] for places in at), len(candidates)


def _key(name: str) -> str:
    for mark in ("[", "(", " / ", ","):
        name = name.split(mark)[0] if name.split(mark)[0].strip() else name
    return "".join(name.lower().replace("_", " ").split())


def _reading(
    lines: Sequence[str],
    split: Sequence[list[str] | None],
    start: int,
    places: tuple[int, ...],
    width: int,
    decimal: str,
    thousands: str,
    with_units: bool,
) -> Reading | None:
    """Return the values below a line of names; `with_units`, the first line that is not blank and has no digit contains units."""
    rows: list[tuple[int, Row]] = []
    for number, (line, cells) in enumerate(zip(lines[start + 1 :], split[start + 1 :], strict=True), start + 2):
        if not line.strip(" \t;,") or (line[:1] in COMMENTS and line[:4].lower() != "#n/a" and not (with_units and line[:1] == "%")):
            continue
        if cells is None:
            return None
        if with_units:
            if any(character.isdecimal() for character in line):
                return None  # the reading without units
            with_units = False
            continue
        trimmed = cells[:-1] if len(cells) == width + 1 and not cells[-1] else cells
        width = width or len(trimmed)
        if len(trimmed) != width or max(places) >= width:
            return None
        values = [value_of(trimmed[place], decimal, thousands) for place in places]
        if not all(is_value for is_value, _ in values):
            return None
        rows.append((number, tuple(value for _, value in values)))
    return tuple(rows)
