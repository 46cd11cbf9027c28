"""A file that another program writes line by line: load, extension or strain from its newest whole line."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, model_validator

from semlive.errors import LinkError, LinkRefused
from semlive.ports import ClockSource
from semlive_drivers.modbus.settings import checked
from semlive_drivers.parts import Do, Said
from semlive_drivers.units import factor

_TAIL_BYTES = 65_536


class Column(BaseModel):
    """Where a number stands in a line."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    column: int | str
    """Number from 1, or the name in the file's head."""
    unit: str = "1"
    scale: float = 1.0
    """-1 turns the sign."""


class CsvSettings(BaseModel):
    """Settings of a file that grows."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    file: Path
    """A name may hold ``*`` and ``?``: then the file that was written last is read."""
    delimiter: str = Field(default="", max_length=4)
    """Nothing finds out: tab, semicolon, comma, or blanks."""
    decimal_comma: bool = False
    encoding: str = "utf-8"
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


class CsvTail:
    """The Part over a growing file; it tells and cannot be told.

    Raises:
        LinkRefused: if there is no such file.
    """

    simulated = False
    stops_by_itself = False
    can: frozenset[Do] = frozenset()

    def __init__(self, settings: CsvSettings, clock: ClockSource) -> None:
        self._settings, self._clock = settings, clock
        self.where = str(settings.file)
        self._path = self._newest()
        self._seen: tuple[Path, int] | None = None
        self._grew_mono_ns = clock.mono_ns()
        self._names = self._head()

    def read(self) -> Said:
        """The newest whole line.

        Raises:
            LinkError: if the file is gone, does not grow, or its line holds no number where one must be.
        """
        now = self._clock.mono_ns()
        try:
            path = self._newest()
            size = path.stat().st_size
            with path.open("rb") as stream:
                stream.seek(max(0, size - _TAIL_BYTES))
                data = stream.read(_TAIL_BYTES)
        except OSError as error:
            raise LinkError(f"{self.where} cannot be read ({error.strerror}); check the program that writes it") from error
        end = data.rfind(b"\n") + 1
        seen = (path, size - len(data) + end)
        if path != self._path:
            self._path = path
            self._names = self._head()
        if seen != self._seen:
            self._seen, self._grew_mono_ns = seen, now
        elif now - self._grew_mono_ns > self._settings.frozen_after_s * 1e9:
            still_s = (now - self._grew_mono_ns) / 1e9
            raise LinkError(f"{path} has not grown for {still_s:.1f} s; check that the program that writes it is recording")
        lines = data[:end].splitlines()
        if not lines:
            raise LinkError(f"{path} holds no whole line yet; start the recording")
        return self._said(lines[-1].decode(self._settings.encoding, errors="replace"))

    def look(self) -> Said:
        """The same: reading writes nothing."""
        return self.read()

    def tell(self, what: Do, values: Mapping[str, float]) -> None:
        """Nothing can be told to a file.

        Raises:
            LinkError: always.
        """
        del values
        raise LinkError(f"{self.where} is a file and cannot be told to {what}")

    def shout_stop(self) -> None:
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

    def _head(self) -> dict[str, int]:
        """Numbers of columns by their names in the first line."""
        with self._path.open(encoding=self._settings.encoding, errors="replace") as stream:
            return {name.strip().strip('"'): place for place, name in enumerate(self._split(stream.readline().strip()), 1)}

    def _split(self, line: str) -> list[str]:
        delimiter = self._settings.delimiter or next((d for d in "\t;" if d in line), "" if self._settings.decimal_comma else ",")
        return line.split(delimiter) if delimiter and delimiter in line else line.split()

    def _said(self, line: str) -> Said:
        fields = self._split(line)
        s = self._settings
        return Said(force_n=self._number(s.force, fields), extension_mm=self._number(s.extension, fields), gage_strain=self._strain(fields))

    def _strain(self, fields: list[str]) -> float | None:
        """A gage may say nothing for a while; its load goes on."""
        try:
            return self._number(self._settings.gage, fields)
        except LinkError:
            return None

    def _number(self, column: Column | None, fields: list[str]) -> float | None:
        if column is None:
            return None
        place = self._names.get(column.column) if isinstance(column.column, str) else column.column
        text = fields[place - 1].strip().strip('"') if place is not None and 0 < place <= len(fields) else ""
        try:
            number = float(text.replace(",", ".") if self._settings.decimal_comma else text)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise LinkError(f"{self._path} holds {text!r} in column {column.column}, which is no reading; check columns and delimiter")
        return number * column.scale * factor(column.unit, "csv column")


def open_part(settings: Mapping[str, object], clock: ClockSource, where: str = "csv") -> CsvTail:
    """Open a file that grows.

    Raises:
        BadConfig: for settings that are not understood.
        LinkRefused: if there is no such file.
    """
    return CsvTail(checked(CsvSettings, settings, where), clock)
