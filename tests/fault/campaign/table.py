"""A row of the campaign."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from lab import Lab


class Kind(StrEnum):
    """How a fault is produced."""

    REAL = "real"
    """The fault itself, in processes, files, sockets or serial lines of this system."""
    EMULATED = "emulated"
    """A program simulates the device, cable or clock with the fault; the daemon and its sockets are real."""
    WINDOWS = "needs Windows"


@dataclass(frozen=True)
class Observation:
    """Result of a row.

    Attributes:
        what: description of the reaction.
        stop_ms: time from the fault (or the first reading beyond a limit) to the end of motion, ms; None without a motion.
    """

    what: str
    stop_ms: float | None = None


@dataclass(frozen=True)
class Row:
    """A fault of the list.

    Attributes:
        number: number in the list.
        fault: the injected fault.
        must: the required reaction.
        kind: how the fault is produced.
        run: injects the fault, and raises AssertionError for another reaction.
        short: whether CI runs it.
    """

    number: int
    fault: str
    must: str
    kind: Kind
    run: Callable[[Lab], Observation]
    short: bool = False
