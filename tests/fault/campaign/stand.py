"""A load frame for injected faults: docs/reference/bench-registers.md over real TCP and over a pseudo-terminal.

It moves in load control, has a watchdog, and records the time and reason of each stop. It shares no code with the drivers.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import struct
import threading
import time
import tty
from collections.abc import Callable
from dataclasses import dataclass, field

STOPPED, MOVING, FAULT = 0, 1, 2
_HOLDING = 8
_INPUTS = {*range(16), 300, 301, 302}


def crc(data: bytes) -> bytes:
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = (value >> 1) ^ 0xA001 if value & 1 else value >> 1
    return struct.pack("<H", value)


def _f32(value: float) -> list[int]:
    return list(struct.unpack(">HH", struct.pack(">f", value)))


@dataclass
class Stand:
    """The machine. Rows change its fields; times are monotonic seconds."""

    stiffness_n_mm: float = 20_000.0
    silent: bool = False
    stuck: bool = False
    wrong_way: bool = False
    heart_stuck: bool = False
    frozen: bool = False
    word: int | None = None
    trouble: int = 0
    creep_n_s: float = 0.0
    jump_mm: float = 0.0
    sensor: Callable[[float], float] = lambda force_n: force_n
    refuse_motion: int = 0
    late_s: Callable[[], float] = lambda: 0.0
    corrupt: Callable[[bytes], list[tuple[float, bytes]]] = lambda frame: [(0.0, frame)]
    requests: list[bytes] = field(default_factory=list)
    stops: list[tuple[float, str]] = field(default_factory=list)
    readings: dict[int, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.lock = threading.RLock()
        self.holding = [0] * _HOLDING
        self.force_n, self.target_n, self.rate_n_s = 0.0, 0.0, 0.0
        self.moving, self._at_s, self._fed_s = False, time.monotonic(), time.monotonic()
        self._power_on_s = time.monotonic()
        self.over = threading.Event()
        threading.Thread(target=self._run, daemon=True).start()

    # ---- the machine

    def move(self, target_n: float, rate_n_s: float) -> None:
        """Start a motion, by an order or at the panel."""
        with self.lock:
            self._advance()
            self.target_n, self.rate_n_s, self.moving = target_n, rate_n_s, not self.stuck

    def halt(self, why: str, at_s: float | None = None) -> None:
        """Stop at an instant, which may be in the past if the computer was busy; None for now."""
        with self.lock:
            self._advance()
            self._rest(why, at_s)

    def _rest(self, why: str, at_s: float | None = None) -> None:
        if self.moving:
            self.stops.append((time.monotonic() if at_s is None else at_s, why))
        self.moving = False

    def reboot(self) -> None:
        """Switch off and on: the machine stops, and counter and position restart from 0."""
        with self.lock:
            self.halt("reboot")
            self.jump_mm = -self.force_n / self.stiffness_n_mm
            self._power_on_s, self.holding = time.monotonic(), [0] * _HOLDING

    def _run(self) -> None:
        while not self.over.wait(0.005):
            with self.lock:
                self._advance()
                watchdog_s = self.holding[7] * 0.1
                if self.moving and watchdog_s and time.monotonic() - self._fed_s > watchdog_s:
                    self.halt("its own watchdog", self._fed_s + watchdog_s)
                    self.word, self.trouble = FAULT, 2

    def _advance(self) -> None:
        now = time.monotonic()
        passed_s, self._at_s = now - self._at_s, now
        self.force_n -= self.creep_n_s * passed_s
        if not self.moving:
            return
        change_n = self.rate_n_s * passed_s * (-1 if self.wrong_way else 1)
        gap = self.target_n - self.force_n
        if not self.wrong_way and abs(gap) <= abs(change_n):
            self.force_n = self.target_n
            self._rest("arrived")
        else:
            self.force_n += change_n if gap > 0 else -change_n

    # ---- the registers

    def answer(self, pdu: bytes) -> bytes | None:
        """The reply to a request; None for no reply."""
        with self.lock:
            self.requests.append(pdu)
            if self.silent:
                return None
            function, address = pdu[0], int.from_bytes(pdu[1:3])
            if function in (3, 4):
                count = int.from_bytes(pdu[3:5])
                registers = self._inputs() if function == 4 else dict(enumerate(self.holding))
                if any(word not in registers for word in range(address, address + count)):
                    return bytes([function | 0x80, 2])
                words = [registers[word] for word in range(address, address + count)]
                return bytes([function, 2 * count]) + struct.pack(f">{count}H", *words)
            if function not in (6, 16):
                return bytes([function | 0x80, 1])
            values = [int.from_bytes(pdu[3:5])] if function == 6 else list(struct.unpack(f">{(len(pdu) - 6) // 2}H", pdu[6:]))
            return self._written(address, values) or pdu[:5]

    def _inputs(self) -> dict[int, int]:
        self._advance()
        if not self.frozen:
            count = int((time.monotonic() - self._power_on_s) * 100)
            self.readings = {0: count, 1: self.sensor(self.force_n), 2: self.force_n / self.stiffness_n_mm + self.jump_mm}
        count, force_n, extension_mm = int(self.readings[0]), self.readings[1], self.readings[2]
        state = (MOVING if self.moving else STOPPED) if self.word is None else self.word
        words = [0x5E31, 1, 3, state, *_f32(force_n), *_f32(extension_mm), *_f32(self.target_n)]
        words += [count >> 16 & 0xFFFF, count & 0xFFFF, *_f32(0.0), *_f32(5000.0)]
        return {**dict(enumerate(words)), 300: self.trouble, 301: 0, 302: 0}

    def _written(self, address: int, values: list[int]) -> bytes | None:
        if address + len(values) > _HOLDING:
            return bytes([0x90, 2])
        if self.refuse_motion and address <= 4 < address + len(values) and values[4 - address] == 1:
            return bytes([0x90, self.refuse_motion])
        before = list(self.holding)
        self.holding[address : address + len(values)] = values
        if self.heart_stuck:
            self.holding[6] = before[6]
        if self.holding[6] != before[6] or self.holding[7] != before[7]:
            self._fed_s = time.monotonic()
        command = self.holding[4] if address <= 4 < address + len(values) else 0
        if command == 1:
            target, rate = (struct.unpack(">f", struct.pack(">HH", *self.holding[at : at + 2]))[0] for at in (0, 2))
            self.word, self.trouble = None, 0
            self.move(target, rate)
        elif command == 2:
            self.halt("stop")
            if self.trouble == 2:
                self.word, self.trouble = None, 0
        return None


class TcpPort:
    """The stand behind Modbus TCP, at a port that is the same after the cable was disconnected."""

    def __init__(self, stand: Stand) -> None:
        self._stand, self._clients = stand, list[socket.socket]()
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listening.getsockname()[1]
        self._serve()

    def disconnect(self) -> None:
        """Disconnect the cable: connections are closed, new ones are refused."""
        _close(self._listening)
        self._accepting.join()  # a connection accepted at this moment is among the clients after it
        _close(*self._clients)
        self._clients.clear()

    def reconnect(self) -> None:
        """Connect the cable again."""
        self._listening = socket.create_server(("127.0.0.1", self.port))
        self._serve()

    def _serve(self) -> None:
        self._accepting = threading.Thread(target=self._accept, args=(self._listening,), daemon=True)
        self._accepting.start()

    def _accept(self, listening: socket.socket) -> None:
        while True:
            try:
                client, _ = listening.accept()
            except OSError:
                return
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._clients.append(client)
            threading.Thread(target=self._talk, args=(client,), daemon=True).start()

    def _talk(self, client: socket.socket) -> None:
        with contextlib.suppress(OSError), client.makefile("rb") as stream:
            while len(head := stream.read(7)) == 7:
                number, _, length, unit = struct.unpack(">HHHB", head)
                reply = self._stand.answer(stream.read(length - 1))
                if reply is None:
                    continue
                time.sleep(self._stand.late_s())
                client.sendall(struct.pack(">HHHB", number, 0, len(reply) + 1, unit) + reply)


def _close(*connections: socket.socket) -> None:
    for connection in connections:
        with contextlib.suppress(OSError):
            connection.shutdown(socket.SHUT_RDWR)
        connection.close()


class RtuPort:
    """The stand behind Modbus RTU on a pseudo-terminal, as unit 1."""

    def __init__(self, stand: Stand) -> None:
        self._stand, self._over = stand, threading.Event()
        self._device_end, self._host_end = os.openpty()
        tty.setraw(self._host_end)
        self.path = os.ttyname(self._host_end)
        self._thread = threading.Thread(target=self._talk, daemon=True)
        self._thread.start()

    def unplug(self) -> None:
        """Remove the adapter: its path does not exist any more."""
        self._over.set()
        self._thread.join()
        os.close(self._device_end)
        os.close(self._host_end)

    def _talk(self) -> None:
        received = b""
        while not self._over.is_set():
            ready = select.select([self._device_end], [], [], 0.005 if received else 0.05)[0]
            if ready:
                received += os.read(self._device_end, 4096)
                continue
            frame, received = received, b""
            if len(frame) < 4 or frame[0] != 1 or crc(frame[:-2]) != frame[-2:]:
                continue
            reply = self._stand.answer(frame[1:-2])
            if reply is None:
                continue
            self._over.wait(self._stand.late_s())
            for wait_s, piece in self._stand.corrupt(b"\x01" + reply + crc(b"\x01" + reply)):
                self._over.wait(wait_s)
                os.write(self._device_end, piece)
