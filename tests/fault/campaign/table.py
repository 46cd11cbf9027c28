"""What a row of the campaign is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from lab import Lab


class Kind(StrEnum):
    """How near to life a fault was."""

    REAL = "real"
    """The very thing happened: to processes, files, sockets, serial lines of this system."""
    EMULATED = "emulated"
    """A program played the device, the cable or the clock that failed; the daemon and its sockets were real."""
    WINDOWS = "needs Windows"


@dataclass(frozen=True)
class Seen:
    """What happened.

    Attributes:
        what: in words.
        stop_ms: from the fault (or the reading that violates) to the end of motion; None where nothing moved.
    """

    what: str
    stop_ms: float | None = None


@dataclass(frozen=True)
class Row:
    """A fault of the list.

    Attributes:
        number: in the list.
        fault: what is injected.
        must: what must happen.
        kind: how near to life it is.
        run: injects it, and raises AssertionError where something else happens.
        short: whether CI runs it.
    """

    number: int
    fault: str
    must: str
    kind: Kind
    run: Callable[[Lab], Seen]
    short: bool = False
