"""A file that another program writes line by line: load, extension or strain from its newest whole line."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, model_validator

from semlive.errors import BadInput, LinkError, LinkRefused
from semlive.inputs.text_table import AmbiguousTable, Convention, key_of, number_in
from semlive.inputs.text_table import Column as HeadColumn
from semlive.ports import ClockSource
from semlive_drivers.device_part import PartCommand, PartReading
from semlive_drivers.growing_table import GrowingTable, Newest
from semlive_drivers.modbus.settings import checked
from semlive_drivers.units import factor, unit_named

_KINDS = {"force": ("N", "kN", "mN", "kg", "g", "t", "lbF"), "extension": ("mm", "um", "m", "in"), "gage": ("ustrain", "%", "1")}


class Column(BaseModel):
    """Where a number stands in a line."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    column: int | str
    """Number from 1, or the name in the file's head; letter case, blanks, underscores and a unit in brackets do not count."""
    unit: str = "1"
    """Where it is left out, the unit in the file's head counts: ``Force (kN)``."""
    scale: float = 1.0
    """-1 turns the sign."""


class CsvSettings(BaseModel):
    """Settings of a file that grows."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    file: Path
    """A name may hold ``*`` and ``?``: then the file that was written last is read."""
    delimiter: str = Field(default="", max_length=4)
    """Nothing finds out: tab, semicolon, comma, or blanks."""
    decimal_comma: bool | None = None
    """Left out, the file's head decides; say it where that can be read in two ways."""
    encoding: str = "utf-8"
    """Of a file without a byte order mark."""
    force: Column | None = None
    extension: Column | None = None
    gage: Column | None = None
    frozen_after_s: float = Field(default=3.0, gt=0)
    """A file that does not grow for so long of wall time is no reading; None of its old lines is believed when the run begins."""

    @model_validator(mode="after")
    def _tells_something(self) -> CsvSettings:
        columns = (self.force, self.extension, self.gage)
        if not any(columns):
            raise ValueError("name a column: force, extension or gage")
        for column in columns:
            if column is not None:
                factor(column.unit, "csv column")
        return self


@dataclass(frozen=True, slots=True)
class _Wanted:
    """A column of the settings in a file's head.

    Attributes:
        kind: force, extension or gage.
        column: as in the settings.
        place: of the cell.
        factor: from a number of the file to N, mm or strain.
    """

    kind: str
    column: Column
    place: int
    factor: float


class CsvLoadFile:
    """The Part over a growing file; it tells and cannot be told.

    Raises:
        LinkRefused: if there is no such file, or its head does not fit the settings.
    """

    simulated = False
    has_watchdog = False
    capabilities: frozenset[PartCommand] = frozenset()

    def __init__(self, settings: CsvSettings, clock: ClockSource) -> None:
        self._settings, self._clock = settings, clock
        self.where = str(settings.file)
        decimal = {None: "", True: ",", False: "."}[settings.decimal_comma]
        self._table = GrowingTable(self._places, Convention(settings.delimiter, decimal), settings.encoding)
        self._seen: tuple[Path, int] | None = None
        self._grew_mono_ns = clock.mono_ns()
        try:
            self._newest_line()
        except LinkError as error:
            raise LinkRefused(str(error)) from error

    def read(self) -> PartReading:
        """The newest whole line.

        Raises:
            LinkError: if the file is gone, does not grow, or its line does not fit its head or holds no number where one must be.
        """
        now = self._clock.mono_ns()
        newest = self._newest_line()
        if newest is None:
            raise LinkError(f"{self.where} holds no whole line of numbers yet; start the recording")
        seen = (newest.path, newest.end)
        if seen != self._seen:
            self._seen, self._grew_mono_ns = seen, now
        elif now - self._grew_mono_ns > self._settings.frozen_after_s * 1e9:
            still_s = (now - self._grew_mono_ns) / 1e9
            raise LinkError(f"{newest.path} has not grown for {still_s:.1f} s; check that the program that writes it is recording")
        values = {one.kind: _value(one, newest) for one in self._wanted(newest.layout.columns)}
        return PartReading(force_n=values.get("force"), extension_mm=values.get("extension"), gage_strain=values.get("gage"))

    def identify(self) -> PartReading:
        """The same: reading writes nothing."""
        return self.read()

    def command(self, what: PartCommand, values: Mapping[str, float]) -> None:
        """Nothing can be told to a file.

        Raises:
            LinkError: always.
        """
        del values
        raise LinkError(f"{self.where} is a file and cannot be told to {what}")

    def blind_stop(self) -> None:
        """Nothing moves."""

    def close(self) -> None:
        """Nothing stays open."""

    def _newest(self) -> Path:
        file = self._settings.file
        if not any(letter in file.name for letter in "*?"):
            if not file.exists():
                raise LinkRefused(f"{file}: there is no such file; start the recording, or correct the path")
            return file
        found = sorted(file.parent.glob(file.name), key=lambda path: path.stat().st_mtime_ns)
        if not found:
            raise LinkRefused(f"{file}: no file has such a name; start the recording, or correct the path")
        return found[-1]

    def _newest_line(self) -> Newest | None:
        """The newest whole line of numbers, if there is one yet.

        Raises:
            LinkError: the file cannot be read, or not be understood.
        """
        try:
            return self._table.newest(self._newest())
        except OSError as error:
            raise LinkError(f"{self.where} cannot be read ({error.strerror}); check the program that writes it") from error
        except AmbiguousTable as error:
            raise LinkError(f"{str(error).rstrip('.')} with delimiter and decimal_comma") from error
        except LinkError:
            raise
        except BadInput as error:
            raise LinkError(str(error).rstrip(".")) from error

    def _places(self, columns: tuple[HeadColumn, ...]) -> tuple[int, ...]:
        # A gage may say in words that it has no value.
        return tuple(one.place for one in self._wanted(columns) if one.kind != "gage") or tuple(one.place for one in self._wanted(columns))

    def _wanted(self, columns: tuple[HeadColumn, ...]) -> list[_Wanted]:
        """The columns of the settings in the file's head; errors begin with ``{head}``, its line.

        Raises:
            BadInput: one is not there, there twice, or in another unit than the settings say.
        """
        found: list[_Wanted] = []
        for kind in _KINDS:
            column: Column | None = getattr(self._settings, kind)
            if column is not None:
                place = _place_of(column, columns)
                found.append(_Wanted(kind, column, place, column.scale * _factor(kind, column, columns[place])))
        return found


def _place_of(column: Column, columns: tuple[HeadColumn, ...]) -> int:
    wanted = column.column
    if isinstance(wanted, int):
        if not 0 < wanted <= len(columns):
            raise BadInput(f"{{head}}: there is no column {wanted} among {len(columns)}; check columns and delimiter.")
        return wanted - 1
    exact = [place for place, one in enumerate(columns) if one.raw == wanted]
    alike = [place for place, one in enumerate(columns) if key_of(wanted) in (one.key, key_of(one.raw))]
    places = exact or alike
    if len(places) != 1:
        names = ", ".join(one.raw for one in columns if one.raw) or "no names"
        said = f"there is no column {wanted!r}" if not places else f"column {wanted!r} stands there {len(places)} times"
        raise BadInput(f"{{head}}: {said} (it has {names[:200]}); check columns and delimiter.")
    return places[0]


def _factor(kind: str, column: Column, head: HeadColumn) -> float:
    """Value of one of the column's unit, by the settings or else by the file's head."""
    head_unit = unit_named(head.unit)
    if head_unit and head_unit not in _KINDS[kind]:
        raise BadInput(f"{{head}}: column {head.raw!r} is in {head.unit}, which is no unit of {kind}; check columns and delimiter.")
    if "unit" not in column.model_fields_set:
        return factor(head_unit or "1", "csv column")
    if head_unit and column.unit != "1" and factor(column.unit, "csv column") != factor(head_unit, "csv column"):
        raise BadInput(f"{{head}}: column {head.raw!r} is in {head.unit}, but the settings say {column.unit}; correct one of them.")
    return factor(column.unit, "csv column")


def _value(wanted: _Wanted, newest: Newest) -> float | None:
    """The number in a cell; None where a gage says that it has none.

    Raises:
        LinkError: it is no number.
    """
    text = newest.cells[wanted.place]
    number = number_in(text, newest.layout.decimal)
    if number is not None and math.isfinite(number):
        return number * wanted.factor
    if wanted.kind == "gage" and (number is not None or not any(letter.isdigit() for letter in text)):
        return None
    where = f"{newest.path} holds {text[:40]!r} in column {wanted.column.column}"
    raise LinkError(f"{where}, which is no reading; check columns, delimiter and decimal_comma")


def open_part(settings: Mapping[str, object], clock: ClockSource, where: str = "csv") -> CsvLoadFile:
    """Open a file that grows.

    Raises:
        BadConfig: for settings that are not understood.
        LinkRefused: if there is no such file, or its head does not fit the settings.
    """
    return CsvLoadFile(checked(CsvSettings, settings, where), clock)
