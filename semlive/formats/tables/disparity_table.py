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
| muDIC, Ncorr, GOM, DaVis and others | the usual spellings in `disparity_columns`, in px | NaN, empty, or a mark in `disparity_marks` |
| pyvale | ``subset_x, subset_y, displacement_u, displacement_v, converged`` | converged 0, NaN |
"""

from __future__ import annotations

import contextlib
import io
import math
import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.errors import BadInput
from semlive.formats.tables.disparity_columns import LENGTHS, TableDialect, columns_in, dialect_of, places_of
from semlive.formats.tables.disparity_marks import CORRELATION, MARKS, OPENPIV, TEXT_MARKS, mark_in, points_found
from semlive.formats.tables.map_lines import map_lines
from semlive.formats.tables.sentinels import sentinels_in
from semlive.formats.tables.torn_line import check_last_line
from semlive.inputs.lost_numbers import MIN_SENTINEL
from semlive.inputs.text_table import (
    LONGEST_LINE,
    SEPARATORS,
    TITLE_LINES,
    Convention,
    Layout,
    encoding_of,
    is_blank,
    layout_of,
    lines_of,
    number_in,
    text_of,
)

Values = NDArray[np.float64]
_CODE_PAGES = ("cp932", "gb18030", "cp949", "big5", "cp1251")
_SUBSET = re.compile(r"^\*{3}\s*Subset size:\s*(\d+)", re.MULTILINE)


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
    try:
        return _read(text_of(data, where), where, dialect)
    except BadInput:
        for encoding in _other_code_pages(data):
            with contextlib.suppress(BadInput, UnicodeDecodeError):
                return _read(data.decode(encoding), where, dialect)
        raise


def _other_code_pages(data: bytes) -> tuple[str, ...]:
    """Return code pages of names that are no UTF-8; digits and separators are the same in all of them."""
    try:
        data.decode()
    except UnicodeDecodeError:
        return _CODE_PAGES if encoding_of(data) == (0, "utf-8") else ()
    return ()


def _read(text: str, where: str, dialect: str | None) -> DisparityTable:
    lines = map_lines(lines_of(text), where)
    # No displacement has thousands of pixels, and no coordinate has decimals.
    layout = layout_of(lines, where, lambda columns: places_of(columns, dialect), Convention(no_thousands=True), TITLE_LINES)
    check_last_line(lines, layout)
    _check_units(lines, layout)
    kind = dialect_of(layout.columns, dialect)
    at = columns_in(layout.columns, kind)
    columns, numbers = _numbers(lines, layout, at, kind)
    if len(columns) == 0:
        raise BadInput(f"{where}: line {layout.first_line}: holds no point; export the map's points below its header.")
    values = dict(zip(at, columns.T, strict=True))
    subset = _SUBSET.search("\n".join(lines[: layout.first_line]))
    return _table(values, kind, where, layout.first_line, min(int(subset.group(1)), 10**6) if subset else 0, numbers)


def _check_units(lines: list[str], layout: Layout) -> None:
    """Refuse points with a cell that is a unit of length, which the numbers next to it may have."""
    for number, line in enumerate(lines[layout.first_line - 1 :], layout.first_line):
        if not is_blank(line):
            unit = next((cell for cell in layout.cells(line, number) if cell.casefold() in LENGTHS), "")
            if unit:
                raise BadInput(f"{layout.where}: line {number}: holds the unit {unit!r}; export it in pixels.")
            return


def _numbers(lines: list[str], layout: Layout, at: dict[str, int], kind: TableDialect) -> tuple[Values, NDArray[np.int64] | None]:
    """Return the required columns, (points, columns), and the line numbers if there are blank lines between points.

    Raises:
        BadInput: a line has another number of cells than the head, or a cell is not a number.
    """
    first = layout.first_line - 1
    last = max((place for place in range(first, len(lines)) if not is_blank(lines[place])), default=first - 1)
    body = lines[first : last + 1]
    if (values := _parse_uniform_lines(body, layout, at)) is not None:
        return _without_empty(values, np.arange(layout.first_line, layout.first_line + len(values)), layout.first_line)
    rows, numbers = [], []
    for number, line in enumerate(body, layout.first_line):
        if is_blank(line):
            continue
        cells = layout.cells(line, number)
        layout = layout.after(cells)
        rows.append([_number(cells, index, name, kind, at, layout, number) for name, index in at.items()])
        numbers.append(number)
    return _without_empty(np.array(rows).reshape(-1, len(at)), np.array(numbers, dtype=np.int64), layout.first_line)


def _without_empty(values: Values, numbers: NDArray[np.int64], first_line: int) -> tuple[Values, NDArray[np.int64] | None]:
    """Return the points, and the line numbers if lines are left out: those with neither position nor displacement.

    All four are NaN, or one number that marks a lost value, such as -9999.
    """
    is_one_number = (values[:, :1] <= -MIN_SENTINEL) & (values[:, :4] == values[:, :1])
    full = ~np.isnan(values[:, :4]).all(axis=1) & ~is_one_number.all(axis=1)
    consecutive = bool(full.all()) and bool((numbers == np.arange(first_line, first_line + len(numbers))).all())
    return values[full], None if consecutive else numbers[full]


def _parse_uniform_lines(body: list[str], layout: Layout, at: dict[str, int]) -> Values | None:
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
    text = text if separator == "," else text.replace(",", ".")
    delimiter = None if separator == " " else separator
    marks: dict[int | str, Callable[[str], float]] = {at[name]: _mark_alone for name in TEXT_MARKS if name in at}
    try:
        return np.loadtxt(io.StringIO(text), delimiter=delimiter, usecols=tuple(at.values()), comments=None, ndmin=2, converters=marks)
    except (ValueError, OverflowError):
        return None  # a line is invalid; parsing one by one finds it


def _mark_alone(cell: str) -> float:
    mark = mark_in(cell.strip(), ".")
    if mark is None:
        raise ValueError(cell)
    return mark


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
    value = mark_in(text, layout.decimal) if name in TEXT_MARKS else number_in(text, layout.decimal)
    if value is None and name in CORRELATION:
        return 1.0
    if value is None and name in TEXT_MARKS:
        raise BadInput(f"{place}: {text[:40]!r} is no mark; name the column valid, with 1 where the point was found, else 0.")
    if value is None:
        raise BadInput(f"{place}: {text[:40]!r} is not a number; write a number with a decimal point, and none between thousands.")
    return value


def _not_found(cells: list[str], kind: TableDialect, at: dict[str, int], decimal: str) -> bool:
    mark = mark_in(cells[at[kind.mark]], decimal) if kind.mark in at else None
    return mark is not None and mark < kind.min_mark


def _table(
    values: dict[str, Values], kind: TableDialect, where: str, first_line: int, subset_px: int, lines: NDArray[np.int64] | None
) -> DisparityTable:  # fmt: skip
    x, y, u, v = (values[name] for name in kind.place)
    mark = values.get(kind.mark)
    lost = np.isnan(u) | np.isnan(v)
    valid = np.ones(len(x), dtype=np.bool_)
    marks = [name for name in values if name == kind.mark or name in (*MARKS, *CORRELATION)]
    if all(name in marks for name in OPENPIV) and len(y) and y[0] > y[-1]:
        problem = "y decreases from line to line, so its axis points upward"
        raise BadInput(f"{where}: {problem}; save the map before transform_coordinates of OpenPIV, with y downward.")
    for name in marks:
        found = points_found(name, values[name], kind.min_mark if name == kind.mark else math.nan, (u, v), marks)
        if found is None:
            problem = f"column {name}: more than one of its values may mark points that were found"
            raise BadInput(f"{where}: {problem}; name it valid, with 1 where the point was found, else 0.")
        valid &= found
    sentinels = sentinels_in(u, v, valid & ~lost)
    if mark is None or not kind.lists_all_points:
        valid &= ~lost & ~sentinels
    sigma = None
    if kind.sigma is not None and kind.sigma[0] in values:
        sigma = tuple(np.where(valid, values[name], 0.0) for name in kind.sigma)
    sigma_u, sigma_v = sigma or (None, None)
    table = DisparityTable(
        where, kind, first_line, x, y, np.where(valid, u, 0.0), np.where(valid, v, 0.0), sigma_u, sigma_v, valid, subset_px, lines
    )
    if (sentinels & valid).any():
        point = int(np.argmax(sentinels & valid))
        problem = f"is {u[point]:g} next to a v of {v[point]:g}, which marks a point that was not found, but {kind.mark} marks it as found"
        raise table.error(point, 2, problem, f"write {kind.mark} 0")
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
