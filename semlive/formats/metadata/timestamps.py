"""Dates and times as vendors print them: most without a zone, to the second, and in more than one order of day and month."""

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
    """An instant that a file names.

    Attributes:
        time_ns: UTC ns; where no zone is named, as if the microscope's computer ran on UTC. A time printed in whole seconds was
            cut, not rounded: it stands for its middle.
        sigma_s: standard uncertainty of the printing alone, 1 s / sqrt(12) for whole seconds.
        zoned: the file names a zone, so no offset of a time zone is left in it.
    """

    time_ns: int
    sigma_s: float
    zoned: bool = False

    @property
    def text(self) -> str:
        """ISO 8601, with a zone if the file names one, to the second if that is all it prints."""
        whole = self.sigma_s > 0
        instant = _EPOCH + timedelta(microseconds=(self.time_ns - (500_000_000 if whole else 0)) // 1000)
        return (instant if self.zoned else instant.replace(tzinfo=None)).isoformat()


def iso(text: str) -> Moment | None:
    """``2023-11-10T14:09:15.123456+01:00``, zone and fraction optional."""
    try:
        return _moment(datetime.fromisoformat(text.strip()), whole_seconds="." not in text)
    except (ValueError, OverflowError):
        return None


def of(year: str, month: str, day: str, clock: str) -> Moment | None:
    """A date in parts, and a time of day: ``9:40:32``, ``02:09:15 PM``, ``17:19:26.5``."""
    found = re.fullmatch(r"\s*(\d{1,2}):(\d{2}):(\d{2})(\.\d{1,9})?\s*([AaPp][Mm])?\s*", clock, re.ASCII)
    if found is None:
        return None
    hour, minute, second = (int(part) for part in found.groups()[:3])
    if found[5]:
        if not 1 <= hour <= 12:
            return None
        hour = hour % 12 + (12 if found[5].lower() == "pm" else 0)
    try:
        instant = datetime(int(year), _month(month), int(day), hour, minute, second, round(float(found[4] or 0) * 1e6) % 10**6)
        return _moment(instant, whole_seconds=not found[4])
    except (ValueError, OverflowError):
        return None


def dated(date: str, order: str, clock: str) -> Moment | None:
    """A date of three parts in a known order, ``ymd``, ``dmy`` or ``mdy``, whatever stands between them; months may be English words."""
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
