"""Serial lines as pseudo-terminals: Modbus RTU with several units, and lines of text. Standard library only."""

from __future__ import annotations

import asyncio
import os
import pty
import struct
import tty
from collections.abc import Callable, Mapping
from pathlib import Path

from map_text import TextDevice
from second_machine import Machine
from unit_registers import UnitRegisters

_GAP_S = 0.03
"""A request that is not complete after this silence is thrown away."""


def crc16(data: bytes) -> bytes:
    """The check of a Modbus RTU frame, low byte first."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0xA001 if crc & 1 else crc >> 1
    return struct.pack("<H", crc)


class PseudoLine:
    """A pseudo-terminal under a stable path; a request acts when it is complete, replies come in order and may be late.

    Args:
        path: symbolic link that is made to the terminal.
        link: its number, for faults that concern one link.
        machine: its latency and its fault switches.
        cut: takes the first complete request of what was received; returns it, or None, and what follows.
        answer: the reply to a request; empty: none.
    """

    def __init__(
        self,
        path: Path,
        link: int,
        machine: Machine,
        cut: Callable[[bytes], tuple[bytes | None, bytes]],
        answer: Callable[[bytes], bytes],
    ) -> None:
        self._link, self._machine, self._cut, self._answer = link, machine, cut, answer
        self._ours, self._theirs = pty.openpty()
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        path.unlink(missing_ok=True)
        path.symlink_to(os.ttyname(self._theirs))
        self._received = b""
        self._replies = asyncio.Queue[tuple[float, bytes]]()
        self._last_s = 0.0

    async def serve(self) -> None:
        """Read and answer until cancelled."""
        loop = asyncio.get_running_loop()
        loop.add_reader(self._ours, self._read)
        while True:
            due_s, reply = await self._replies.get()
            await asyncio.sleep(max(0.0, due_s - loop.time()))
            os.write(self._ours, reply)

    def _act(self, request: bytes, now_s: float) -> None:
        switches = self._machine.switches
        if switches.hole and switches.concern(self._link):
            return
        reply = self._answer(request)
        if not reply or (switches.mute and switches.concern(self._link)):
            return
        if switches.trunc and len(reply) > 3:
            reply = reply[:-2]
        self._replies.put_nowait((now_s + self._machine.reply_latency_s(self._link), reply))

    def _read(self) -> None:
        now_s = asyncio.get_running_loop().time()
        if now_s > self._last_s + _GAP_S:
            self._received = b""
        self._last_s = now_s
        try:
            self._received += os.read(self._ours, 4096)
        except OSError:
            return
        while self._received:
            request, rest = self._cut(self._received)
            if request is None and rest == self._received:
                return
            self._received = rest
            if request is not None:
                self._act(request, now_s)


def rtu_line(path: Path, link: int, machine: Machine, units: Mapping[int, UnitRegisters]) -> PseudoLine:
    """A line with Modbus RTU units; other units and frames with a wrong check meet silence."""

    def cut(received: bytes) -> tuple[bytes | None, bytes]:
        if len(received) < 8:
            return None, received
        length = 9 + received[6] if received[1] == 16 else 8
        if len(received) < length:
            return None, received
        frame, rest = received[:length], received[length:]
        if crc16(frame[:-2]) != frame[-2:]:
            return None, b""
        return frame, rest

    def answer(frame: bytes) -> bytes:
        registers = units.get(frame[0])
        if registers is None:
            return b""
        reply = frame[:1] + registers.answer(frame[1:-2])
        return reply + crc16(reply)

    return PseudoLine(path, link, machine, cut, answer)


def text_line(path: Path, link: int, machine: Machine, device: TextDevice) -> PseudoLine:
    """A line of text; the device finds the ends of requests by itself."""
    return PseudoLine(path, link, machine, lambda received: (received, b""), device.receive)
