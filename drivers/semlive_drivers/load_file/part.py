"""A file that another program writes line by line: load, extension or strain from its newest complete line."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, model_validator

from semlive.errors import BadInput, LinkError, LinkRefused
from semlive.inputs.lost_numbers import is_no_reading
from semlive.inputs.text_number import Sign, sign_of
from semlive.inputs.text_table import AmbiguousTable, Convention, key_of, number_in
from semlive.inputs.text_table import Column as HeadColumn
from semlive.ports import ClockSource
from semlive_drivers.device_part import PartCommand, PartReading
from semlive_drivers.load_file.column_units import KINDS, unit_factor, unit_next_to
from semlive_drivers.load_file.growing_table import GrowingTable, NewestLine
from semlive_drivers.load_file.unit_words import is_unit_or_factor
from semlive_drivers.settings import checked
from semlive_drivers.units import factor

_THOUSANDS = re.compile(r"[+-]?[0-9]{1,3}(?:['\u2019 \u00a0\u202f.,][0-9]{2,3})+(?:[.,][0-9]*)?")
_MIN_OVERLOAD = 1e6
"""N or mm; no load frame at a microscope has so much. Instruments return 9.9E+37 for an overload, 9.91E+37 for no value (SCPI 1999)."""
_MAX_GAGE_STRAIN = 0.25
"""No strain gage measures more; 125 without a unit is in microstrain."""


class Column(BaseModel):
    """Column of a number."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    column: int | str
    """Number from 1, or the name in the head of the file; letter case, blanks, underscores and a unit in brackets are ignored."""
    unit: str = "1"
    """Unit of the numbers; without it, the unit in the head of the file: ``Force (kN)``."""
    scale: float = 1.0
    """Factor of the numbers; -1 inverts the sign."""

    @property
    def stated_unit(self) -> str | None:
        """The unit; None if the settings contain none."""
        return self.unit if "unit" in self.model_fields_set else None


class CsvSettings(BaseModel):
    """Settings of a growing file."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    file: Path
    """Path of the file. With ``*`` and ``?`` in its name, the latest file is read."""
    delimiter: str = Field(default="", max_length=4)
    """Separator of columns; empty detects tab, semicolon, comma or blanks."""
    decimal_comma: bool | None = None
    """Decimal sign; None detects it from the head of the file. Set it if the head is ambiguous."""
    encoding: str = "utf-8"
    """Encoding of a file without a byte order mark."""
    force: Column | None = None
    extension: Column | None = None
    gage: Column | None = None
    frozen_after_s: float = Field(default=3.0, gt=0)
    """A file that does not grow for this wall time gives no reading, also at the start of a run."""

    @model_validator(mode="after")
    def _names_a_column(self) -> CsvSettings:
        columns = (self.force, self.extension, self.gage)
        if not any(columns):
            raise ValueError("name a column: force, extension or gage")
        for column in columns:
            if column is not None:
                factor(column.unit, "csv column")
        return self


@dataclass(frozen=True, slots=True)
class _TableColumn:
    """A column of the settings, found in the head of a file.

    Attributes:
        kind: force, extension or gage.
        column: settings of the column.
        index: index of the cell in a line.
        factor: N, mm or strain of one unit of the file.
    """

    kind: str
    column: Column
    index: int
    factor: float


class CsvLoadFile:
    """The Part over a growing file, which measures and takes no orders.

    Raises:
        LinkRefused: if the file does not exist, or its head does not match the settings.
    """

    simulated = False
    has_watchdog = False
    capabilities: frozenset[PartCommand] = frozenset()

    def __init__(self, settings: CsvSettings, clock: ClockSource) -> None:
        self._settings, self._clock = settings, clock
        self.where = str(settings.file)
        decimal = {None: "", True: ",", False: "."}[settings.decimal_comma]
        self._table = GrowingTable(self._number_columns, Convention(settings.delimiter, decimal), settings.encoding)
        self._last_end: tuple[Path, int] | None = None
        self._grew_mono_ns = clock.mono_ns()
        try:
            self._newest_line()
        except LinkError as error:
            raise LinkRefused(str(error)) from error

    def read(self) -> PartReading:
        """The values in the newest complete line.

        Raises:
            LinkError: if the file does not exist any more or does not grow, or its line does not match its head or lacks a number.
        """
        now = self._clock.mono_ns()
        newest = self._newest_line()
        if newest is None:
            raise LinkError(f"{self.where} holds no complete line of numbers yet; start the recording")
        end = (newest.path, newest.end)
        if end != self._last_end:
            self._last_end, self._grew_mono_ns = end, now
        elif now - self._grew_mono_ns > self._settings.frozen_after_s * 1e9:
            still_s = (now - self._grew_mono_ns) / 1e9
            raise LinkError(f"{newest.path} has not grown for {still_s:.1f} s; check that the program that writes it is recording")
        columns = self._find_columns(newest.layout.columns)
        for column in columns:
            _check_unit_in_line(column, newest)
        values = {column.kind: _value(column, newest) for column in columns}
        return PartReading(force_n=values.get("force"), extension_mm=values.get("extension"), gage_strain=values.get("gage"))

    def holds_numbers(self) -> bool:
        """Whether the file holds a complete line of numbers.

        Raises:
            LinkError: if it cannot be read, or its line does not match its head.
        """
        return self._newest_line() is not None

    def identify(self) -> PartReading:
        """As `read`, which writes nothing."""
        return self.read()

    def command(self, order: PartCommand, values: Mapping[str, float]) -> None:
        """Refuse an order: a file takes none.

        Raises:
            LinkError: always.
        """
        del values
        raise LinkError(f"{self.where} is a file and takes no order to {order}")

    def blind_stop(self) -> None:
        """Nothing moves."""

    def close(self) -> None:
        """Nothing stays open."""

    def _newest_file(self) -> Path:
        file = self._settings.file
        if not any(letter in file.name for letter in "*?"):
            if not file.exists():
                raise LinkRefused(f"{file}: there is no such file; start the recording, or correct the path")
            return file
        paths = sorted(file.parent.glob(file.name), key=lambda path: path.stat().st_mtime_ns)
        if not paths:
            raise LinkRefused(f"{file}: no file has such a name; start the recording, or correct the path")
        return paths[-1]

    def _newest_line(self) -> NewestLine | None:
        """The newest complete line of numbers; None if there is none yet.

        Raises:
            LinkError: if the file cannot be read, or is no valid table.
        """
        try:
            return self._table.newest(self._newest_file())
        except OSError as error:
            raise LinkError(f"{self.where} cannot be read ({error.strerror}); check the program that writes it") from error
        except AmbiguousTable as error:
            raise LinkError(f"{str(error).rstrip('.')} with delimiter and decimal_comma") from error
        except LinkError:
            raise
        except BadInput as error:
            raise LinkError(str(error).rstrip(".")) from error

    def _number_columns(self, columns: tuple[HeadColumn, ...]) -> tuple[int, ...]:
        # The cell of a gage may be a text that means "no value".
        found = self._find_columns(columns)
        return tuple(column.index for column in found if column.kind != "gage") or tuple(column.index for column in found)

    def _find_columns(self, columns: tuple[HeadColumn, ...]) -> list[_TableColumn]:
        """The columns of the settings in the head of the file; errors begin with ``{head}``, its line.

        Raises:
            BadInput: if a column does not exist, exists twice, or has another unit than in the settings.
        """
        found: list[_TableColumn] = []
        for kind in KINDS:
            column: Column | None = getattr(self._settings, kind)
            if column is not None:
                index = _index_of(column, columns)
                found.append(_TableColumn(kind, column, index, column.scale * unit_factor(kind, column.stated_unit, columns, index)))
        return found


def _index_of(column: Column, columns: tuple[HeadColumn, ...]) -> int:
    name = column.column
    if isinstance(name, int):
        if not 0 < name <= len(columns):
            raise BadInput(f"{{head}}: there is no column {name} among {len(columns)}; check columns and delimiter.")
        return name - 1
    exact = [index for index, head in enumerate(columns) if head.raw == name]
    similar = [index for index, head in enumerate(columns) if key_of(name) in (head.key, key_of(head.raw))]
    matches = exact or similar
    if len(matches) != 1:
        names = ", ".join(head.raw for head in columns if head.raw) or "no names"
        problem = f"there is no column {name!r}" if not matches else f"column {name!r} exists {len(matches)} times"
        advice = "columns and delimiter" if names.isascii() else "columns, delimiter and encoding"
        raise BadInput(f"{{head}}: {problem} (it has {names[:200]}); check {advice}.")
    return matches[0]


def _check_unit_in_line(column: _TableColumn, newest: NewestLine) -> None:
    """Refuse ``0.134;kN`` as newtons: a cell next to the number is its unit, as force gauges send it.

    Raises:
        LinkError: if that unit differs from the one of the column.
    """
    unit = unit_next_to(newest.cells, column.index)
    behind = (*newest.cells, "")[column.index + 1]
    if not unit and column.column.stated_unit is None and not behind[:1].isdigit() and is_unit_or_factor(column.kind, behind):
        where = f"{newest.path}: {newest.line} holds {newest.cells[column.index][:40]!r} in column {column.column.column}"
        raise LinkError(f"{where} next to {behind[:20]!r}, which may be its unit; state it in the settings")
    if unit not in KINDS[column.kind] or unit == "1":
        return
    size = factor(unit, "csv column")
    if abs(column.factor) not in (size, abs(size * column.column.scale)):
        where = f"{newest.path}: {newest.line} holds {newest.cells[column.index][:40]!r} in column {column.column.column}"
        raise LinkError(f"{where} next to the unit {unit}; state it in the settings, and record one unit")


def _value(column: _TableColumn, newest: NewestLine) -> float | None:
    """The number in a cell; None if the cell of a gage contains no number.

    Raises:
        LinkError: if the cell of another column contains no number.
    """
    text = newest.cells[column.index]
    number = number_in(text, newest.layout.decimal)
    if number is not None and column.kind == "gage" and abs(number * column.factor) > _MAX_GAGE_STRAIN:
        return _no_strain(column, newest)
    if number is not None and abs(number * column.factor) < _MIN_OVERLOAD and not is_no_reading(number):
        return number * column.factor
    if column.kind == "gage" and (number is not None or not any(letter.isdigit() for letter in text)):
        return None
    where = f"{newest.path}: {newest.line} holds {text[:40]!r} in column {column.column.column}"
    if number is not None:
        raise LinkError(f"{where}, which is no reading but a lost value; check the sensor and the program that writes it")
    if sign_of(text) is Sign.THOUSANDS or _THOUSANDS.fullmatch(text):
        raise LinkError(f"{where}; switch the separator of thousands off in the program that writes it")
    raise LinkError(f"{where}, which is no reading; check columns, delimiter and decimal_comma")


def _no_strain(column: _TableColumn, newest: NewestLine) -> None:
    """A gage with a known unit is overloaded, so it has no value.

    Raises:
        LinkError: if the unit is not known.
    """
    if column.column.stated_unit is None and not newest.layout.columns[column.index].unit:
        where = f"{newest.path}: {newest.line} holds {newest.cells[column.index][:40]!r} in column {column.column.column}"
        raise LinkError(f"{where}, which is no strain; state its unit in the settings ({', '.join(KINDS['gage'])})")


def open_part(settings: Mapping[str, object], clock: ClockSource, where: str = "csv") -> CsvLoadFile:
    """Open a growing file.

    Raises:
        BadConfig: for settings that are not valid.
        LinkRefused: if the file does not exist, or its head does not match the settings.
    """
    return CsvLoadFile(checked(CsvSettings, settings, where), clock)
