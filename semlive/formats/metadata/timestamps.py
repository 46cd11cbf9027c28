"""Dates and times in the formats of vendors: most without a zone, to the second, in different orders and languages."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from semlive.formats.metadata.month_names import months_named, repaired

ONE_SECOND_SIGMA_S = 1 / math.sqrt(12)
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_ORDERS = ("ymd", "dmy", "mdy")
_FIRST_PART = {"ymd": "year", "dmy": "day", "mdy": "month"}
_SAME_DAY_NS = 36 * 3600 * 10**9
"""Largest difference of a date and the modification time of its file in any two time zones."""
_TOKEN = re.compile(r"[0-9]+|[^\W0-9_]+(?:[?\ufffd][^\W0-9_]*)*\.?|[?\ufffd]+[^\W0-9_]+\.?")
_YEAR = re.compile(r"[0-9]{4}")
_BETWEEN = " \t./-,'\u2019\u200e\u200f\u00a0"
_PARTICLES = frozenset(("de", "del", "d", "di", "of", "the", "st", "nd", "rd", "th", "er", "a", "г", "年", "月", "日", "년", "월", "일"))
_CLOCK = re.compile(
    r"(?P<before>[^\W0-9_]{2}(?=\s*[0-9]))?\s*(?P<h>[0-9]{1,2})(?:[:.]|\s?[hH]\s?)(?P<m>[0-9]{2})(?:[:.]|\s?m(?:in)?\s?)(?P<s>[0-9]{2})\s?s?"
    r"(?:[.,](?P<f>[0-9]{1,9}))?\s*(?P<after>[^\W0-9_]{1,2}\.?\s?[^\W0-9_]?\.?)?"
)
_TIME_IN_DATE = re.compile(r"(?<=[0-9.])(?:T|,?\s+)(?=(?:[^\W0-9_]{2}\s*)?[0-9]{1,2}[:hH][0-9]{2})")
"""What separates date and time in one text: ``14/03/2022 11:52:46``."""
_NO_SECONDS = re.compile(r"(?:^|\s)(?:[^\W0-9_]{2}\s*)?[0-9]{1,2}[:.hH][0-9]{2}\s*(?:[^\W0-9_].{0,4})?$")
_HALVES = {0: frozenset(("am", "上午", "午前", "오전", "πμ", "de")), 12: frozenset(("pm", "下午", "午後", "오후", "μμ", "du"))}


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


@dataclass(frozen=True, slots=True)
class Acquired:
    """Date and time of a file as they were understood.

    Attributes:
        moment: the instant; None if the file contains none, or one that was not understood.
        unread: date and time as written, if they were not understood; empty otherwise.
        notes: how an order of day and month was chosen, one sentence.
    """

    moment: Moment | None = None
    unread: str = ""
    notes: tuple[str, ...] = ()


def acquired(date: str, clock: str, order: str, mtime_ns: int) -> Acquired:
    """Parse a date and a time of day of any order and language.

    Args:
        date: the date as written.
        clock: the time of day as written.
        order: usual order of the vendor, ``ymd``, ``dmy`` or ``mdy``; empty if both ``dmy`` and ``mdy`` are usual.
        mtime_ns: modification time of the file, UTC ns, which decides where the vendor's order does not.
    """
    date, clock, written = repaired(date), repaired(clock), " ".join(f"{date} {clock}".split())[:60]
    if not written:
        return Acquired()
    if not clock.strip():
        if (moment := iso(date)) is not None and _TIME_IN_DATE.search(date):
            return Acquired(moment)
        date, clock = [*_TIME_IN_DATE.split(date, 1), ""][:2]
    usual = _candidates(date, order, clock) if order else []
    found = list(dict.fromkeys([*usual, *(moment for other in _ORDERS for moment in _candidates(date, other, clock))]))
    if not found:
        return Acquired(unread=written)
    if len(found) == 1:
        return Acquired(found[0])
    nearest = min(found, key=lambda moment: abs(moment.time_ns - mtime_ns))
    if not _YEAR.search(date) and abs(nearest.time_ns - mtime_ns) > _SAME_DAY_NS:
        return Acquired(unread=written)  # 14.03.22 may begin or end with its year
    if len(usual) == 1 and (nearest == usual[0] or not _is_evident(nearest, usual[0], mtime_ns)):
        return Acquired(usual[0])
    first = next((_FIRST_PART[other] for other in _ORDERS if _candidates(date, other, clock) == [nearest]), "")
    how = f"has the {first} first" if first else f"was read as {nearest.text[:10]}"
    return Acquired(nearest, notes=(f"its date {' '.join(date.split())[:24]} {how}, by the file's modification time.",))


def _is_evident(moment: Moment, usual: Moment, mtime_ns: int) -> bool:
    """Whether the modification time is that of an instant and excludes the one in the usual order."""
    return abs(moment.time_ns - mtime_ns) < _SAME_DAY_NS and abs(usual.time_ns - mtime_ns) > 2 * _SAME_DAY_NS


def lacks_seconds(written: str) -> bool:
    """Whether date and time end in hours and minutes."""
    return _NO_SECONDS.search(written) is not None


def dated(date: str, order: str, clock: str) -> Moment | None:
    """Parse a date in a given order, ``ymd``, ``dmy`` or ``mdy``, with any separators and names of months; None if it does not fit.

    Names of months exclude the orders in which they cannot be the month.
    """
    moments = _candidates(date, order, clock)
    return moments[0] if len(moments) == 1 else None


def _candidates(date: str, order: str, clock: str) -> list[Moment]:
    """Return the possible instants of a date in one order: several if the name of the month differs between languages."""
    parts = _parts(date)
    time = _time_of_day(clock)
    if parts is None or time is None:
        return []
    by = dict(zip(order, parts, strict=True))
    if not (by["y"].isdigit() and len(by["y"]) in (2, 4) and by["d"].isdigit() and len(by["d"]) <= 2):
        return []
    year = int(by["y"]) + (2000 if len(by["y"]) == 2 else 0)
    months = (int(by["m"]),) if by["m"].isdigit() else months_named(by["m"])
    hour, minute, second, microsecond = time
    moments: list[Moment | None] = []
    for month in months:
        try:
            moment = datetime(year, month, int(by["d"]), hour, minute, second, microsecond or 0)
        except (ValueError, OverflowError):
            continue
        moments.append(_moment(moment, whole_seconds=microsecond is None))
    return [moment for moment in moments if moment is not None]


def _parts(date: str) -> tuple[str, str, str] | None:
    """Return the three parts of a date; a weekday before it and particles between its parts are left out."""
    tokens = [token.strip(".") for token in _TOKEN.findall(date)]
    tokens = [token for token in tokens if token and token.casefold() not in _PARTICLES]
    if len(tokens) == 4 and not tokens[0].isdigit():
        tokens = tokens[1:]
    if len(tokens) != 3 or _TOKEN.sub("", date).strip(_BETWEEN):
        return None
    first, second, third = tokens
    return first, second, third


def _time_of_day(clock: str) -> tuple[int, int, int, int | None] | None:
    """Return hour, minute, second and microsecond of ``9:40:32``, ``02:09:15 PM``, ``17:19:26.5``, ``9.40.32`` or ``9h40m32s``.

    The microsecond is None if the time has whole seconds.
    """
    match = _CLOCK.fullmatch(clock.strip())
    if match is None:
        return None
    hour, minute, second = int(match["h"]), int(match["m"]), int(match["s"])
    half = next((half for name in ("before", "after") if match[name] for half in _HALVES if _half_name(match[name]) in _HALVES[half]), None)
    if match["before"] or match["after"]:
        if half is None or not 1 <= hour <= 12:
            return None
        hour = hour % 12 + half
    microsecond = None if match["f"] is None else round(float(f"0.{match['f']}") * 1e6) % 10**6
    return hour, minute, second, microsecond


def _half_name(text: str) -> str:
    return re.sub(r"[.\s\u202f\u00a0]", "", text).casefold()


def _moment(instant: datetime, whole_seconds: bool) -> Moment | None:
    zoned = instant.tzinfo is not None
    aware = instant.astimezone(UTC) if zoned else instant.replace(tzinfo=UTC)
    if not 1980 <= aware.year < 2200:
        return None
    time_ns = (aware - _EPOCH) // timedelta(microseconds=1) * 1000 + (500_000_000 if whole_seconds else 0)
    return Moment(time_ns, ONE_SECOND_SIGMA_S if whole_seconds else 0.0, zoned)
