"""Orders over Modbus TCP that wait for no answer: a stop for a device whose answers come late, garbled or not at all.

A stop is written on the connection that failed and on a fresh one, because either may be the one that still reaches the device: a device
that serves one client at a time drops the older one, another refuses the newer one. What was written so and not answered yet is owed: the
next connection to the same unit begins with it, before anything is read, because opening that connection may have displaced the one that
carried the stop.
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
"""Longest wait for a fresh connection."""
_PATIENCE_S = 1.0
"""A connection on which a stop was not answered for so long is given up, and the next stop opens another."""
_LINGER_S = 0.05
"""Wait for an answer after everything is written, so that a connection that has served is closed before another is opened."""
_FIRST_NUMBER = 0xB000
_OLD, _FRESH = "old", "fresh"

_Address = tuple[str, int] | tuple[str, int, int, int]
Unit = tuple[str, int, int]
"""Host, port and unit."""

_REMEMBERED_S = 60.0
"""A stop that was written longer ago is not owed any more: another one was written since, or nobody waits for it."""

_owed: dict[Unit, dict[bytes, tuple[float, tuple[bytes, ...]]]] = {}
"""Stops without an answer: by unit, and there by head (function and address) of their first request; when, and as PDUs."""
_lock = threading.Lock()


def owe(unit: Unit, pdus: Sequence[bytes]) -> None:
    """Remember a stop that was written without an answer."""
    with _lock:
        _owed.setdefault(unit, {})[pdus[0][:3]] = time.monotonic(), tuple(pdus)


def owed(unit: Unit) -> tuple[bytes, ...]:
    """The requests of all stops that are owed to a unit."""
    since_s = time.monotonic() - _REMEMBERED_S
    with _lock:
        return tuple(pdu for written_s, pdus in _owed.get(unit, {}).values() if written_s > since_s for pdu in pdus)


def settle(unit: Unit) -> None:
    """Nothing is owed to a unit any more: it answered."""
    with _lock:
        _owed.pop(unit, None)


def framed(number: int, unit: int, pdu: bytes) -> bytes:
    """A request with its head on TCP (MBAP)."""
    return struct.pack(">HHHB", number & 0xFFFF, 0, len(pdu) + 1, unit) + pdu


def exchange(sock: socket.socket, unit: int, pdus: Sequence[bytes], timeout_s: float) -> bool:
    """Write requests on a connection and wait until each was answered, with whatever answer.

    Returns:
        False if not all answers came within the time; the connection must not be used any more then.
    """
    waiting, heard, end_s = {_FIRST_NUMBER + place for place in range(len(pdus))}, b"", time.monotonic() + timeout_s
    try:
        for place, pdu in enumerate(pdus):
            sock.sendall(framed(_FIRST_NUMBER + place, unit, pdu))
        while waiting:
            if not select.select([sock], [], [], max(0.0, end_s - time.monotonic()))[0]:
                return False
            more = sock.recv(4096)
            if not more:
                return False
            heard += more
            while len(heard) >= 6 and len(heard) >= (length := 6 + int.from_bytes(heard[4:6])):
                waiting.discard(int.from_bytes(heard[:2]))
                heard = heard[length:]
    except OSError:
        return False
    return not heard


class _Connection:
    """One connection on which is written without waiting."""

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock
        self._since_s: float | None = None
        self._answered = False
        sock.setblocking(False)

    def send(self, data: bytes) -> bool:
        try:
            whole = self._sock.send(data) == len(data)
        except OSError:
            return False
        self._answered = False
        self._since_s = self._since_s or time.monotonic()
        return whole

    def listen(self, wait_s: float) -> None:
        """Throw away what has come since something was written; whatever came is an answer."""
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
    def over(self) -> bool:
        """It was answered, or ended, or never will be."""
        return self._answered or (self._since_s is not None and time.monotonic() - self._since_s > _PATIENCE_S)

    def close(self) -> None:
        self._sock.close()


class BlindWriter:
    """Writes requests to a unit on an existing connection and on fresh ones, and waits for no answer. Never raises.

    Args:
        sock: a connection to the unit, or a duplicate of one; closed with the writer.
        address: its other end.
        unit: Modbus unit.
    """

    def __init__(self, sock: socket.socket, address: _Address, unit: int) -> None:
        self._family, self._address, self._unit = sock.family, address, unit
        self._numbers = itertools.count(_FIRST_NUMBER)
        self._connections = {_OLD: _Connection(sock)}
        # A fresh connection that `write` opened after `close` is closed with the writer at the latest.
        weakref.finalize(self, _close_all, self._connections)

    def write(self, pdus: Sequence[bytes]) -> bool:
        """Write on both connections, at most `CONNECT_S` and a few hundredths of a second long.

        Returns:
            Whether anything was written.
        """
        self._sweep()
        written = _OLD in self._connections and self._send(self._connections[_OLD], pdus)
        if _FRESH not in self._connections and (fresh := self._connected()) is not None:
            self._connections[_FRESH] = fresh
        if _FRESH in self._connections:
            written |= self._send(self._connections[_FRESH], pdus)
        end_s = time.monotonic() + _LINGER_S
        for name in (_FRESH, _OLD):
            if name in self._connections:
                self._connections[name].listen(max(0.0, end_s - time.monotonic()))
        self._sweep()
        return written

    def close(self) -> None:
        """Close both connections; `write` opens a fresh one again."""
        _close_all(self._connections)

    def _send(self, connection: _Connection, pdus: Sequence[bytes]) -> bool:
        # One segment each: simple devices take no more than one request out of a segment.
        return any([connection.send(framed(next(self._numbers), self._unit, pdu)) for pdu in pdus])

    def _connected(self) -> _Connection | None:
        sock = socket.socket(self._family, socket.SOCK_STREAM)
        try:
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            sock.settimeout(CONNECT_S)
            sock.connect(self._address)
        except OSError:
            sock.close()
            return None
        return _Connection(sock)

    def _sweep(self) -> None:
        """Close connections that have served."""
        for name, connection in tuple(self._connections.items()):
            connection.listen(0.0)
            if connection.over:
                connection.close()
                del self._connections[name]


def _close_all(connections: dict[str, _Connection]) -> None:
    for connection in connections.values():
        connection.listen(0.0)
        connection.close()
    connections.clear()
