"""Disparity maps as text, in the words of several engines (format 1, see docs/import.md): bytes to a map on a regular grid.

Engines differ in the names of their columns and in how they say that a point was not found:

| engine | columns | not found |
|---|---|---|
| semlive | ``x, y, u, v``; optionally ``sigma_u, sigma_v, valid`` | valid 0 |
| ``semlive dic`` | ``x, y, u, v, sigma_u, sigma_v, zncc, status`` | status not ``converged`` |
| VIC-2D | ``x, y, u, v, sigma`` among others, names in quotes | sigma below 0, or the point left out |
| DICe | ``COORDINATE_X, COORDINATE_Y, DISPLACEMENT_X, DISPLACEMENT_Y, SIGMA``; ``***`` lines above | SIGMA below 0, or the point left out |
| OpenCorr | ``x, y, u, v, ZNCC, convergence`` (``saveTable2D``) | ZNCC below 0 or NaN |
| pyvale | ``subset_x, subset_y, displacement_u, displacement_v, converged`` | converged 0, NaN |
"""

from __future__ import annotations

import io
import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import PoiStatus
from semlive.errors import BadInput

Column = NDArray[np.float64]
PIXELS = ("px", "pixel", "pixels", "pix")
_UNIT = re.compile(r"[\[(]\s*([^\])]*?)\s*[\])]\s*$")
_SUBSET = re.compile(rb"^\*{3}\s*Subset size:\s*(\d+)", re.MULTILINE)
_STATUS_WORDS = sorted(PoiStatus, key=lambda status: -len(status.word))


@dataclass(frozen=True, slots=True)
class Dialect:
    """How one engine writes.

    Attributes:
        name: of the engine, as in ``--from``.
        place: columns of x, y, u, v in px.
        sigma: columns of the standard uncertainties of u and v; empty without.
        mark: column that says which points count; empty without.
        at_least: a point counts where the mark is at least this.
        whole: whether every point of the grid must be listed.
    """

    name: str
    place: tuple[str, str, str, str]
    sigma: tuple[str, str] | None
    mark: str
    at_least: float
    whole: bool


XYUV = ("x", "y", "u", "v")
DIALECTS = {
    one.name: one
    for one in (
        Dialect("semlive", XYUV, ("sigma_u", "sigma_v"), "valid", 0.5, True),
        Dialect("semlive-dic", XYUV, ("sigma_u", "sigma_v"), "status", 0.5, True),
        Dialect("vic2d", XYUV, ("sigma", "sigma"), "sigma", 0.0, False),
        Dialect("dice", ("coordinate_x", "coordinate_y", "displacement_x", "displacement_y"), ("sigma", "sigma"), "sigma", 0.0, False),
        Dialect("opencorr", XYUV, None, "zncc", 0.0, False),
        Dialect("pyvale", ("subset_x", "subset_y", "displacement_u", "displacement_v"), None, "converged", 0.5, False),
    )
}


@dataclass(frozen=True, slots=True, eq=False)
class DisparityTable:
    """A disparity map as listed, point by point; units px.

    Attributes:
        where: name of the file, for errors.
        dialect: how it was written.
        first_line: number of the first point's line, from 1.
        x_px: (n,) columns of the points in the reference frame.
        y_px: (n,) rows.
        u_px: (n,) disparity along x, zero where not valid.
        v_px: (n,) disparity along y, zero where not valid.
        sigma_u_px: (n,) standard uncertainty of u; None if not told.
        sigma_v_px: (n,) standard uncertainty of v; None if not told.
        valid: (n,) whether the point was found.
        subset_px: edge of the subset; 0 if not told.
        lines: (n,) line numbers; None where points follow each other without a gap.
    """

    where: str
    dialect: Dialect
    first_line: int
    x_px: Column
    y_px: Column
    u_px: Column
    v_px: Column
    sigma_u_px: Column | None
    sigma_v_px: Column | None
    valid: NDArray[np.bool_]
    subset_px: int
    lines: NDArray[np.int64] | None = None

    def wrong(self, point: int, column: int, what: str, do: str) -> BadInput:
        """What is wrong with one of the columns of place, with file, line and column."""
        line = self.first_line + point if self.lines is None else int(self.lines[point])
        return BadInput(f"{self.where}: line {line}, column {self.dialect.place[column]}: {what}; {do}.")


def read_disparity_table(data: bytes, where: str, dialect: str | None = None) -> DisparityTable:
    """The points of one map, numbers checked.

    Args:
        data: the file.
        where: its name, for errors.
        dialect: name of the engine; by default told from the header.

    Raises:
        BadInput: naming file, line and column, and what to do.
    """
    begin, first_line = _header(data, where)
    end = data.find(b"\n", begin)
    end = len(data) if end < 0 else end
    try:
        head = data[begin:end].decode("utf-8-sig" if begin == 0 else "utf-8").strip()
        body = data[end + 1 :].decode("ascii")
    except UnicodeDecodeError as error:
        raise BadInput(f"{where}: is not plain text (byte {error.start}); export the map as CSV.") from error
    delimiter = next((one for one in (",", ";", "\t") if one in head), None)
    names = _names(head, delimiter, where, first_line)
    kind = _dialect(names, where, first_line, dialect)
    wanted = [*kind.place, *(kind.sigma or ()), kind.mark]
    at = {name: names.index(name) for name in wanted if name in names}
    columns, lines = _numbers(_words_to_numbers(body, kind), delimiter, at, kind, where, first_line + 1)
    if len(columns) == 0:
        raise BadInput(f"{where}: line {first_line + 1}: holds no point; export the map's points below its header.")
    values = dict(zip(at, columns.T, strict=True))
    subset = _SUBSET.search(data[:begin])
    return _table(values, kind, where, first_line + 1, min(int(subset.group(1)), 10**6) if subset else 0, lines)


def _header(data: bytes, where: str) -> tuple[int, int]:
    """Where the line of column names begins, and its number; lines above that begin with *** or # are an engine's own words."""
    begin, line = 0, 1
    while begin < len(data):
        end = data.find(b"\n", begin)
        text = data[begin : end if end >= 0 else len(data)].strip()
        if text and not text.startswith((b"***", b"#")):
            return begin, line
        if end < 0:
            break
        begin, line = end + 1, line + 1
    raise BadInput(f"{where}: line 1: holds no header; the first line must name the columns x,y,u,v.")


def _names(head: str, delimiter: str | None, where: str, line: int) -> list[str]:
    names = []
    for cell in head.split(delimiter):
        name = cell.strip().strip('"').strip()
        unit = _UNIT.search(name)
        if unit is not None:
            name = name[: unit.start()].strip()
            if name.lower() in ("x", "y", "u", "v", "sigma", "sigma_u", "sigma_v") and unit.group(1).lower() not in PIXELS:
                raise BadInput(f"{where}: line {line}, column {name}: is in {unit.group(1)[:20]!r}; export it in pixels.")
        names.append(name.lower())
    return names


def _dialect(names: list[str], where: str, line: int, asked: str | None) -> Dialect:
    kind = DIALECTS[asked] if asked else DIALECTS[_sniffed(names)]
    required = [*kind.place, *([kind.mark] if kind.mark != "valid" else [])]
    for name in required:
        if name not in names:
            raise BadInput(f"{where}: line {line}: column {name} is missing; a map of {kind.name} has {', '.join(required)}.")
    for name in (*required, *(kind.sigma or ()), kind.mark):
        if names.count(name) > 1:
            raise BadInput(f"{where}: line {line}: column {name} stands there twice; keep one.")
    if kind.sigma is not None and (kind.sigma[0] in names) != (kind.sigma[1] in names):
        missing = kind.sigma[0] if kind.sigma[0] not in names else kind.sigma[1]
        raise BadInput(f"{where}: line {line}: column {missing} is missing; give sigma_u and sigma_v, or neither.")
    return kind


def _sniffed(names: list[str]) -> str:
    if "coordinate_x" in names:
        return "dice"
    if "subset_x" in names:
        return "pyvale"
    if "zncc" in names and "status" in names:
        return "semlive-dic"
    if "zncc" in names and "convergence" in names:
        return "opencorr"
    return "vic2d" if "sigma" in names and "sigma_u" not in names else "semlive"


def _words_to_numbers(body: str, kind: Dialect) -> str:
    if kind.mark == "status":
        for status in _STATUS_WORDS:
            body = body.replace(status.word, "1" if status is PoiStatus.CONVERGED else "0")
    if kind.mark == "converged":
        body = body.replace("True", "1").replace("False", "0")
    return body


def _numbers(
    body: str, delimiter: str | None, at: dict[str, int], kind: Dialect, where: str, first_line: int
) -> tuple[NDArray[np.float64], NDArray[np.int64] | None]:
    """(points, columns) of the wanted columns, and line numbers if blank lines lie between."""
    if not body.strip():
        return np.zeros((0, len(at))), None
    body = body.rstrip()
    plain = "\n\n" not in body and "\n\r\n" not in body and '"' not in body and "\r\r" not in body and body.lstrip("\r\n") == body
    if plain:
        try:
            found = np.loadtxt(io.StringIO(body), delimiter=delimiter, usecols=tuple(at.values()), comments=None, ndmin=2)
        except (ValueError, OverflowError):
            pass  # something is wrong with a line: the slow way finds which
        else:
            return found, None
    rows, lines = [], []
    for line, text in enumerate(body.split("\n"), start=first_line):
        if not text.strip():
            continue
        cells = text.rstrip("\r").split(delimiter)
        rows.append([_number(cells, index, name, kind, at, where, line) for name, index in at.items()])
        lines.append(line)
    return np.array(rows).reshape(-1, len(at)), np.array(lines)


def _number(cells: list[str], index: int, name: str, kind: Dialect, at: dict[str, int], where: str, line: int) -> float:
    place = f"{where}: line {line}, column {name}"
    if index >= len(cells):
        raise BadInput(f"{place}: the line ends before it; every line needs all columns.")
    text = cells[index].strip().strip('"').strip()
    if not text:
        if name not in kind.place[:2] and kind.mark != name and _not_found(cells, kind, at):
            return 0.0
        raise BadInput(f"{place}: is empty; give a number, or say with the column valid that the point was not found.")
    try:
        return float(text)
    except ValueError:
        raise BadInput(f"{place}: {text[:40]!r} is no number; write a number with a decimal point.") from None


def _not_found(cells: list[str], kind: Dialect, at: dict[str, int]) -> bool:
    try:
        return float(cells[at[kind.mark]]) < kind.at_least
    except (KeyError, IndexError, ValueError):
        return False


def _table(
    values: dict[str, Column], kind: Dialect, where: str, first_line: int, subset_px: int, lines: NDArray[np.int64] | None
) -> DisparityTable:  # fmt: skip
    x, y, u, v = (values[name] for name in kind.place)
    mark = values.get(kind.mark)
    valid = np.ones(len(x), dtype=np.bool_) if mark is None else mark >= kind.at_least
    sigma = None
    if kind.sigma is not None and kind.sigma[0] in values:
        sigma = tuple(np.where(valid, values[name], 0.0) for name in kind.sigma)
    sigma_u, sigma_v = sigma or (None, None)
    table = DisparityTable(
        where, kind, first_line, x, y, np.where(valid, u, 0.0), np.where(valid, v, 0.0), sigma_u, sigma_v, valid, subset_px, lines
    )
    _check_finite(table, mark)
    return table


def _check_finite(table: DisparityTable, mark: Column | None) -> None:
    for column, values in enumerate((table.x_px, table.y_px, table.u_px, table.v_px)):
        bad = ~(np.abs(values) < 1e6)
        if bad.any():
            point = int(np.argmax(bad))
            do = "give it in pixels, or say with the column valid that the point was not found" if column > 1 else "give it in pixels"
            raise table.wrong(point, column, f"is {values[point]:g}", do)
    for name, values in (("sigma_u", table.sigma_u_px), ("sigma_v", table.sigma_v_px)):
        if values is not None and not (ok := (values >= 0) & (values < 1e6)).all():
            point = int(np.argmin(ok))
            line = table.first_line + point if table.lines is None else int(table.lines[point])
            raise BadInput(f"{table.where}: line {line}, column {name}: is {values[point]:g}; give a standard uncertainty in pixels.")
    if mark is not None and table.dialect.whole and np.isnan(mark).any():
        point = int(np.argmax(np.isnan(mark)))
        line = table.first_line + point if table.lines is None else int(table.lines[point])
        raise BadInput(f"{table.where}: line {line}, column {table.dialect.mark}: is nan; write 1 where the point was found, else 0.")
