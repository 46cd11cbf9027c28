"""Trouble on a line: replies that come late, broken, twice or not at all, and a device that hears nothing for a while."""

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
    """How a master reaches the bench."""

    TCP = "tcp"
    RTU = "rtu"
    SERIAL = "serial"


class LineFault(StrEnum):
    """What happens to a reply; `SILENT` to the request already, which then has no effect."""

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
        wait_s: wall time before them.
        data: what is sent.
    """

    wait_s: float
    data: bytes


@dataclass(frozen=True, slots=True)
class ReplyFault:
    """What is to happen to one reply.

    Attributes:
        trouble: what.
        wait_s: how late, or how long between two pieces, wall time.
    """

    trouble: LineFault
    wait_s: float


@dataclass(frozen=True, slots=True)
class PlannedLineFault:
    """Trouble for a while.

    Attributes:
        at_s: when it begins, seconds since the run began.
        lasts_s: how long.
        line: in trouble; None is all.
        spoiling: what happens to every reply.
    """

    at_s: float
    lasts_s: float
    line: Line | None
    spoiling: ReplyFault


def corrupt_reply(line: Line, request: bytes, reply: bytes, spoiling: ReplyFault | None) -> tuple[LineChunk, ...]:
    """What is sent in place of a reply.

    `WRONG_CHECK` damages what a master can check: the CRC of RTU, the transaction number of TCP; letters have no check, there it
    sets the top bit of the first one. `WRONG_UNIT` answers in the name of the next unit, with a right check; letters have no
    unit number, there the same force is told in lbF. `NOISE` is three bytes before the reply, `ECHO` the request, as on a two-wire line.
    """
    if spoiling is None:
        return (LineChunk(0.0, reply),) if reply else ()
    wait_s = spoiling.wait_s
    made: dict[LineFault, tuple[LineChunk, ...]] = {
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
    return made[spoiling.trouble]


def _damaged(line: Line, reply: bytes) -> bytes:
    if line is Line.RTU:
        return reply[:-1] + bytes([reply[-1] ^ 0xFF])
    return bytes([reply[0] ^ (0x80 if line is Line.SERIAL else 0x55)]) + reply[1:]


def _of_another_unit(line: Line, reply: bytes) -> bytes:
    if line is Line.SERIAL:
        return _NEWTONS.sub(lambda found: b"%.3f lbF" % (float(found[1]) / _N_PER_LBF), reply)
    if line is Line.TCP:
        return reply[:6] + bytes([(reply[6] + 1) & 0xFF]) + reply[7:]
    frame = bytes([(reply[0] + 1) & 0xFF]) + reply[1:-2]
    return frame + crc16(frame)


@dataclass(slots=True)
class _Order:
    number: int
    spoiling: ReplyFault
    left: dict[Line, int]


class LineFaultInjector:
    """What the scenario plans and what was ordered meanwhile; used by all lines, safe from any thread.

    Planned trouble spoils every reply while it lasts, in experiment time. Ordered trouble spoils the next replies of a line, a
    number of them; an order to be silent holds for a wall time instead.
    """

    def __init__(self, planned: Iterable[PlannedLineFault], now_s: Callable[[], float]) -> None:
        self._planned = tuple(planned)
        self._now_s = now_s
        self._lock = threading.Lock()
        self._orders: list[_Order] = []
        self._ordered = 0
        self._silent_until: dict[Line, float] = {}
        self._spared: set[int] = set()

    def exempt(self, port: int) -> None:
        """Leave a TCP client alone, by its port: the gateway of the RTU line, which has trouble of its own."""
        self._spared.add(port)

    def spares(self, port: int) -> bool:
        """Whether a TCP client is left alone."""
        return port in self._spared

    def order(self, trouble: LineFault, lines: Iterable[Line], count: int, wait_s: float) -> None:
        """Spoil the next `count` replies on some lines, the reply to a request under way excepted; or be silent on them for `wait_s`."""
        with self._lock:
            self._ordered += 1
            if trouble is LineFault.SILENT:
                self._silent_until.update(dict.fromkeys(lines, time.monotonic() + wait_s))
            else:
                self._orders.append(_Order(self._ordered, ReplyFault(trouble, wait_s), dict.fromkeys(lines, count)))

    def clear(self) -> None:
        """Forget all orders."""
        with self._lock:
            self._orders.clear()
            self._silent_until.clear()

    def is_silent(self, line: Line) -> bool:
        """Whether what comes in now is not heard."""
        with self._lock:
            if time.monotonic() < self._silent_until.get(line, 0.0):
                return True
        planned = self._now(line)
        return planned is not None and planned.trouble is LineFault.SILENT

    def mark(self) -> int:
        """To be taken before a request is obeyed: orders that come with it do not spoil its own reply."""
        with self._lock:
            return self._ordered

    def take(self, line: Line, mark: int) -> ReplyFault | None:
        """What is to happen to a reply that is about to be sent."""
        with self._lock:
            for order in self._orders:
                if order.number <= mark and order.left.get(line, 0) > 0:
                    order.left[line] -= 1
                    self._orders = [other for other in self._orders if any(other.left.values())]
                    return order.spoiling
        return self._now(line)

    def _now(self, line: Line) -> ReplyFault | None:
        if not self._planned:
            return None
        now_s = self._now_s()
        for planned in self._planned:
            if planned.line in (None, line) and planned.at_s <= now_s < planned.at_s + planned.lasts_s:
                return planned.spoiling
        return None


def corrupt(troubles: LineFaultInjector, line: Line, answer: Callable[[bytes], bytes]) -> Callable[[bytes], tuple[LineChunk, ...]]:
    """Answers as a line in trouble sends them; bursts without a reply use up no order."""

    def sent(burst: bytes) -> tuple[LineChunk, ...]:
        if troubles.is_silent(line):
            return ()
        mark = troubles.mark()
        reply = answer(burst)
        return corrupt_reply(line, burst, reply, troubles.take(line, mark)) if reply else ()

    return sent
