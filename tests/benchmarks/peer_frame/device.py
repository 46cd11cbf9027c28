"""A load frame as a process of its own: started, switched into faults over UDP, and asked for its true state."""

from __future__ import annotations

import contextlib
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from .truth import Entry, Reading, read_log

SAMPLED_EVERY_S = 0.02
_STARTED_WITHIN_S = 10.0


def free_port() -> int:
    """A port number that is free for TCP and for UDP on this computer."""
    while True:
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as tcp, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            tcp.bind(("127.0.0.1", 0))
            port: int = tcp.getsockname()[1]
            with contextlib.suppress(OSError):
                udp.bind(("127.0.0.1", port))
                return port


class Device:
    """A running load frame.

    Args:
        command: makes the command line from port and log.
        folder: where its log is written.
    """

    def __init__(self, command: Callable[[int, Path], list[str]], folder: Path) -> None:
        self.port = free_port()
        self.log = folder / "device.log"
        self.samples = list[Reading]()
        self._over = threading.Event()
        with (folder / "device.txt").open("wb") as output:
            self._process = subprocess.Popen(command(self.port, self.log), stdin=subprocess.DEVNULL, stdout=output, stderr=output)
        self._thread = threading.Thread(target=self._sample, daemon=True)
        end_s = time.monotonic() + _STARTED_WITHIN_S
        while self.state() is None:
            if self._process.poll() is not None or time.monotonic() > end_s:
                self.close()
                raise RuntimeError(f"the load frame at port {self.port} did not start; look at {self.log}")
        self._thread.start()

    def entries(self) -> list[Entry]:
        """Its log so far."""
        return read_log(self.log)

    def switch(self, command: str) -> float:
        """Set a fault switch or a value.

        Returns:
            When it was sent, CLOCK_MONOTONIC, s.
        """
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            at_s = time.monotonic()
            udp.sendto(command.encode(), ("127.0.0.1", self.port))
        return at_s

    def state(self) -> Reading | None:
        """The true state now; None if it does not answer within 0.2 s."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            udp.settimeout(0.2)
            udp.connect(("127.0.0.1", self.port))
            if udp.getsockname()[1] == self.port:  # this socket got the port before the device did, and would read its own question
                return None
            try:
                udp.send(b"?")
                words = udp.recv(500).split()
            except OSError:
                time.sleep(0.02)
                return None
        return Reading(float(words[0]), float(words[1]), float(words[2]), int(words[3]) != 0)

    def registers(self) -> dict[str, str]:
        """Named values that the device reports after its state; none if it does not answer within 5 s."""
        words = list[str]()
        with contextlib.suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            udp.settimeout(5.0)
            udp.connect(("127.0.0.1", self.port))
            udp.send(b"?")
            words = udp.recv(500).decode().split()
        return dict(word.split("=", 1) for word in words if "=" in word)

    def close(self) -> None:
        """End the process."""
        self._over.set()
        if self._thread.is_alive():
            self._thread.join()
        self._process.kill()
        self._process.wait()

    def _sample(self) -> None:
        while not self._over.wait(SAMPLED_EVERY_S):
            if (now := self.state()) is not None:
                self.samples.append(now)


@contextlib.contextmanager
def running(command: Callable[[int, Path], list[str]], folder: Path) -> Iterator[Device]:
    """A device for as long as the context lasts."""
    device = Device(command, folder)
    try:
        yield device
    finally:
        device.close()
