"""What the device recorded: its log, its true force over time, its stop orders, and figures drawn from them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

_LINE = re.compile(r"^(?P<at>[\d.]+) F=(?P<force>\S+) E=(?P<extension>\S+) mv=(?P<moving>\d) (?P<what>.*)$")
_RAMP = re.compile(r"^RAMP(?:16)? to (?P<target>\S+) at (?P<rate>\S+)")
_MOVE = re.compile(r"^MOVE dir=(?P<direction>-?\d) travel=(?P<travel>\S+) speed=(?P<speed>\S+)")


@dataclass(frozen=True, slots=True)
class Entry:
    """A line of the device's log.

    Attributes:
        at_s: CLOCK_MONOTONIC, s.
        force_n: true force.
        extension_mm: true extension.
        moving: whether it moves.
        what: what happened.
    """

    at_s: float
    force_n: float
    extension_mm: float
    moving: bool
    what: str

    @property
    def is_stop_request(self) -> bool:
        """A stop order arrived on the wire, whatever the device made of it."""
        return "<STOP>" in self.what


@dataclass(frozen=True, slots=True)
class Reading:
    """The true state of the device at an instant: CLOCK_MONOTONIC in s, N, mm."""

    at_s: float
    force_n: float
    extension_mm: float
    moving: bool


def read_log(path: Path) -> list[Entry]:
    """Every complete line of the log of a device."""
    text = path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""
    found = [match for line in text.splitlines() if (match := _LINE.match(line))]
    return [
        Entry(float(item["at"]), float(item["force"]), float(item["extension"]), item["moving"] != "0", item["what"].strip())
        for item in found
    ]


def merged(entries: list[Entry], sampled: list[Reading]) -> list[Reading]:
    """The true state over time, from both sources, in order."""
    from_log = [Reading(item.at_s, item.force_n, item.extension_mm, item.moving) for item in entries]
    return sorted([*from_log, *sampled], key=lambda item: item.at_s)


@dataclass(frozen=True, slots=True)
class Unloading:
    """An order that would take load off: when, and from which true force to which, in N."""

    at_s: float
    from_n: float
    to_n: float


def unloadings(entries: list[Entry], stiffness_n_mm: float, tolerance_n: float) -> list[Unloading]:
    """Orders to a load that is lower than the true load by more than a tolerance."""
    found = []
    for item in entries:
        to_n = item.force_n
        if ramp := _RAMP.match(item.what):
            to_n = float(ramp["target"])
        elif (move := _MOVE.match(item.what)) and move["direction"] not in ("0", "1"):
            to_n = item.force_n - float(move["travel"]) * stiffness_n_mm
        if to_n < item.force_n - tolerance_n:
            found.append(Unloading(item.at_s, item.force_n, to_n))
    return found


def without_foreign(entries: list[Entry], foreign: list[tuple[float, int]]) -> list[Entry]:
    """The log without what another master ordered: instants, and 1 for a ramp, 2 for a stop."""
    retained = list(entries)
    for at_s, command in foreign:
        found = (item for item in retained if item.at_s >= at_s and (item.is_stop_request if command == 2 else _RAMP.match(item.what)))
        if (own := next(found, None)) is not None:
            retained.remove(own)
    return retained


def motion_orders(entries: list[Entry], since_s: float) -> list[Entry]:
    """Orders to move that the device took after an instant."""
    return [item for item in entries if item.at_s > since_s and (_RAMP.match(item.what) or _MOVE.match(item.what))]


def stop_requests(entries: list[Entry], since_s: float, until_s: float) -> list[float]:
    """Instants of the stop orders on the wire."""
    return [item.at_s for item in entries if item.is_stop_request and since_s <= item.at_s <= until_s]


def peak(readings: list[Reading], until_s: float = float("inf")) -> float:
    """Largest true force, N."""
    return max((item.force_n for item in readings if item.at_s <= until_s), default=0.0)


def when_force_passes(readings: list[Reading], force_n: float, since_s: float = 0.0) -> float | None:
    """When the true force was first at or above a value after an instant; None if it never was."""
    return next((item.at_s for item in readings if item.at_s >= since_s and item.force_n >= force_n), None)


def longest_silence(readings: list[Reading], stops_s: list[float], until_s: float, ordered_s: Sequence[float] = ()) -> float:
    """Longest time in which the device moved after a stop order and received no further stop order, s.

    Args:
        readings: the true state over time, in order.
        stops_s: instants of the stop orders, in order.
        until_s: end of the observation.
        ordered_s: instants of the motion orders, in order. A motion order ends the pursuit of the stop orders before it: the motion that
            it starts is obedience. The device records a motion order in the state after it, so a reading of that instant belongs to the
            new motion.

    Returns:
        The longest such time over all pursuits; 0 without a stop order, or where the device rested at once.
    """
    edges = [float("-inf"), *(at_s for at_s in ordered_s if at_s <= until_s), float("inf")]
    return max(
        (_silence(readings, [item for item in stops_s if a <= item < b], min(until_s, b), b) for a, b in pairwise(edges)), default=0.0
    )


def _silence(readings: list[Reading], stops_s: list[float], until_s: float, ordered_s: float) -> float:
    """The longest silence of the pursuit that `stops_s` began, until an instant and before the next motion order."""
    if not stops_s:
        return 0.0
    moving = [item.at_s for item in readings if stops_s[0] <= item.at_s <= until_s and item.at_s < ordered_s and item.moving]
    marks = [*stops_s, until_s]
    return max((max((at_s for at_s in moving if a <= at_s <= b), default=a) - a for a, b in pairwise(marks)), default=0.0)
