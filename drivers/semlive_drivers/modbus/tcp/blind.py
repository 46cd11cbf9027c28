"""Stops over Modbus TCP that are written without waiting for an answer, for a device whose answers are late, corrupted or missing.

A stop is written on the connection that failed and on a new one, because either may still reach the device: one device that serves a
single client drops the older connection, another refuses the newer one. A stop without an answer is pending: the next connection to the
same unit sends it before anything is read, because opening that connection may have displaced the one that carried the stop.
"""

from __future__ import annotations

import itertools
import select
import socket
import struct
import threading
import time
import weakref
from collections.abc import Sequence

CONNECT_S = 0.3
"""Longest wait for a new connection."""
_MAX_REPLY_S = 1.0
"""A connection on which a stop was not answered within this time is closed, and the next stop opens another."""
_LINGER_S = 0.05
"""Wait for an answer after everything is written, so that an answered connection is closed before another is opened."""
_FIRST_TRANSACTION = 0xB000
_OLD, _NEW = "old", "new"

_Address = tuple[str, int] | tuple[str, int, int, int]
Unit = tuple[str, int, int]
"""Host, port and unit."""

_MAX_AGE_S = 60.0
"""A stop that was written longer ago is not pending any more."""

_pending: dict[Unit, dict[bytes, tuple[float, tuple[bytes, ...]]]] = {}
"""Pending stops by unit, and by head (function and address) of their first request: monotonic time of writing, s, and PDUs."""
_lock = threading.Lock()


def add_pending_stop(unit: Unit, pdus: Sequence[bytes]) -> None:
    """Store a stop that was written without an answer."""
    with _lock:
        _pending.setdefault(unit, {})[pdus[0][:3]] = time.monotonic(), tuple(pdus)


def pending_stops(unit: Unit) -> tuple[bytes, ...]:
    """The requests of all pending stops of a unit."""
    since_s = time.monotonic() - _MAX_AGE_S
    with _lock:
        return tuple(pdu for written_s, pdus in _pending.get(unit, {}).values() if written_s > since_s for pdu in pdus)


def clear_pending_stops(unit: Unit) -> None:
    """Remove the pending stops of a unit that answered."""
    with _lock:
        _pending.pop(unit, None)


def framed(transaction: int, unit: int, pdu: bytes) -> bytes:
    """A request with its header on TCP (MBAP)."""
    return struct.pack(">HHHB", transaction & 0xFFFF, 0, len(pdu) + 1, unit) + pdu


def exchange(sock: socket.socket, unit: int, pdus: Sequence[bytes], timeout_s: float) -> bool:
    """Write requests on a connection and wait until each was answered, by a confirmation or an exception.

    Returns:
        True if every answer came within the time; otherwise the connection must not be used any more.
    """
    waiting, received, end_s = {_FIRST_TRANSACTION + index for index in range(len(pdus))}, b"", time.monotonic() + timeout_s
    try:
        for index, pdu in enumerate(pdus):
            sock.sendall(framed(_FIRST_TRANSACTION + index, unit, pdu))
        while waiting:
            if not select.select([sock], [], [], max(0.0, end_s - time.monotonic()))[0]:
                return False
            data = sock.recv(4096)
            if not data:
                return False
            received += data
            while len(received) >= 6 and len(received) >= (length := 6 + int.from_bytes(received[4:6])):
                waiting.discard(int.from_bytes(received[:2]))
                received = received[length:]
    except OSError:
        return False
    return not received


class _Connection:
    """One connection to which requests are written without waiting for an answer."""

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock
        self._since_s: float | None = None
        self._answered = False
        sock.setblocking(False)

    def send(self, data: bytes) -> bool:
        try:
            complete = self._sock.send(data) == len(data)
        except OSError:
            return False
        self._answered = False
        self._since_s = self._since_s or time.monotonic()
        return complete

    def listen(self, wait_s: float) -> None:
        """Discard data received since the last request; any data count as an answer."""
        if self._since_s is None:
            return
        try:
            while select.select([self._sock], [], [], wait_s)[0]:
                self._answered = True
                if not self._sock.recv(4096):
                    return
                wait_s = 0.0
        except OSError:
            self._answered = True

    @property
    def is_finished(self) -> bool:
        """Whether the connection can be closed: it was answered, it ended, or the time for an answer has passed."""
        return self._answered or (self._since_s is not None and time.monotonic() - self._since_s > _MAX_REPLY_S)

    def close(self) -> None:
        self._sock.close()


class BlindWriter:
    """Writes requests to a unit on an existing connection and on new ones, without waiting for an answer. Never raises.

    Args:
        sock: a connection to the unit, or a duplicate of one; closed with the writer.
        address: remote address of the connection.
        unit: Modbus unit.
    """

    def __init__(self, sock: socket.socket, address: _Address, unit: int) -> None:
        self._family, self._address, self._unit = sock.family, address, unit
        self._transactions = itertools.count(_FIRST_TRANSACTION)
        self._connections = {_OLD: _Connection(sock)}
        # A connection that `write` opened after `close` is closed when the writer is deleted, at the latest.
        weakref.finalize(self, _close_all, self._connections)

    def write(self, pdus: Sequence[bytes]) -> bool:
        """Write on both connections; takes at most `CONNECT_S` and a few hundredths of a second.

        Returns:
            Whether anything was written.
        """
        self._close_finished()
        written = _OLD in self._connections and self._send(self._connections[_OLD], pdus)
        if _NEW not in self._connections and (connection := self._connect()) is not None:
            self._connections[_NEW] = connection
        if _NEW in self._connections:
            written |= self._send(self._connections[_NEW], pdus)
        end_s = time.monotonic() + _LINGER_S
        for name in (_NEW, _OLD):
            if name in self._connections:
                self._connections[name].listen(max(0.0, end_s - time.monotonic()))
        self._close_finished()
        return written

    def close(self) -> None:
        """Close both connections; `write` opens a new one again."""
        _close_all(self._connections)

    def _send(self, connection: _Connection, pdus: Sequence[bytes]) -> bool:
        # Each request is sent in its own segment: simple devices read only one request per segment.
        return any([connection.send(framed(next(self._transactions), self._unit, pdu)) for pdu in pdus])

    def _connect(self) -> _Connection | None:
        sock = socket.socket(self._family, socket.SOCK_STREAM)
        try:
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            sock.settimeout(CONNECT_S)
            sock.connect(self._address)
        except OSError:
            sock.close()
            return None
        return _Connection(sock)

    def _close_finished(self) -> None:
        """Close connections that are not needed any more."""
        for name, connection in tuple(self._connections.items()):
            connection.listen(0.0)
            if connection.is_finished:
                connection.close()
                del self._connections[name]


def _close_all(connections: dict[str, _Connection]) -> None:
    for connection in connections.values():
        connection.listen(0.0)
        connection.close()
    connections.clear()
