"""Serial lines with several owners: a load frame's thread and a stage's, each with units of its own on one pair of wires.

Whoever opens a line that this process holds already gets a share of it. One exchange is under way at a time; an order goes ahead of
readings that wait, so a stop waits for at most one answer, whoever's it is.
"""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

from semlive.errors import BadConfig
from semlive_drivers.modbus.codec import Block
from semlive_drivers.modbus.rtu.line import READS, NoReply, RtuLine
from semlive_drivers.serial_port import LineLost, SerialSettings

_SAME = ("baud", "parity", "stop_bits", "echo")


class PriorityLock:
    """Who is next: first come, first served, and urgent ones ahead of the others."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._waiting: tuple[deque[object], deque[object]] = deque(), deque()
        self._taken = False

    @contextmanager
    def taken(self, urgent: bool) -> Iterator[None]:
        """Wait for a turn, and have it."""
        ticket, queue = object(), self._waiting[not urgent]
        with self._changed:
            queue.append(ticket)
            self._changed.wait_for(lambda: not self._taken and ticket is next(one for row in self._waiting for one in row))
            queue.popleft()
            self._taken = True
        try:
            yield
        finally:
            with self._changed:
                self._taken = False
                self._changed.notify_all()


@dataclass(slots=True)
class _Shared:
    """A path, and the line that is open there."""

    door: threading.Lock = field(default_factory=threading.Lock)
    turns: PriorityLock = field(default_factory=PriorityLock)
    line: RtuLine | None = None
    owners: int = 0

    def leave(self, line: RtuLine, *, gone: bool = False) -> None:
        """One owner less; the last one, or whoever finds the line gone, closes it for all."""
        with self.door:
            if self.line is not line:
                return
            self.owners = 0 if gone else self.owners - 1
            if self.owners <= 0:
                self.line, self.owners = None, 0
                line.close()


_LINES: dict[str, _Shared] = {}
_DOOR = threading.Lock()


class LineClient:
    """One owner's part in a line: what `RtuLine` offers, when it is its turn.

    Args:
        shared: the path's.
        line: open.
        timeout_s: longest wait for the first byte of an answer of this owner's units.
        fresh: it was opened for this owner, so all that it owed has been said.
    """

    def __init__(self, shared: _Shared, line: RtuLine, timeout_s: float, fresh: bool) -> None:
        self._shared, self._line, self._timeout_s, self._fresh = shared, line, timeout_s, fresh
        self._left = False
        self.where = line.where

    def transact(self, unit: int, pdu: bytes, doing: str) -> bytes:
        """The answer to a request, as `RtuLine.transact`."""
        with self._turn(urgent=pdu[0] > READS) as line:
            return line.transact(unit, pdu, doing)

    def has_pending_reply(self, unit: int) -> bool:
        """Whether an answer of a unit may still come."""
        return self._line.has_pending_reply(unit)

    def drain(self, unit: int, probes: Sequence[Block], patient: bool = True, wait_s: float | None = None) -> None:
        """Make sure that no earlier answer of a unit can come any more, as `RtuLine.drain`; others have their turn between probes."""
        end_s = time.monotonic() + (self._line.reply_timeout_s if patient else 0.0)
        while True:
            try:
                with self._turn(urgent=False) as line:
                    line.drain(unit, probes, patient=False, wait_s=wait_s)
                return
            except NoReply:
                if time.monotonic() >= end_s:
                    raise

    def broadcast(self, unit: int, pdus: Sequence[bytes]) -> None:
        """Write requests without waiting for an answer, as `RtuLine.broadcast`."""
        with self._turn(urgent=True) as line:
            line.broadcast(unit, pdus)

    def send_urgent(self, unit: int) -> None:
        """Say what a unit was told and never confirmed, if opening the line has not done so."""
        if self._fresh:
            return
        with self._turn(urgent=True) as line:
            line.send_urgent(unit)

    def close(self) -> None:
        """Leave the line; the last one closes it. Never raises."""
        if not self._left:
            self._left = True
            self._shared.leave(self._line)

    @contextmanager
    def _turn(self, urgent: bool) -> Iterator[RtuLine]:
        with self._shared.turns.taken(urgent):
            self._line.timeout_s = self._timeout_s
            try:
                yield self._line
            except LineLost:
                self._shared.leave(self._line, gone=True)
                raise


def open_shared_line(settings: SerialSettings, timeout_s: float, who: str) -> LineClient:
    """A share of the line at a path, opened if nobody has it open.

    Args:
        settings: of the line; whoever shares it must say the same speed and parity.
        timeout_s: longest wait for an answer.
        who: is spoken to.

    Raises:
        BadConfig: if it is open with other settings.
        LinkRefused: if it cannot be opened.
    """
    with _DOOR:
        shared = _LINES.setdefault(_place(settings.port), _Shared())
    with shared.door:
        fresh = shared.line is None
        if shared.line is None:
            shared.line = RtuLine(settings, timeout_s, who)
        else:
            _agree(shared.line.settings, settings)
            shared.line.allow_for(settings)
        shared.owners += 1
        return LineClient(shared, shared.line, timeout_s, fresh)


def is_shared(port: str) -> bool:
    """Whether this process has a line of Modbus open at a path."""
    with _DOOR:
        shared = _LINES.get(_place(port))
    return shared is not None and shared.line is not None


def _place(port: str) -> str:
    """One name for one line: links such as /dev/serial/by-id are followed."""
    return os.path.realpath(port) if os.sep in port else port.upper()


def _agree(here: SerialSettings, wanted: SerialSettings) -> None:
    for name in _SAME:
        if getattr(here, name) != getattr(wanted, name):
            raise BadConfig(
                f"{wanted.port} is shared by devices that differ: {name} is {getattr(here, name)} for one and {getattr(wanted, name)} "
                "for another; say the same baud, parity and stop_bits in serial of each"
            )
