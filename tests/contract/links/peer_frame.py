"""The independent load frame of ../shared/peers: a Modbus TCP server on libmodbus with fault switches, compiled where it is needed."""

from __future__ import annotations

import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

PEERS = Path(__file__).resolve().parents[3].parent / "shared" / "peers"


@dataclass
class Peer:
    """A running frame.

    Attributes:
        port: of Modbus TCP, and of UDP for the switches.
        log: its log of requests and motions.
    """

    port: int
    log: Path

    def map(self, name: str) -> str:
        """Path of one of its register maps."""
        return str(PEERS / f"map_{name}.yaml")

    def switch(self, text: str) -> None:
        """Set a fault, as ../shared/peers/README.md lists them; returns when the frame has taken it."""
        before = self.text().count("CTL")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
            control.sendto(text.encode(), ("127.0.0.1", self.port))
        end_s = time.monotonic() + 10.0
        while self.text().count("CTL") <= before:
            assert time.monotonic() < end_s, f"the frame did not take {text}"
            time.sleep(0.002)

    def now(self) -> list[str]:
        """Its true values: time, force in N, extension in mm, motion, target, rate, counter, registers 11 and 13."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
            control.settimeout(10.0)
            control.sendto(b"?", ("127.0.0.1", self.port))
            return control.recv(400).decode().split()

    @property
    def force_n(self) -> float:
        """True force, N."""
        return float(self.now()[1])

    @property
    def moves(self) -> bool:
        """Whether it really moves."""
        return self.now()[3] != "0"

    def text(self) -> str:
        """The complete log."""
        return self.log.read_text(encoding="utf-8")

    def times_s(self, what: str) -> list[float]:
        """Monotonic times of the log's lines that hold a text, s."""
        return [float(line.split()[0]) for line in self.text().splitlines() if what in line]


def buildable() -> bool:
    """Whether its source, a compiler and libmodbus are there."""
    return shutil.which("cc") is not None and Path("/usr/include/modbus/modbus.h").exists() and (PEERS / "frame.c").exists()


def compiled(folder: Path) -> Path:
    """The compiled frame."""
    program = folder / "frame"
    flags = ["-I/usr/include/modbus", "-O1", "-o", program, PEERS / "frame.c", "-lmodbus", "-lm"]
    subprocess.run(["cc", *flags], check=True, timeout=120)
    return program


@contextmanager
def running(program: Path, folder: Path, clients: int = 1) -> Iterator[Peer]:
    """Start a frame on a free port, and end it."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    log = folder / f"frame-{port}.log"
    process = subprocess.Popen([program, str(port), str(log), str(clients)])
    try:
        end_s = time.monotonic() + 10.0
        while not (log.exists() and "START" in log.read_text(encoding="utf-8")):
            assert time.monotonic() < end_s, "the frame did not start"
            time.sleep(0.01)
        yield Peer(port, log)
    finally:
        process.kill()
        process.wait()
