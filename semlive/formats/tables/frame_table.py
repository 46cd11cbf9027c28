"""`frames.csv`: description of frames that another DIC program correlated (format 1, see docs/how-to/import.md)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from semlive.data.experiment import Phase
from semlive.errors import BadInput
from semlive.formats.tables.sentinels import is_sentinel
from semlive.inputs.text_table import TITLE_LINES, Column, is_blank, key_of, layout_of, lines_of, number_in, text_of

FORMAT_VERSION = 1
REQUIRED_COLUMNS = (
    "frame",
    "pair",
    "phase",
    "start_s",
    "dwell_s",
    "row_time_s",
    "width",
    "height",
    "integrations",
    "load_n",
    "shift_x_px",
    "shift_y_px",
)
OPTIONAL_COLUMNS = ("gage_strain", "pixel_nm", "rotation_deg")
_MAX_INTEGER = 10**7
# Limits that no scan exceeds: a larger value has another unit.
_MAX_VALUES = {"dwell_s": 0.1, "row_time_s": 100.0, "start_s": 1e8, "gage_strain": 1.0}
_MAY_BE_LOST = ("load_n", "gage_strain", "shift_x_px", "shift_y_px", "pixel_nm", "rotation_deg")
_ROUNDING = 1.001


@dataclass(frozen=True, slots=True)
class FrameRow:
    """One line of `frames.csv`.

    Attributes:
        line: number of the line in the file, from 1.
        frame: 2 * pair + 0 or 1.
        pair: number of the pair.
        phase: purpose of the pair.
        start_s: start of the scan in s, on any time axis.
        dwell_s: time on one pixel, s.
        row_time_s: time from the start of one row to the start of the next, fly-back included, s.
        width: px.
        height: px.
        integrations: number of scans that were integrated into the frame.
        load_n: mean load in N; None without one.
        shift_px: commanded translation (x, y) in px; None if unknown.
        gage_strain: mean of a strain gage; None without one.
        pixel_nm: pixel size, nm; None if unknown.
        rotation_deg: rotation of the scan; None if unknown.
    """

    line: int
    frame: int
    pair: int
    phase: Phase
    start_s: float
    dwell_s: float
    row_time_s: float
    width: int
    height: int
    integrations: int
    load_n: float | None
    shift_px: tuple[float, float] | None
    gage_strain: float | None
    pixel_nm: float | None = None
    rotation_deg: float | None = None

    @property
    def end_s(self) -> float:
        """End of the last scan, s."""
        return self.start_s + self.integrations * self.height * self.row_time_s


def read_frame_table(data: bytes, where: str) -> tuple[FrameRow, ...]:
    """Read the frames in the order of their numbers and check each of them and all together.

    Args:
        data: bytes of the file.
        where: name of the file, for errors.

    Raises:
        BadInput: the table is invalid; the message contains file, line, column and advice.
    """
    lines = lines_of(text_of(data, where))
    layout = layout_of(lines, where, _numeric_places, searched=TITLE_LINES)
    keys = _keys(layout.columns)
    at = {name: keys.index(key_of(name)) for name in (*REQUIRED_COLUMNS, *OPTIONAL_COLUMNS) if key_of(name) in keys}
    rows: list[FrameRow] = []
    for number, line in enumerate(lines[layout.first_line - 1 :], layout.first_line):
        if not is_blank(line):
            cells = layout.cells(line, number)
            layout = layout.after(cells)
            rows.append(_row({name: cells[place] for name, place in at.items()}, number, where, layout.decimal))
    if not rows:
        raise BadInput(f"{where}: line {layout.first_line}: holds no frame; write one line for each frame.")
    rows.sort(key=lambda row: (row.frame, row.line))
    _check_together(rows, where)
    return tuple(rows)


def _numeric_places(columns: tuple[Column, ...]) -> tuple[int, ...]:
    """Return the places of the columns of numbers; errors begin with ``{head}``, the line of names.

    Raises:
        BadInput: a column is missing or occurs twice.
    """
    keys = _keys(columns)
    for name in REQUIRED_COLUMNS:
        if key_of(name) not in keys:
            quantity, _, unit = name.rpartition("_")
            for column in columns:
                if column.unit and column.key == key_of(quantity):
                    raise BadInput(f"{{head}}: column {column.raw} is in {column.unit}; give {name} in {unit.replace('n', 'N')}.")
            raise BadInput(f"{{head}}: column {name} is missing; add it (the columns are {', '.join(REQUIRED_COLUMNS)}).")
    for column, key in zip(columns, keys, strict=True):
        if key and keys.count(key) > 1:
            raise BadInput(f"{{head}}: column {column.name} occurs twice; keep one.")
    return tuple(keys.index(key_of(name)) for name in (*REQUIRED_COLUMNS, *OPTIONAL_COLUMNS) if key_of(name) in keys and name != "phase")


def _keys(columns: tuple[Column, ...]) -> list[str]:
    """Return the keys of the columns; a unit in brackets counts as the end of a name: ``start (s)`` is start_s."""
    names = {key_of(name) for name in (*REQUIRED_COLUMNS, *OPTIONAL_COLUMNS)}
    with_units = (key_of(column.name + column.unit) for column in columns)
    return [key if key in names else column.key for column, key in zip(columns, with_units, strict=True)]


def _row(cells: Mapping[str, str], line: int, where: str, decimal: str) -> FrameRow:
    at = _Line(cells, line, where, decimal)
    phases = ", ".join(Phase)
    phase = at.text("phase").lower()
    if phase not in list(Phase):
        raise at.wrong("phase", f"{at.text('phase')!r} is no phase", f"write one of {phases}")
    shift = (at.number_or_none("shift_x_px"), at.number_or_none("shift_y_px"))
    if (shift[0] is None) != (shift[1] is None):
        empty = "shift_x_px" if shift[0] is None else "shift_y_px"
        raise at.wrong(empty, "is empty but the other axis is not", "give both or neither")
    row = FrameRow(
        line=line,
        frame=at.integer("frame", 0),
        pair=at.integer("pair", 0),
        phase=Phase(phase),
        start_s=at.number("start_s"),
        dwell_s=at.positive("dwell_s"),
        row_time_s=at.positive("row_time_s"),
        width=at.integer("width", 1),
        height=at.integer("height", 1),
        integrations=at.integer("integrations", 1),
        load_n=at.number_or_none("load_n"),
        shift_px=None if shift[0] is None or shift[1] is None else (shift[0], shift[1]),
        gage_strain=at.number_or_none("gage_strain"),
        pixel_nm=at.number_or_none("pixel_nm"),
        rotation_deg=at.number_or_none("rotation_deg"),
    )
    if row.pixel_nm is not None and not row.pixel_nm > 0:
        raise at.wrong("pixel_nm", f"is {row.pixel_nm:g}", "give a size above 0 in nm")
    for axis, (value, size) in enumerate(zip(row.shift_px or (), (row.width, row.height), strict=False)):
        if abs(value) >= size:
            problem = f"{value:g} px is longer than the frame of {row.width} x {row.height} px"
            raise at.wrong(("shift_x_px", "shift_y_px")[axis], problem, "give it in pixels, or leave both cells empty")
    if row.frame // 2 != row.pair:
        raise at.wrong(
            "pair", f"is {row.pair} but frame {row.frame} belongs to pair {row.frame // 2}", "frames of pair k are 2k and 2k + 1"
        )
    if row.width * row.dwell_s > _ROUNDING * row.row_time_s:
        problem = f"{row.row_time_s:g} s is shorter than {row.width} px of {row.dwell_s:g} s each"
        raise at.wrong("row_time_s", problem, "give dwell_s and row_time_s in seconds, fly-back included")
    return row


@dataclass(frozen=True, slots=True)
class _Line:
    """The cells of a line by column; errors contain file, line and column."""

    cells: Mapping[str, str]
    line: int
    where: str
    decimal: str

    def wrong(self, column: str, problem: str, advice: str) -> BadInput:
        return BadInput(f"{self.where}: line {self.line}, column {column}: {problem}; {advice}.")

    def text(self, column: str) -> str:
        cell = (self.cells.get(column) or "").strip()
        if not cell:
            raise self.wrong(column, "is empty", "give a value")
        return cell

    def number(self, column: str) -> float:
        cell = self.text(column)
        value = number_in(cell, self.decimal)
        if value is None:
            raise self.wrong(column, f"{cell[:40]!r} is not a number", "write a number with a decimal point, and none between thousands")
        if not math.isfinite(value):
            raise self.wrong(column, f"is {cell[:40]}", "give a finite number, or leave out this frame's pair")
        if abs(value) > _MAX_VALUES.get(column, 1e12):
            units = {"gage_strain": "strain, 1e-6 for one microstrain"}
            unit = "seconds" if column.endswith("_s") else units.get(column, "the unit of its name")
            raise self.wrong(column, f"{value:g} is beyond the range of scans", f"give it in {unit}")
        if column in _MAY_BE_LOST and is_sentinel(value):
            raise self.wrong(column, f"{cell[:40]} may be a value or mark a missing one", "leave the cell empty if there is none")
        return value

    def positive(self, column: str) -> float:
        value = self.number(column)
        if not value > 0:
            raise self.wrong(column, f"is {value:g}", "give a time above 0 in seconds")
        return value

    def integer(self, column: str, minimum: int) -> int:
        value = self.number(column)
        if value != int(value) or not minimum <= value <= _MAX_INTEGER:
            raise self.wrong(column, f"{self.text(column)[:40]} is no integer of at least {minimum}", "correct it")
        return int(value)

    def number_or_none(self, column: str) -> float | None:
        value = number_in((self.cells.get(column) or "").strip(), self.decimal)
        return None if value is not None and math.isnan(value) else self.number(column)


def _check_together(rows: list[FrameRow], where: str) -> None:
    first = rows[0]
    for before, after in itertools.pairwise(rows):
        at = f"{where}: line {after.line}, column"
        if before.frame == after.frame:
            raise BadInput(f"{at} frame: frame {after.frame} is in line {before.line} already; keep one.")
        starts = f"frame {after.frame} starts at {after.start_s:g} s"
        if after.start_s <= before.start_s:
            problem = f"{starts}, not after frame {before.frame} ({before.start_s:g} s, line {before.line})"
            raise BadInput(f"{at} start_s: {problem}; times must rise with the frame's number.")
        if after.start_s < before.end_s - 1e-3 * (before.end_s - before.start_s):
            problem = f"{starts}, before frame {before.frame} ends ({before.end_s:g} s by row_time_s x height x integrations)"
            raise BadInput(f"{at} start_s: {problem}; check the units, all times are in seconds.")
        for name in ("width", "height"):
            if getattr(after, name) != getattr(first, name):
                problem = f"is {getattr(after, name)} but frame {first.frame} has {getattr(first, name)}"
                raise BadInput(f"{at} {name}: {problem}; all frames must be of one size.")
    for first, second in _pairs(rows, where):
        _check_pair(first, second, where)


def _check_pair(first: FrameRow, second: FrameRow, where: str) -> None:
    if first.phase is not second.phase:
        problem = f"{second.phase} but frame {first.frame} of the same pair is {first.phase}"
        raise BadInput(f"{where}: line {second.line}, column phase: {problem}; write the same.")
    for name in ("load_n", "gage_strain"):
        empty = [row for row in (first, second) if getattr(row, name) is None]
        if len(empty) == 1:
            problem = "is empty but the pair's other frame has one"
            raise BadInput(f"{where}: line {empty[0].line}, column {name}: {problem}; give both or neither.")
        if name == "gage_strain" and not empty and first.load_n is None and first.phase is Phase.TENSION:
            problem = "is empty but gage_strain is given"
            raise BadInput(f"{where}: line {first.line}, column load_n: {problem}; a strain gage is compared under load.")


def _pairs(rows: list[FrameRow], where: str) -> Iterator[tuple[FrameRow, FrameRow]]:
    if rows[0].pair != 0:
        raise BadInput(
            f"{where}: line {rows[0].line}, column frame: the first frame is {rows[0].frame}; "
            "begin with pair 0, the reference of all others."
        )
    by_pair: dict[int, list[FrameRow]] = {}
    for row in rows:
        by_pair.setdefault(row.pair, []).append(row)
    for pair, members in by_pair.items():
        if len(members) != 2:
            missing = 2 * pair + 1 - members[0].frame % 2
            raise BadInput(
                f"{where}: line {members[0].line}, column pair: pair {pair} has no frame {missing}; add it, or leave the pair out."
            )
        yield members[0], members[1]
