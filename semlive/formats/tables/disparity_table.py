"""Disparity maps as text tables of several DIC programs (format 1, see docs/how-to/import.md).

The programs differ in the names of their columns and in the mark of points that were not found:

| engine | columns | not found |
|---|---|---|
| semlive | ``x, y, u, v``; optionally ``sigma_u, sigma_v, valid`` | valid 0 |
| ``semlive dic`` | ``x, y, u, v, sigma_u, sigma_v, zncc, status`` | status not ``converged`` |
| VIC-2D | ``x, y, u, v, sigma`` and others, names in quotes | sigma below 0, or point missing |
| DICe | ``COORDINATE_X, COORDINATE_Y, DISPLACEMENT_X, DISPLACEMENT_Y, SIGMA``; ``***`` lines above | SIGMA below 0, or point missing |
| OpenCorr | ``x, y, u, v, ZNCC, convergence`` (``saveTable2D``) | ZNCC below 0 or NaN |
| MatchID | ``Coordinates.Image X [Pixel], disp.Horizontal Displacement U [Pixel]`` and others | NaN, empty, or point missing |
| muDIC, Ncorr, GOM, DaVis and others | the usual spellings in `_SPELLINGS`, in px | NaN, empty |
| pyvale | ``subset_x, subset_y, displacement_u, displacement_v, converged`` | converged 0, NaN |
"""

from __future__ import annotations

import io
import math
import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import PoiStatus
from semlive.errors import BadInput
from semlive.formats.tables.torn_line import check_last_line
from semlive.inputs.text_table import (
    LONGEST_LINE,
    SEPARATORS,
    Column,
    Convention,
    Layout,
    is_blank,
    key_of,
    layout_of,
    lines_of,
    number_in,
    text_of,
)

Values = NDArray[np.float64]
PIXELS = ("px", "pixel", "pixels", "pix")
_IN_PIXELS = ("x", "y", "u", "v", "sigma", "sigmau", "sigmav")
_SPELLINGS = {
    "{x}": "{x}image image{x} coordinates.image{x} coordinatesimage{x} coord{x} {x}coord {x}coordinate coordinate{x} pos{x} {x}pos"
    " position{x} {x}position {x}pic {x}ref {x}px {x}pixel",
    "{u}": "u{x} d{x} displacement{x} {x}displacement displacement{u} {u}displacement disp{x} {x}disp disp{u} {u}disp displacement.{x}"
    " displacement.{u} {along}displacement {along}displacement{u} disp.{along}displacement{u} displacement.{along}displacement{u}"
    " {u}ref {u}px {u}pixel",
}
_AXES = ({"x": "x", "u": "u", "along": "horizontal"}, {"x": "y", "u": "v", "along": "vertical"})
_ROLES = {name.format(**axis): role.format(**axis) for role, names in _SPELLINGS.items() for name in names.split() for axis in _AXES}
"""Column of a map, ``x``, ``y``, ``u`` or ``v``, by other usual spellings of its name."""
_VECTOR_FILE = re.compile(r"#\s*(?:DaVis|nCorr)\b.*2D-vector", re.IGNORECASE)
_TEXT_MARKS = ("status", "converged")
_SUBSET = re.compile(r"^\*{3}\s*Subset size:\s*(\d+)", re.MULTILINE)
_STATUSES = sorted(PoiStatus, key=lambda status: -len(status.label))


@dataclass(frozen=True, slots=True)
class TableDialect:
    """Table format of one DIC program.

    Attributes:
        name: name of the program, as in ``--from``.
        place: columns of x, y, u, v in px.
        sigma: columns of the standard uncertainties of u and v; None without.
        mark: column that marks valid points.
        min_mark: smallest mark of a valid point.
        lists_all_points: every point of the grid must be listed.
    """

    name: str
    place: tuple[str, str, str, str]
    sigma: tuple[str, str] | None
    mark: str
    min_mark: float
    lists_all_points: bool


XYUV = ("x", "y", "u", "v")
DIALECTS = {
    dialect.name: dialect
    for dialect in (
        TableDialect("semlive", XYUV, ("sigma_u", "sigma_v"), "valid", 0.5, True),
        TableDialect("semlive-dic", XYUV, ("sigma_u", "sigma_v"), "status", 0.5, True),
        TableDialect("vic2d", XYUV, ("sigma", "sigma"), "sigma", 0.0, False),
        TableDialect("dice", ("coordinate_x", "coordinate_y", "displacement_x", "displacement_y"), ("sigma", "sigma"), "sigma", 0.0, False),
        TableDialect("other", XYUV, None, "valid", 0.5, False),
        TableDialect("opencorr", XYUV, None, "zncc", 0.0, False),
        TableDialect("pyvale", ("subset_x", "subset_y", "displacement_u", "displacement_v"), None, "converged", 0.5, False),
    )
}


@dataclass(frozen=True, slots=True, eq=False)
class DisparityTable:
    """A disparity map as listed, point by point; units px.

    Attributes:
        where: name of the file, for errors.
        dialect: format of the table.
        first_line: number of the line of the first point, from 1.
        x_px: (n,) columns of the points in the reference frame.
        y_px: (n,) rows.
        u_px: (n,) disparity along x, zero where not valid.
        v_px: (n,) disparity along y, zero where not valid.
        sigma_u_px: (n,) standard uncertainty of u; None if the table has none.
        sigma_v_px: (n,) standard uncertainty of v; None if the table has none.
        valid: (n,) whether the point was found.
        subset_px: edge of the subset; 0 if the table does not contain it.
        lines: (n,) line numbers; None if the points are in consecutive lines.
    """

    where: str
    dialect: TableDialect
    first_line: int
    x_px: Values
    y_px: Values
    u_px: Values
    v_px: Values
    sigma_u_px: Values | None
    sigma_v_px: Values | None
    valid: NDArray[np.bool_]
    subset_px: int
    lines: NDArray[np.int64] | None = None

    def error(self, point: int, column: int, problem: str, advice: str) -> BadInput:
        """Return the error for a column of `dialect.place`, with file, line and column."""
        line = self.first_line + point if self.lines is None else int(self.lines[point])
        return BadInput(f"{self.where}: line {line}, column {self.dialect.place[column]}: {problem}; {advice}.")


def read_disparity_table(data: bytes, where: str, dialect: str | None = None) -> DisparityTable:
    """Read the points of one map and check the numbers.

    Args:
        data: bytes of the file.
        where: name of the file, for errors.
        dialect: name of the DIC program; None detects it from the header.

    Raises:
        BadInput: the table is invalid; the message contains file, line, column and advice.
    """
    lines = _with_names(lines_of(text_of(data, where)), where)
    # No displacement has thousands of pixels, and no coordinate has decimals.
    layout = layout_of(lines, where, lambda columns: _places(columns, dialect), Convention(no_thousands=True))
    check_last_line(lines, layout)
    kind = _dialect(layout.columns, dialect)
    at = _at(layout.columns, kind)
    columns, numbers = _numbers(lines, layout, at, kind)
    if len(columns) == 0:
        raise BadInput(f"{where}: line {layout.first_line}: holds no point; export the map's points below its header.")
    values = dict(zip(at, columns.T, strict=True))
    subset = _SUBSET.search("\n".join(lines[: layout.first_line]))
    return _table(values, kind, where, layout.first_line, min(int(subset.group(1)), 10**6) if subset else 0, numbers)


def _with_names(lines: list[str], where: str) -> list[str]:
    """Return the lines of a file that DaVis or a converter to its format wrote, with the names that its first line implies.

    Raises:
        BadInput: the first line states another unit than pixels.
    """
    if not lines or not _VECTOR_FILE.match(lines[0]):
        return lines
    for unit in re.findall(r'"([^"]*)"', lines[0])[1::2]:  # after each name its unit
        if unit.strip().casefold() not in PIXELS:
            raise BadInput(f"{where}: line 1: states the unit {unit[:20]!r}; export positions and displacements in pixels.")
    separator = next((sign for sign in "\t;" if any(sign in line for line in lines[1:2])), " ")
    return ["# " + separator.join(XYUV), *lines[1:]]


def _places(columns: tuple[Column, ...], dialect: str | None) -> tuple[int, ...]:
    """Return the places of the columns of numbers; a status may be text.

    Raises:
        BadInput: a required column is missing, occurs twice, or has another unit.
    """
    kind = _dialect(columns, dialect)
    return tuple(place for name, place in _at(columns, kind).items() if name not in _TEXT_MARKS)


def _at(columns: tuple[Column, ...], kind: TableDialect) -> dict[str, int]:
    """Return the places of the existing columns of a dialect, by its names."""
    keys = _keys(columns)
    names = (*kind.place, *(kind.sigma or ()), kind.mark)
    return {name: keys.index(key_of(name)) for name in names if key_of(name) in keys}


def _dialect(columns: tuple[Column, ...], name: str | None) -> TableDialect:
    """Return the dialect of a map by its name, or else by its columns; errors begin with ``{head}``, the line of names."""
    keys = _keys(columns)
    for column, key in zip(columns, keys, strict=True):
        if key in _IN_PIXELS and column.unit and column.unit.casefold() not in PIXELS:
            raise BadInput(f"{{head}}, column {column.name}: is in {column.unit[:20]!r}; export it in pixels.")
    kind = DIALECTS[name or _detected_dialect(keys, [column.key for column in columns])]
    required = [*kind.place, *([kind.mark] if kind.mark != "valid" else [])]
    for column_name in required:
        if key_of(column_name) not in keys:
            raise BadInput(f"{{head}}: column {column_name} is missing; a map of {kind.name} has {', '.join(required)}.")
    for column_name in (*required, *(kind.sigma or ()), kind.mark):
        if keys.count(key_of(column_name)) > 1:
            raise BadInput(f"{{head}}: column {column_name} occurs twice; keep one.")
    if kind.sigma is not None and (key_of(kind.sigma[0]) in keys) != (key_of(kind.sigma[1]) in keys):
        missing = kind.sigma[0] if key_of(kind.sigma[0]) not in keys else kind.sigma[1]
        raise BadInput(f"{{head}}: column {missing} is missing; give sigma_u and sigma_v, or neither.")
    return kind


def _keys(columns: tuple[Column, ...]) -> list[str]:
    """Return the keys of the columns; other usual spellings of x, y, u and v are replaced where the map has no column of that name.

    Raises:
        BadInput: two columns may be meant.
    """
    keys = [column.key for column in columns]
    if "coordinatex" in keys and "displacementx" in keys and "sigma" in keys:
        return keys
    if "subsetx" in keys:
        return keys
    for role in XYUV:
        places = [place for place, key in enumerate(keys) if _ROLES.get(key) == role]
        if role in keys or not places:
            continue
        if len(places) > 1:
            both = " or ".join(repr(columns[place].raw) for place in places[:2])
            raise BadInput(f"{{head}}: column {role} may be {both}; keep one.")
        keys[places[0]] = role
    return keys


def _detected_dialect(keys: list[str], names: list[str]) -> str:
    """Return the dialect of a map by the keys of its columns, and by their own names, which differ for other programs."""
    if "coordinatex" in keys and "displacementx" in keys:
        return "dice"
    if "subsetx" in keys:
        return "pyvale"
    if "zncc" in keys and "status" in keys:
        return "semlive-dic"
    if "zncc" in keys and "convergence" in keys:
        return "opencorr"
    if "sigma" in keys and "sigmau" not in keys:
        return "vic2d"
    return "semlive" if all(name in names for name in XYUV) else "other"


def _words_to_numbers(body: str, kind: TableDialect) -> str:
    if kind.mark == "status":
        for status in _STATUSES:
            body = body.replace(status.label, "1" if status is PoiStatus.CONVERGED else "0")
    if kind.mark == "converged":
        body = body.replace("True", "1").replace("False", "0")
    return body


def _numbers(lines: list[str], layout: Layout, at: dict[str, int], kind: TableDialect) -> tuple[Values, NDArray[np.int64] | None]:
    """Return the required columns, (points, columns), and the line numbers if there are blank lines between points.

    Raises:
        BadInput: a line has another number of cells than the head, or a cell is not a number.
    """
    first = layout.first_line - 1
    last = max((place for place in range(first, len(lines)) if not is_blank(lines[place])), default=first - 1)
    body = lines[first : last + 1]
    if (values := _parse_uniform_lines(body, layout, at, kind)) is not None:
        return _without_empty(values, np.arange(layout.first_line, layout.first_line + len(values)), layout.first_line)
    rows, numbers = [], []
    for number, line in enumerate(body, layout.first_line):
        if is_blank(line):
            continue
        cells = layout.cells(_words_to_numbers(line, kind), number)
        layout = layout.after(cells)
        rows.append([_number(cells, index, name, kind, at, layout, number) for name, index in at.items()])
        numbers.append(number)
    return _without_empty(np.array(rows).reshape(-1, len(at)), np.array(numbers, dtype=np.int64), layout.first_line)


def _without_empty(values: Values, numbers: NDArray[np.int64], first_line: int) -> tuple[Values, NDArray[np.int64] | None]:
    """Return the points without lines that hold neither position nor displacement, and the line numbers if some are left out."""
    full = ~np.isnan(values[:, :4]).all(axis=1)
    consecutive = bool(full.all()) and bool((numbers == np.arange(first_line, first_line + len(numbers))).all())
    return values[full], None if consecutive else numbers[full]


def _parse_uniform_lines(body: list[str], layout: Layout, at: dict[str, int], kind: TableDialect) -> Values | None:
    """Parse lines of equal format, a hundred times faster than one by one; None if a line differs."""
    separator, text = layout.separator, "\n".join(body)
    if not body or separator not in SEPARATORS or '"' in text or "\r" in text or max(map(len, body)) > LONGEST_LINE:
        return None
    counts = {len(line.split()) for line in body} if separator == " " else {line.count(separator) + 1 for line in body}
    if counts != {len(layout.columns)} or any(map(is_blank, body)):
        return None
    if separator == "," and layout.decimal != "." and "e" in text.casefold():
        return None  # 1,2e+01 may be one number
    if separator != "," and "," in text and (layout.decimal != "," or "." in text):
        return None
    if "." in text and not layout.decimal:
        return None
    text = _words_to_numbers(text, kind)
    text = text if separator == "," else text.replace(",", ".")
    delimiter = None if separator == " " else separator
    try:
        return np.loadtxt(io.StringIO(text), delimiter=delimiter, usecols=tuple(at.values()), comments=None, ndmin=2)
    except (ValueError, OverflowError):
        return None  # a line is invalid; parsing one by one finds it


def _number(cells: list[str], index: int, name: str, kind: TableDialect, at: dict[str, int], layout: Layout, line: int) -> float:
    place, text = f"{layout.where}: line {line}, column {name}", cells[index]
    if not text:
        if name in kind.place[:2] and all(not cells[at[other]] for other in kind.place):
            return math.nan
        if name not in kind.place[:2] and kind.mark != name:
            if _not_found(cells, kind, at, layout.decimal):
                return 0.0
            if kind.mark not in at or not kind.lists_all_points:
                return math.nan
        raise BadInput(f"{place}: is empty; give a number, or mark with the column valid that the point was not found.")
    value = number_in(text, layout.decimal)
    if value is None:
        raise BadInput(f"{place}: {text[:40]!r} is not a number; write a number with a decimal point, and none between thousands.")
    return value


def _not_found(cells: list[str], kind: TableDialect, at: dict[str, int], decimal: str) -> bool:
    mark = number_in(cells[at[kind.mark]], decimal) if kind.mark in at else None
    return mark is not None and mark < kind.min_mark


def _table(
    values: dict[str, Values], kind: TableDialect, where: str, first_line: int, subset_px: int, lines: NDArray[np.int64] | None
) -> DisparityTable:  # fmt: skip
    x, y, u, v = (values[name] for name in kind.place)
    mark = values.get(kind.mark)
    valid = np.ones(len(x), dtype=np.bool_) if mark is None else mark >= kind.min_mark
    if mark is None or not kind.lists_all_points:
        valid &= ~(np.isnan(u) | np.isnan(v))
    sigma = None
    if kind.sigma is not None and kind.sigma[0] in values:
        sigma = tuple(np.where(valid, values[name], 0.0) for name in kind.sigma)
    sigma_u, sigma_v = sigma or (None, None)
    table = DisparityTable(
        where, kind, first_line, x, y, np.where(valid, u, 0.0), np.where(valid, v, 0.0), sigma_u, sigma_v, valid, subset_px, lines
    )
    _check_finite(table, mark)
    return table


def _check_finite(table: DisparityTable, mark: Values | None) -> None:
    for column, values in enumerate((table.x_px, table.y_px, table.u_px, table.v_px)):
        bad = ~(np.abs(values) < 1e6)
        if bad.any():
            point = int(np.argmax(bad))
            mark_advice = ", or mark with the column valid that the point was not found" if column > 1 else ""
            raise table.error(point, column, f"is {values[point]:g}", f"give it in pixels{mark_advice}")
    for name, values in (("sigma_u", table.sigma_u_px), ("sigma_v", table.sigma_v_px)):
        if values is not None and not (ok := (values >= 0) & (values < 1e6)).all():
            point = int(np.argmin(ok))
            line = table.first_line + point if table.lines is None else int(table.lines[point])
            raise BadInput(f"{table.where}: line {line}, column {name}: is {values[point]:g}; give a standard uncertainty in pixels.")
    if mark is not None and table.dialect.lists_all_points and np.isnan(mark).any():
        point = int(np.argmax(np.isnan(mark)))
        line = table.first_line + point if table.lines is None else int(table.lines[point])
        raise BadInput(f"{table.where}: line {line}, column {table.dialect.mark}: is nan; write 1 where the point was found, else 0.")
