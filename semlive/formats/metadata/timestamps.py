"""Dates and times in the formats of vendors: most without a zone, to the second, with different orders of day and month."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

ONE_SECOND_SIGMA_S = 1 / math.sqrt(12)
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")


@dataclass(frozen=True, slots=True)
class Moment:
    """An instant in the metadata of a file.

    Attributes:
        time_ns: UTC ns; without a zone, as if the computer of the microscope ran on UTC. A time printed in seconds was truncated, not
            rounded, so half a second is added.
        sigma_s: standard uncertainty from the printed resolution alone, 1 s / sqrt(12) for seconds.
        zoned: the file contains a zone, so the value has no offset of a time zone.
    """

    time_ns: int
    sigma_s: float
    zoned: bool = False

    @property
    def text(self) -> str:
        """The time as ISO 8601, with a zone if the file contains one, to the printed resolution."""
        in_seconds = self.sigma_s > 0
        instant = _EPOCH + timedelta(microseconds=(self.time_ns - (500_000_000 if in_seconds else 0)) // 1000)
        return (instant if self.zoned else instant.replace(tzinfo=None)).isoformat()


def iso(text: str) -> Moment | None:
    """Parse ``2023-11-10T14:09:15.123456+01:00``, zone and fraction optional."""
    try:
        return _moment(datetime.fromisoformat(text.strip()), whole_seconds="." not in text)
    except (ValueError, OverflowError):
        return None


def of(year: str, month: str, day: str, clock: str) -> Moment | None:
    """Parse a date in parts, and a time of day: ``9:40:32``, ``02:09:15 PM``, ``17:19:26.5``."""
    match = re.fullmatch(r"\s*(\d{1,2}):(\d{2}):(\d{2})(\.\d{1,9})?\s*([AaPp][Mm])?\s*", clock, re.ASCII)
    if match is None:
        return None
    hour, minute, second = (int(part) for part in match.groups()[:3])
    if match[5]:
        if not 1 <= hour <= 12:
            return None
        hour = hour % 12 + (12 if match[5].lower() == "pm" else 0)
    try:
        instant = datetime(int(year), _month(month), int(day), hour, minute, second, round(float(match[4] or 0) * 1e6) % 10**6)
        return _moment(instant, whole_seconds=not match[4])
    except (ValueError, OverflowError):
        return None


def dated(date: str, order: str, clock: str) -> Moment | None:
    """Parse a date of three parts in a given order, ``ymd``, ``dmy`` or ``mdy``, with any separators; months may be English names."""
    parts = re.fullmatch(r"\s*(\d{1,4})[\s./-]+(\w{1,9})[\s./-]+(\d{1,4})\s*", date, re.ASCII)
    if parts is None:
        return None
    by = dict(zip(order, parts.groups(), strict=True))
    return of(by["y"], by["m"], by["d"], clock)


def _month(text: str) -> int:
    return int(text) if text.isdigit() else _MONTHS.index(text[:3].lower()) + 1


def _moment(instant: datetime, whole_seconds: bool) -> Moment | None:
    zoned = instant.tzinfo is not None
    aware = instant.astimezone(UTC) if zoned else instant.replace(tzinfo=UTC)
    if not 1980 <= aware.year < 2200:
        return None
    time_ns = (aware - _EPOCH) // timedelta(microseconds=1) * 1000 + (500_000_000 if whole_seconds else 0)
    return Moment(time_ns, ONE_SECOND_SIGMA_S if whole_seconds else 0.0, zoned)
