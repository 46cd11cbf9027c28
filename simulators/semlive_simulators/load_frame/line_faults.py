"""Faults of a line: late, corrupted, repeated or missing replies, and a device that receives nothing for some time."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum

from semlive_simulators.load_frame.rtu import crc16

_NEWTONS = re.compile(rb"(-?\d+\.\d+) N\b")
_N_PER_LBF = 4.4482216152605


class Line(StrEnum):
    """Kind of a line to the bench."""

    TCP = "tcp"
    RTU = "rtu"
    SERIAL = "serial"


class LineFault(StrEnum):
    """Fault of a reply; with `SILENT` the request is lost as well and has no effect."""

    LATE = "late"
    LOST = "lost"
    NOISE = "noise"
    WRONG_CHECK = "wrong_check"
    SPLIT = "split"
    ECHO = "echo"
    TWICE = "twice"
    SILENT = "silent"
    WRONG_UNIT = "wrong_unit"


@dataclass(frozen=True, slots=True)
class LineChunk:
    """Bytes on a line.

    Attributes:
        wait_s: wall time before the bytes, s.
        data: the bytes.
    """

    wait_s: float
    data: bytes


@dataclass(frozen=True, slots=True)
class ReplyFault:
    """The fault of one reply.

    Attributes:
        kind: kind of the fault.
        wait_s: delay, or time between two pieces, wall time, s.
    """

    kind: LineFault
    wait_s: float


@dataclass(frozen=True, slots=True)
class PlannedLineFault:
    """A fault of every reply for some time.

    Attributes:
        at_s: start, seconds since the run began.
        lasts_s: duration, s.
        line: faulty line; None for all lines.
        fault: fault of every reply.
    """

    at_s: float
    lasts_s: float
    line: Line | None
    fault: ReplyFault


def corrupt_reply(line: Line, request: bytes, reply: bytes, fault: ReplyFault | None) -> tuple[LineChunk, ...]:
    """The bytes that are sent instead of a reply.

    `WRONG_CHECK` corrupts the CRC of RTU or the transaction number of TCP; text has no checksum, so the top bit of its first letter is
    set. `WRONG_UNIT` answers with the number of the next unit and a correct CRC; text has no unit number, so the same force is sent in lbF.
    `NOISE` adds three bytes before the reply; `ECHO` adds the request, as on a two-wire line.
    """
    if fault is None:
        return (LineChunk(0.0, reply),) if reply else ()
    wait_s = fault.wait_s
    chunks: dict[LineFault, tuple[LineChunk, ...]] = {
        LineFault.LATE: (LineChunk(wait_s, reply),),
        LineFault.LOST: (),
        LineFault.NOISE: (LineChunk(0.0, b"\xc3\x5a\xf1" + reply),),
        LineFault.WRONG_CHECK: (LineChunk(0.0, _damaged(line, reply)),),
        LineFault.SPLIT: (LineChunk(0.0, reply[: len(reply) // 2]), LineChunk(wait_s, reply[len(reply) // 2 :])),
        LineFault.ECHO: (LineChunk(0.0, request + reply),),
        LineFault.TWICE: (LineChunk(0.0, reply), LineChunk(wait_s, reply)),
        LineFault.SILENT: (),
        LineFault.WRONG_UNIT: (LineChunk(0.0, _of_another_unit(line, reply)),),
    }
    return chunks[fault.kind]


def _damaged(line: Line, reply: bytes) -> bytes:
    if line is Line.RTU:
        return reply[:-1] + bytes([reply[-1] ^ 0xFF])
    return bytes([reply[0] ^ (0x80 if line is Line.SERIAL else 0x55)]) + reply[1:]


def _of_another_unit(line: Line, reply: bytes) -> bytes:
    if line is Line.SERIAL:
        return _NEWTONS.sub(lambda force: b"%.3f lbF" % (float(force[1]) / _N_PER_LBF), reply)
    if line is Line.TCP:
        return reply[:6] + bytes([(reply[6] + 1) & 0xFF]) + reply[7:]
    frame = bytes([(reply[0] + 1) & 0xFF]) + reply[1:-2]
    return frame + crc16(frame)


@dataclass(slots=True)
class _Order:
    number: int
    fault: ReplyFault
    remaining: dict[Line, int]


class LineFaultInjector:
    """Line faults of the scenario and faults ordered during the run; shared by all lines, thread-safe.

    A planned fault affects every reply for a duration of experiment time. An ordered fault affects a number of next replies of a line;
    ordered silence lasts for a wall time instead.
    """

    def __init__(self, planned: Iterable[PlannedLineFault], now_s: Callable[[], float]) -> None:
        self._planned = tuple(planned)
        self._now_s = now_s
        self._lock = threading.Lock()
        self._orders: list[_Order] = []
        self._ordered = 0
        self._silent_until: dict[Line, float] = {}
        self._exempt_ports: set[int] = set()

    def exempt(self, port: int) -> None:
        """Exclude a TCP client from faults, by its port: the gateway of the RTU line, which has its own faults."""
        self._exempt_ports.add(port)

    def is_exempt(self, port: int) -> bool:
        """Whether a TCP client is excluded from faults."""
        return port in self._exempt_ports

    def order(self, kind: LineFault, lines: Iterable[Line], count: int, wait_s: float) -> None:
        """Order a fault of the next `count` replies on lines, after that to a request under way; or silence for `wait_s`."""
        with self._lock:
            self._ordered += 1
            if kind is LineFault.SILENT:
                self._silent_until.update(dict.fromkeys(lines, time.monotonic() + wait_s))
            else:
                self._orders.append(_Order(self._ordered, ReplyFault(kind, wait_s), dict.fromkeys(lines, count)))

    def clear(self) -> None:
        """Remove all ordered faults."""
        with self._lock:
            self._orders.clear()
            self._silent_until.clear()

    def is_silent(self, line: Line) -> bool:
        """Whether a request that arrives now is lost."""
        with self._lock:
            if time.monotonic() < self._silent_until.get(line, 0.0):
                return True
        planned = self._now(line)
        return planned is not None and planned.kind is LineFault.SILENT

    def mark(self) -> int:
        """The number of orders so far; taken before a request, so that an order in the request does not affect its own reply."""
        with self._lock:
            return self._ordered

    def take(self, line: Line, mark: int) -> ReplyFault | None:
        """The fault of a reply that is sent next; None without a fault."""
        with self._lock:
            for order in self._orders:
                if order.number <= mark and order.remaining.get(line, 0) > 0:
                    order.remaining[line] -= 1
                    self._orders = [pending for pending in self._orders if any(pending.remaining.values())]
                    return order.fault
        return self._now(line)

    def _now(self, line: Line) -> ReplyFault | None:
        if not self._planned:
            return None
        now_s = self._now_s()
        for planned in self._planned:
            if planned.line in (None, line) and planned.at_s <= now_s < planned.at_s + planned.lasts_s:
                return planned.fault
        return None


def corrupt(line_faults: LineFaultInjector, line: Line, answer: Callable[[bytes], bytes]) -> Callable[[bytes], tuple[LineChunk, ...]]:
    """A function that answers with the faults of a line; bursts without a reply use no ordered fault."""

    def sent(burst: bytes) -> tuple[LineChunk, ...]:
        if line_faults.is_silent(line):
            return ()
        mark = line_faults.mark()
        reply = answer(burst)
        return corrupt_reply(line, burst, reply, line_faults.take(line, mark)) if reply else ()

    return sent
