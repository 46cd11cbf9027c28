"""Modbus RTU over a serial line on which an answer may come late, and is never taken for the answer to a later request.

A reply carries no number, so after anything irregular the line is not believed until a probe was answered: a reading whose reply has
another length (or function) than every reply that is still owed. A device answers in the order in which it was asked; whatever was
owed has then come before, or never will. A line of unknown past is first listened to for as long as the slowest answer takes.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

from semlive.errors import LinkError
from semlive_drivers.modbus.codec import Block
from semlive_drivers.modbus.rtu.frames import build_frame, is_reply_to, parse_frame, read_request, replies_ambiguous
from semlive_drivers.serial_port import SerialPort, SerialSettings

_LONGEST_S = 1.5
"""A link thread that is away for 4 s is taken for lost, so opening a line must not take longer."""
_BETWEEN_S = 0.03
"""Time for the answer to a request that nobody waits for, before the next one."""
READS = 4
"""The functions that read are 1 to 4."""


class NoReply(LinkError):
    """Nothing came in time, or something that cannot be the answer."""


class RtuLine:
    """A line with any number of units on it, owned by one thread.

    Args:
        settings: of the line.
        timeout_s: longest wait for the first byte of an answer, besides the time that bytes take on the wire.
        who: is spoken to.

    Raises:
        LinkRefused: if the line cannot be opened.
    """

    def __init__(self, settings: SerialSettings, timeout_s: float, who: str = "modbus") -> None:
        self._port = SerialPort(settings, who)
        self.timeout_s = timeout_s
        self.where = settings.port
        self.strays = 0
        for stop in self._port.past.first:
            self._port.write(stop)
        if self._port.unknown:
            self._port.wait_max_reply_time()

    @property
    def settings(self) -> SerialSettings:
        """How the line is set."""
        return self._port.settings

    @property
    def reply_timeout_s(self) -> float:
        """How long it takes until the slowest answer must have come, as far as anybody waits for it."""
        return min(self._port.settings.slowest_s, _LONGEST_S)

    def allow_for(self, settings: SerialSettings) -> None:
        """Another device on the same line, which may need more silence and more patience."""
        self._port.allow_for(settings)

    def transact(self, unit: int, pdu: bytes, doing: str) -> bytes:
        """The answer to a request, without unit and check.

        Raises:
            NoAnswer: if it does not come in time, or something else comes; `drain` must succeed before the next request.
            LinkError: if the line is gone.
        """
        if self.has_pending_reply(unit):
            raise NoReply(f"{self.where} unit {unit} is not settled: an answer is still owed")
        reply = self._exchange(unit, pdu)
        if reply is None or not is_reply_to(reply, pdu):
            self._owed(unit).append(pdu)
            what = f"gave no answer within {self.timeout_s:g} s" if reply is None else "gave the answer to another request"
            raise NoReply(f"{self.where} unit {unit} {what} while {doing}; check cable and device")
        if pdu[0] > READS:
            # Orders are taken again: the owner's own stop comes through.
            self._port.past.first[:] = [stop for stop in self._port.past.first if stop[0] != unit]
        return reply

    def has_pending_reply(self, unit: int) -> bool:
        """Whether an answer of a unit may still come."""
        return bool(self._owed(unit))

    def drain(self, unit: int, probes: Sequence[Block], patient: bool = True, wait_s: float | None = None) -> None:
        """Make sure that no earlier answer of a unit can come any more.

        Args:
            unit: which.
            probes: blocks that can be read without harm.
            patient: probe until the slowest answer must have come (at most `_LONGEST_S`), not just once.
            wait_s: longest wait for the first byte of the answer to a probe, s, where it is less than `timeout_s`.

        Raises:
            NoAnswer: if the unit does not answer.
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
            if self._probed(unit, probe, wait_s):
                self._owed(unit).clear()
                return
        longest_s = self._first_byte_s(wait_s)
        raise NoReply(f"{self.where} unit {unit} gave no answer within {longest_s:g} s while it was probed; check cable and device")

    def broadcast(self, unit: int, pdus: Sequence[bytes]) -> None:
        """Write requests without waiting for an answer: a stop on a line that is not believed any more.

        They take the place of what this line was to say first to this unit for the same registers.

        Raises:
            LinkError: if the line is gone.
        """
        heads, owed = {build_frame(unit, pdu)[:4] for pdu in pdus}, self._owed(unit)
        owed += [pdu for pdu in pdus if not any(replies_ambiguous(pdu, other) for other in owed)]
        self._port.past.first[:] = [stop for stop in self._port.past.first if stop[:4] not in heads]
        self._port.past.first += [build_frame(unit, pdu) for pdu in pdus]
        for place, pdu in enumerate(pdus):
            if place:  # on two wires an answer and the next request would collide
                self._port.read_until(_BETWEEN_S)
            self._port.write(build_frame(unit, pdu))

    def send_urgent(self, unit: int) -> None:
        """Say again, without waiting, what a unit was told and never confirmed; `__init__` does so for all units."""
        for stop in self._port.past.first:
            if stop[0] == unit:
                self._port.write(stop)

    def close(self) -> None:
        """Close the line; what is owed is remembered."""
        self._port.close()

    def _first_byte_s(self, wait_s: float | None) -> float:
        """How long the first byte of an answer is waited for, s."""
        return self.timeout_s if wait_s is None else min(wait_s, self.timeout_s)

    def _owed(self, unit: int) -> list[bytes]:
        return self._port.past.replies_pending.setdefault(unit, [])

    def _distinct(self, unit: int, probes: Sequence[Block]) -> bytes | None:
        """A reading whose answer cannot be mistaken for anything that is owed."""
        owed = self._owed(unit)
        for block in probes:
            for count in range(block.count, 0, -1):
                request = read_request(Block(block.kind, block.address, count))
                if not any(replies_ambiguous(request, other) for other in owed):
                    return request
        return None

    def _probed(self, unit: int, probe: bytes, wait_s: float | None) -> bool:
        reply = self._exchange(unit, probe, skip_others=True, wait_s=wait_s)
        if reply is not None and reply[0] == probe[0]:
            return True
        self._owed(unit).append(probe)
        return False

    def _exchange(self, unit: int, pdu: bytes, skip_others: bool = False, wait_s: float | None = None) -> bytes | None:
        """Ask, and give the next reply of that unit; None if none comes, or what comes is broken or came unasked."""
        request = build_frame(unit, pdu)
        silent = self._port.write(request)
        if not (silent or skip_others):
            self.strays += 1
            return None
        first_byte_s = self._first_byte_s(wait_s)
        until_s, heard = time.monotonic() + first_byte_s + self._port.take_bytes_s(len(request) + _longest(pdu)), b""
        echo = request if self._port.settings.echo else b""
        while more := self._port.read(until_s):
            heard += more
            if echo:
                if len(heard) < len(echo):
                    continue
                heard, echo = heard.removeprefix(echo), b""
            part = parse_frame(heard)
            while part.frame is not None:
                heard = part.rest
                if part.frame[0] == unit and (not skip_others or (is_reply_to(part.frame[1:-2], pdu) and part.frame[1] == pdu[0])):
                    return part.frame[1:-2] if not heard else None
                self.strays += 1
                part = parse_frame(heard)
            if part.broken:
                self.strays += 1
                self._port.drain()
                if not skip_others:
                    return None
                heard = b""
        return None


def _longest(pdu: bytes) -> int:
    """Bytes of the answer at most."""
    return 5 + 2 * int.from_bytes(pdu[3:5]) if pdu[0] in (3, 4) else 5 + int.from_bytes(pdu[3:5]) // 8 + 1 if pdu[0] < 3 else 8
