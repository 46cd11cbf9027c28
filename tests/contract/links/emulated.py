"""Devices on a desk, written apart from the drivers: registers with a hook, served over TCP and over a pseudo-terminal, in threads.

Every request is noted. Answers over the pseudo-terminal can be made late; the device answers in the order of the requests, as a
device with one processor does.
"""

from __future__ import annotations

import contextlib
import os
import queue
import select
import socket
import struct
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from semlive_drivers import serial_port


def crc(data: bytes) -> bytes:
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = (value >> 1) ^ 0xA001 if value & 1 else value >> 1
    return struct.pack("<H", value)


@dataclass
class Device:
    """Holding and input registers of a unit; `words` are the known addresses."""

    words: dict[int, int]
    before_read: Callable[[], None] = lambda: None
    after_write: Callable[[int, list[int]], None] = lambda address, values: None
    requests: list[bytes] = field(default_factory=list)
    silent: bool = False
    refuses: Callable[[bytes], int] = lambda pdu: 0
    """The exception with which a request is answered; 0 for none."""

    def set32(self, address: int, value: int) -> None:
        self.words[address], self.words[address + 1] = value >> 16 & 0xFFFF, value & 0xFFFF

    def get32(self, address: int) -> int:
        value = self.words[address] << 16 | self.words[address + 1]
        return value - (1 << 32) if value >> 31 else value

    @property
    def writes(self) -> list[bytes]:
        return [request for request in self.requests if request[0] not in (1, 2, 3, 4)]

    def answer(self, pdu: bytes) -> bytes:
        self.requests.append(pdu)
        function, address = pdu[0], int.from_bytes(pdu[1:3])
        if exception := self.refuses(pdu):
            return bytes([function | 0x80, exception])
        if function in (3, 4):
            span = range(address, address + int.from_bytes(pdu[3:5]))
            if any(word not in self.words for word in span):
                return bytes([function | 0x80, 2])
            self.before_read()
            return bytes([function, 2 * len(span)]) + b"".join(struct.pack(">H", self.words[word]) for word in span)
        if function in (6, 16):
            values = [int.from_bytes(pdu[3:5])] if function == 6 else list(struct.unpack(f">{(len(pdu) - 6) // 2}H", pdu[6:]))
            if any(address + place not in self.words for place in range(len(values))):
                return bytes([function | 0x80, 2])
            self.words.update(enumerate(values, address))
            self.after_write(address, values)
            return pdu[:5]
        return bytes([function | 0x80, 1])


@contextmanager
def over_tcp(device: Device) -> Iterator[int]:
    """Serve a device; gives the port."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        threading.Thread(target=_accept, args=(listening, device), daemon=True).start()
        yield listening.getsockname()[1]


def _accept(listening: socket.socket, device: Device) -> None:
    while True:
        try:
            client, _ = listening.accept()
        except OSError:
            return
        threading.Thread(target=_serve, args=(client, device), daemon=True).start()


def _serve(client: socket.socket, device: Device) -> None:
    with contextlib.suppress(ConnectionError), client, client.makefile("rb") as stream:  # the other side may reset its connection
        while len(head := stream.read(7)) == 7:
            number, _, length, unit = struct.unpack(">HHHB", head)
            reply = device.answer(stream.read(length - 1))
            if not device.silent:
                client.sendall(struct.pack(">HHHB", number, 0, len(reply) + 1, unit) + reply)


@contextmanager
def over_rtu(devices: dict[int, Device], late_s: Callable[[], float] = lambda: 0.0) -> Iterator[str]:
    """Serve devices by unit over one pseudo-terminal; gives its path. `late_s` is called before each answer."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    over = threading.Event()
    requested: queue.SimpleQueue[bytes] = queue.SimpleQueue()

    def receive() -> None:
        received = b""
        while not over.is_set():
            if not select.select([ours], [], [], 0.05)[0]:
                continue
            received += os.read(ours, 4096)
            while frame := _first_frame(received):
                received = received[len(frame) :]
                requested.put(frame)

    def speak() -> None:
        while not over.is_set():
            try:
                frame = requested.get(timeout=0.05)
            except queue.Empty:
                continue
            if frame[0] in devices and not devices[frame[0]].silent:
                body = frame[:1] + devices[frame[0]].answer(frame[1:-2])
                time.sleep(late_s())
                os.write(ours, body + crc(body))

    threads = [threading.Thread(target=run, daemon=True) for run in (receive, speak)]
    for thread in threads:
        thread.start()
    path = os.ttyname(theirs)
    try:
        yield path
    finally:
        # The system soon gives this path to another line, which owes nothing of what was written to this one.
        for key in [key for key in serial_port._HISTORIES if key[0] == path]:
            del serial_port._HISTORIES[key]
        over.set()
        for thread in threads:
            thread.join()
        os.close(ours)
        os.close(theirs)


def _first_frame(received: bytes) -> bytes:
    if len(received) < 8:
        return b""
    length = 8 if received[1] in (1, 2, 3, 4, 5, 6) else 9 + received[6]
    return received[:length] if len(received) >= length and crc(received[: length - 2]) == received[length - 2 : length] else b""


@dataclass
class Spring:
    """A specimen between a drive and a cell: force follows the crosshead, which moves at a speed until its way is done."""

    stiffness_n_mm: float = 1000.0
    at_mm: float = 0.0
    to_mm: float = 0.0
    speed_mm_s: float = 0.0
    since_s: float = field(default_factory=time.monotonic)
    breaks_at_n: float = float("inf")
    broken: bool = False

    def move(self, way_mm: float, speed_mm_s: float) -> None:
        self.look()
        self.to_mm, self.speed_mm_s = self.at_mm + way_mm, speed_mm_s

    def halt(self) -> None:
        self.look()
        self.to_mm = self.at_mm

    def look(self) -> tuple[float, float, bool]:
        """Position, force, and whether it moves."""
        now = time.monotonic()
        most = self.speed_mm_s * (now - self.since_s)
        self.since_s = now
        self.at_mm += max(-most, min(most, self.to_mm - self.at_mm))
        self.broken |= self.at_mm * self.stiffness_n_mm > self.breaks_at_n
        force_n = 0.0 if self.broken else self.at_mm * self.stiffness_n_mm
        return self.at_mm, force_n, self.at_mm != self.to_mm


def laumas_tlb(spring: Spring) -> Device:
    """The transmitter: gross weight as a magnitude in steps of 0.1 N, its sign in the status."""
    device = Device(dict.fromkeys(range(32), 0))
    device.words[13] = 4 << 8 | 7

    def look() -> None:
        _, force_n, _ = spring.look()
        device.words[6] = 0x0800 | (0x80 if force_n < 0 else 0)
        device.set32(7, round(abs(force_n) * 10))

    device.before_read = look
    return device


def oriental_az(spring: Spring) -> Device:
    """The drive: direct data operation of 0.1 um steps."""
    device = Device(dict.fromkeys((*range(0x58, 0x6A), *range(0x7C, 0x82), *range(0xC6, 0xD8)), 0))

    def look() -> None:
        at_mm, _, moving = spring.look()
        device.set32(0x7E, (1 << 13 if moving else 0) | 1 << 5)
        device.set32(0xCC, round(at_mm * 1e4) & 0xFFFFFFFF)

    def written(address: int, values: list[int]) -> None:
        if address <= 0x66 < address + len(values) and device.get32(0x66) == 1:
            assert device.get32(0x5A) == 3
            spring.move(device.get32(0x5C) * 1e-4, device.get32(0x5E) * 1e-4)
        if address == 0x7C and device.get32(0x7C) & 0x20:
            spring.halt()

    device.before_read, device.after_write = look, written
    return device


def leadshine(spring: Spring) -> Device:
    """The drive: path 0, relative, 0.1 um pulses and 0.01 mm/s per rpm."""
    device = Device(dict.fromkeys((0x1003, 0x01BF, 0x2203, 0x6002, *range(0x6200, 0x6208)), 0))

    def look() -> None:
        device.words[0x1003] = 0x06 if spring.look()[2] else 0x32

    def written(address: int, values: list[int]) -> None:
        if address == 0x6002 and values == [0x10]:
            assert device.words[0x6200] == 0x41
            spring.move(device.get32(0x6201) * 1e-4, device.words[0x6203] * 1e-2)
        elif address == 0x6002 and values == [0x40]:
            spring.halt()

    device.before_read, device.after_write = look, written
    return device
