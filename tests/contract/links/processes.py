"""Starts the peers as processes and accesses them without the drivers."""

from __future__ import annotations

import signal
import struct
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from pymodbus.client import ModbusTcpClient


@dataclass
class Peer:
    """A server process."""

    process: subprocess.Popen[str]
    port: int

    def pause(self) -> None:
        """It continues to accept connections (the kernel does), and answers nothing."""
        self.process.send_signal(signal.SIGSTOP)

    def go_on(self) -> None:
        self.process.send_signal(signal.SIGCONT)

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def poke(self, address: int, values: list[int]) -> None:
        """Write registers."""
        with ModbusTcpClient("127.0.0.1", port=self.port, timeout=20) as client:
            assert not client.write_registers(address, values, device_id=1).isError()

    def peek(self, address: int, count: int) -> list[int]:
        """Read holding registers."""
        with ModbusTcpClient("127.0.0.1", port=self.port, timeout=20) as client:
            return client.read_holding_registers(address, count=count, device_id=1).registers

    def misbehave(self, mode: int) -> None:
        self.poke(900, [mode])

    def set_force(self, force_n: float) -> None:
        self.poke(902, list(struct.unpack(">HH", struct.pack(">f", force_n))))

    @property
    def commands(self) -> int:
        """Commands to the load frame so far."""
        return self.peek(910, 1)[0]

    @property
    def last_command(self) -> int:
        return self.peek(911, 1)[0]


@contextmanager
def peer(name: str = "register_server.py", port: int = 0) -> Iterator[Peer]:
    """A running server."""
    arguments = [sys.executable, str(Path(__file__).with_name(name)), *([str(port)] if port else [])]
    process = subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        yield Peer(process, int(process.stdout.readline()))
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGCONT)
            process.kill()
        process.wait()
        process.stdin.close()
        process.stdout.close()
