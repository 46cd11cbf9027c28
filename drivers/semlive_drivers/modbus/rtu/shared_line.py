"""Serial lines with several clients: the threads of load frame and stage, each with units of its own on one pair of wires.

A line that this process opened already is shared. One exchange is under way at a time. Orders have priority over waiting readings, so a
stop waits for at most one answer.
"""

from __future__ import annotations

import itertools
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

_SHARED_SETTINGS = ("baud", "parity", "stop_bits", "echo")


class PriorityLock:
    """A lock in the order of the requests, with urgent requests before the others."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._waiting: tuple[deque[object], deque[object]] = deque(), deque()
        self._locked = False

    @contextmanager
    def acquired(self, urgent: bool) -> Iterator[None]:
        """Wait for the lock and hold it."""
        ticket, queue = object(), self._waiting[not urgent]
        with self._changed:
            queue.append(ticket)
            self._changed.wait_for(lambda: not self._locked and ticket is next(itertools.chain(*self._waiting)))
            queue.popleft()
            self._locked = True
        try:
            yield
        finally:
            with self._changed:
                self._locked = False
                self._changed.notify_all()


@dataclass(slots=True)
class _Shared:
    """A path, and the line that is open there."""

    guard: threading.Lock = field(default_factory=threading.Lock)
    turns: PriorityLock = field(default_factory=PriorityLock)
    line: RtuLine | None = None
    clients: int = 0

    def leave(self, line: RtuLine, *, gone: bool = False) -> None:
        """Remove a client. The line is closed by the last client, or by one that finds the line lost."""
        with self.guard:
            if self.line is not line:
                return
            self.clients = 0 if gone else self.clients - 1
            if self.clients <= 0:
                self.line, self.clients = None, 0
                line.close()


_LINES: dict[str, _Shared] = {}
_LINES_GUARD = threading.Lock()


class LineClient:
    """One client of a shared line, with the methods of `RtuLine`; each waits for its turn.

    Args:
        shared: path and line.
        line: open.
        timeout_s: longest wait for the first byte of an answer of the client's units, s.
        fresh: whether the line was opened for this client, so that its pending stops have been sent.
    """

    def __init__(self, shared: _Shared, line: RtuLine, timeout_s: float, fresh: bool) -> None:
        self._shared, self._line, self._timeout_s, self._fresh = shared, line, timeout_s, fresh
        self._closed = False
        self.where = line.where

    def transact(self, unit: int, pdu: bytes, action: str) -> bytes:
        """The answer to a request, as `RtuLine.transact`."""
        with self._turn(urgent=pdu[0] > READS) as line:
            return line.transact(unit, pdu, action)

    def has_pending_reply(self, unit: int) -> bool:
        """Whether an answer of a unit is pending."""
        return self._line.has_pending_reply(unit)

    def drain(self, unit: int, probes: Sequence[Block], patient: bool = True, wait_s: float | None = None) -> None:
        """Probe until no earlier answer of a unit is possible, as `RtuLine.drain`; other clients have their turn between probes."""
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
        """Write the pending stops of a unit, if opening the line has not done so."""
        if self._fresh:
            return
        with self._turn(urgent=True) as line:
            line.send_urgent(unit)

    def close(self) -> None:
        """Leave the line; the last client closes it. Never raises."""
        if not self._closed:
            self._closed = True
            self._shared.leave(self._line)

    @contextmanager
    def _turn(self, urgent: bool) -> Iterator[RtuLine]:
        with self._shared.turns.acquired(urgent):
            self._line.timeout_s = self._timeout_s
            try:
                yield self._line
            except LineLost:
                self._shared.leave(self._line, gone=True)
                raise


def open_shared_line(settings: SerialSettings, timeout_s: float, device: str) -> LineClient:
    """A client of the line at a path; the line is opened if it is not open.

    Args:
        settings: settings of the line; all clients must have the same speed and parity.
        timeout_s: longest wait for an answer, s.
        device: name of the device on the line.

    Raises:
        BadConfig: if it is open with other settings.
        LinkRefused: if it cannot be opened.
    """
    with _LINES_GUARD:
        shared = _LINES.setdefault(_path(settings.port), _Shared())
    with shared.guard:
        fresh = shared.line is None
        if shared.line is None:
            shared.line = RtuLine(settings, timeout_s, device)
        else:
            _require_equal(shared.line.settings, settings)
            shared.line.allow_for(settings)
        shared.clients += 1
        return LineClient(shared, shared.line, timeout_s, fresh)


def is_shared(port: str) -> bool:
    """Whether this process has opened a Modbus line at a path."""
    with _LINES_GUARD:
        shared = _LINES.get(_path(port))
    return shared is not None and shared.line is not None


def _path(port: str) -> str:
    """The name of a line; symbolic links such as /dev/serial/by-id are resolved."""
    return os.path.realpath(port) if os.sep in port else port.upper()


def _require_equal(current: SerialSettings, settings: SerialSettings) -> None:
    for name in _SHARED_SETTINGS:
        first, second = getattr(current, name), getattr(settings, name)
        if first != second:
            raise BadConfig(
                f"{settings.port} is shared by devices that differ: {name} is {first} for one and {second} for another; "
                "set the same baud, parity and stop_bits in serial of each"
            )
