"""Modbus RTU over a serial line: a late answer is never assigned to a later request.

A reply carries no transaction number. After any irregular answer, the line is therefore out of step until a probe was answered: a read
request whose reply differs in length (or function) from every pending reply. A device answers in the order of the requests, so no earlier
reply can follow the answer to the probe. On a line of unknown history, the program first waits as long as the slowest answer takes.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

from semlive.errors import LinkError
from semlive_drivers.modbus.codec import Block
from semlive_drivers.modbus.rtu.frames import build_frame, is_reply_to, parse_frame, read_request, replies_ambiguous
from semlive_drivers.serial_port import SerialPort, SerialSettings

_MAX_WAIT_S = 1.5
"""A link thread that does not respond for 4 s counts as lost, so opening a line must not take longer."""
_REQUEST_GAP_S = 0.03
"""Time between two requests whose answers are not evaluated."""
READS = 4
"""Functions 1 to 4 read."""


class NoReply(LinkError):
    """No reply came in time, or a reply that does not match the request."""


class RtuLine:
    """A line with one or several units, owned by one thread.

    Args:
        settings: settings of the line.
        timeout_s: longest wait for the first byte of an answer, s, in addition to the time of the bytes on the wire.
        device: name of the device on the line.

    Raises:
        LinkRefused: if the line cannot be opened.
    """

    def __init__(self, settings: SerialSettings, timeout_s: float, device: str = "modbus") -> None:
        self._port = SerialPort(settings, device)
        self.timeout_s = timeout_s
        self.where = settings.port
        self.strays = 0
        for stop in self._port.history.pending_stops:
            self._port.write(stop)
        if self._port.unknown:
            self._port.wait_max_reply_time()

    @property
    def settings(self) -> SerialSettings:
        """Settings of the line."""
        return self._port.settings

    @property
    def reply_timeout_s(self) -> float:
        """Longest wait for the slowest answer, s."""
        return min(self._port.settings.slowest_s, _MAX_WAIT_S)

    def allow_for(self, settings: SerialSettings) -> None:
        """Adapt the waiting times to another device on the same line."""
        self._port.allow_for(settings)

    def transact(self, unit: int, pdu: bytes, action: str) -> bytes:
        """The answer to a request, without unit and CRC.

        Raises:
            NoReply: if it does not come in time, or another reply comes; `drain` must succeed before the next request.
            LinkError: if the line is gone.
        """
        if self.has_pending_reply(unit):
            raise NoReply(f"{self.where} unit {unit} is out of step: an earlier answer is still pending")
        reply = self._exchange(unit, pdu)
        if reply is None or not is_reply_to(reply, pdu):
            self._pending(unit).append(pdu)
            problem = f"gave no answer within {self.timeout_s:g} s" if reply is None else "gave the answer to another request"
            raise NoReply(f"{self.where} unit {unit} {problem} while {action}; check cable and device")
        if pdu[0] > READS:
            # The unit accepts orders again, so the stop of the owner arrives.
            self._port.history.pending_stops[:] = [stop for stop in self._port.history.pending_stops if stop[0] != unit]
        return reply

    def has_pending_reply(self, unit: int) -> bool:
        """Whether an answer of a unit is pending."""
        return bool(self._pending(unit))

    def drain(self, unit: int, probes: Sequence[Block], patient: bool = True, wait_s: float | None = None) -> None:
        """Probe until no earlier answer of a unit is possible any more.

        Args:
            unit: Modbus unit.
            probes: blocks that can be read without side effects.
            patient: whether to repeat the probe for the time of the slowest answer (at most `_MAX_WAIT_S`).
            wait_s: longest wait for the first byte of the answer to a probe, s, if less than `timeout_s`; None for `timeout_s`.

        Raises:
            NoReply: if the unit does not answer.
        """
        self._port.drain()
        end_s = time.monotonic() + (self.reply_timeout_s if patient else 0.0)
        first = True
        while first or time.monotonic() < end_s:
            first = False
            probe = self._distinct(unit, probes)
            if probe is None:
                self._port.wait_max_reply_time()
                continue
            if self._probe(unit, probe, wait_s):
                self._pending(unit).clear()
                return
        longest_s = self._first_byte_s(wait_s)
        raise NoReply(f"{self.where} unit {unit} gave no answer within {longest_s:g} s while it was probed; check cable and device")

    def broadcast(self, unit: int, pdus: Sequence[bytes]) -> None:
        """Write requests without waiting for an answer: a stop on a line that is out of step.

        They replace the pending stops of this unit for the same registers.

        Raises:
            LinkError: if the line is gone.
        """
        heads, pending = {build_frame(unit, pdu)[:4] for pdu in pdus}, self._pending(unit)
        pending += [pdu for pdu in pdus if not any(replies_ambiguous(pdu, earlier) for earlier in pending)]
        stops = self._port.history.pending_stops
        stops[:] = [stop for stop in stops if stop[:4] not in heads]
        stops += [build_frame(unit, pdu) for pdu in pdus]
        for index, pdu in enumerate(pdus):
            if index:  # on two wires an answer and the next request would collide
                self._port.read_until(_REQUEST_GAP_S)
            self._port.write(build_frame(unit, pdu))

    def send_urgent(self, unit: int) -> None:
        """Write the pending stops of a unit again without waiting for an answer; `__init__` does this for all units."""
        for stop in self._port.history.pending_stops:
            if stop[0] == unit:
                self._port.write(stop)

    def close(self) -> None:
        """Close the line; its pending replies remain stored."""
        self._port.close()

    def _first_byte_s(self, wait_s: float | None) -> float:
        """Longest wait for the first byte of an answer, s."""
        return self.timeout_s if wait_s is None else min(wait_s, self.timeout_s)

    def _pending(self, unit: int) -> list[bytes]:
        return self._port.history.replies_pending.setdefault(unit, [])

    def _distinct(self, unit: int, probes: Sequence[Block]) -> bytes | None:
        """A read request whose answer differs from every pending reply; None if there is none."""
        pending = self._pending(unit)
        for block in probes:
            for count in range(block.count, 0, -1):
                request = read_request(Block(block.kind, block.address, count))
                if not any(replies_ambiguous(request, earlier) for earlier in pending):
                    return request
        return None

    def _probe(self, unit: int, probe: bytes, wait_s: float | None) -> bool:
        reply = self._exchange(unit, probe, skip_others=True, wait_s=wait_s)
        if reply is not None and reply[0] == probe[0]:
            return True
        self._pending(unit).append(probe)
        return False

    def _exchange(self, unit: int, pdu: bytes, skip_others: bool = False, wait_s: float | None = None) -> bytes | None:
        """Send a request and receive the next reply of the unit.

        Args:
            unit: Modbus unit.
            pdu: the request.
            skip_others: ignore replies that do not match the request.
            wait_s: longest wait for the first byte, s; None for `timeout_s`.

        Returns:
            The reply; None if there is none, or it is corrupted, or bytes came before the request.
        """
        request = build_frame(unit, pdu)
        silent = self._port.write(request)
        if not (silent or skip_others):
            self.strays += 1
            return None
        first_byte_s = self._first_byte_s(wait_s)
        until_s, received = time.monotonic() + first_byte_s + self._port.take_bytes_s(len(request) + _max_reply_bytes(pdu)), b""
        echo = request if self._port.settings.echo else b""
        while data := self._port.read(until_s):
            received += data
            if echo:
                if len(received) < len(echo):
                    continue
                received, echo = received.removeprefix(echo), b""
            part = parse_frame(received)
            while part.frame is not None:
                received = part.rest
                if part.frame[0] == unit and (not skip_others or (is_reply_to(part.frame[1:-2], pdu) and part.frame[1] == pdu[0])):
                    return part.frame[1:-2] if not received else None
                self.strays += 1
                part = parse_frame(received)
            if part.broken:
                self.strays += 1
                self._port.drain()
                if not skip_others:
                    return None
                received = b""
        return None


def _max_reply_bytes(pdu: bytes) -> int:
    """Largest length of the answer to a request, bytes."""
    return 5 + 2 * int.from_bytes(pdu[3:5]) if pdu[0] in (3, 4) else 5 + int.from_bytes(pdu[3:5]) // 8 + 1 if pdu[0] < 3 else 8
