"""A TESCAN microscope as its manual describes it: SharkSEM 2.0.22 and the reference of 3.2.20; shares no code with the driver.

Run as a program it prints its port and scans until its standard input is closed. Faults are attributes that a test sets.
"""

from __future__ import annotations

import contextlib
import random
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field


def packed(kind: str, value: object) -> bytes:
    """An argument of a reply."""
    if kind == "int":
        return struct.pack("<i", value)
    text = str(value).encode() + b"\0"
    return struct.pack("<I", len(text)) + text + b"\0" * (-len(text) % 4)


def noise(width: int, height: int, bits: int, seed: int) -> bytes:
    return random.Random(seed).randbytes(width * height * bits // 8)


@dataclass
class Microscope:
    """What the peer reports, how it scans, and which fault it has."""

    version: str = "3.2.20"
    beam: int = 1
    blanker: int = 2
    external: int = 0
    busy: int = 0
    live: int = 1
    speed: int = 3
    field_mm: float = 0.2
    rotation_deg: float = 0.0
    detector: int = 1
    frame_s: float = 0.05
    estimate_s: float | None = None
    after_scan: dict[str, object] = field(default_factory=dict)
    image: Callable[[int, int, int, int], bytes] = noise
    unanswered: str = ""
    wrong: dict[str, str] = field(default_factory=dict)
    """For a command, the fault of its reply: ``name``, ``identity``, ``short``, ``late``, ``text``, ``close``."""
    data_fault: str = ""
    """``close`` or ``silent`` in the middle of a frame; ``old`` frame first, ``twice``, ``outside``, ``short``, ``bits``."""
    result: int = 0
    commands: list[str] = field(default_factory=list)
    scans: list[tuple[int, ...]] = field(default_factory=list)


SPEEDS = "speed.1.dwell=0.32\nspeed.2.dwell=1.0\nspeed.3.dwell=3.2\nspeed.next=unknown"
MODES = "mode.0.name=RESOLUTION\nmode.1.name=DEPTH"
DETECTORS = "det.0.name=SE\ndet.0.detector=0\ndet.1.name=BSE\ndet.1.detector=1"
GEOMETRIES = "geom.0.name=Beam Shift\ngeom.0.count=2\ngeom.0.unit=mm\ngeom.3.name=Image Rotation\ngeom.3.count=1\ngeom.3.unit=deg"


class Peer:
    """Server of one client at a time, with a thread for each connection."""

    def __init__(self, microscope: Microscope) -> None:
        self.microscope = microscope
        self.control, self.data = _neighbours()
        self.port: int = self.control.getsockname()[1]
        self._data_link: socket.socket | None = None
        self._data_ready = threading.Event()
        self._registered = 0
        self._scanning = threading.Event()
        self._enabled: dict[int, int] = {}
        self._open: list[socket.socket] = []
        self._accepting = [threading.Thread(target=serve, daemon=True) for serve in (self._serve_control, self._serve_data)]
        for thread in self._accepting:
            thread.start()

    def close(self) -> None:
        _close(self.control, self.data)
        for thread in self._accepting:  # a connection accepted at this moment is among the open ones after it
            thread.join()
        _close(*self._open)

    def _serve_data(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                link, (_, port) = self.data.accept()
                self._open.append(link)
                if port == self._registered:  # the data connection is matched by the registered port
                    self._data_link = link
                    self._data_ready.set()

    def _serve_control(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                link, _ = self.control.accept()
                self._open.append(link)
                threading.Thread(target=self._client, args=(link,), daemon=True).start()

    def _client(self, link: socket.socket) -> None:
        with contextlib.suppress(OSError, EOFError):
            while True:
                name, size, identity, flags, queue, _ = struct.unpack("<16sIIHHI", _read(link, 32))
                body = _read(link, size)
                self._execute(link, name.rstrip(b"\0").decode(), body, identity, flags, queue)

    def _execute(self, link: socket.socket, name: str, body: bytes, identity: int, flags: int, queue: int) -> None:
        m = self.microscope
        m.commands.append(name)
        if name == m.unanswered:
            return
        if flags >> 8 & 1:  # Wait A: executed only when no scan is active
            while self._scanning.is_set():
                time.sleep(0.002)
        arguments = [int.from_bytes(body[at : at + 4], "little") for at in range(0, len(body), 4)]
        answer = self._answer(name, arguments)
        if answer is None and not flags & 1:
            return
        reply = b"".join(packed(kind, value) for kind, value in answer or ())
        fault = m.wrong.get(name, "")
        if fault == "late":
            time.sleep(1.0)
        elif fault == "text":
            reply = packed("text", "no number")
        elif fault == "close":
            link.sendall(struct.pack("<16sIIHHI", name.encode(), len(reply), identity, 0, queue, 0) + reply[:-1])
            link.shutdown(socket.SHUT_RDWR)
            return
        sent, number = ("TcpGetDevice" if fault == "name" else name), identity + (fault == "identity")
        reply = reply[:-4] if fault == "short" else reply
        link.sendall(struct.pack("<16sIIHHI", sent.encode(), len(reply), number, 0, queue, 0) + reply)

    def _answer(self, name: str, arguments: list[int]) -> tuple[tuple[str, object], ...] | None:
        m = self.microscope
        if name == "TcpRegDataPort":
            self._registered = arguments[0]
            self._data_ready.clear()
            return (("int", 0),)
        if name == "ScScanXY":
            m.scans.append(tuple(arguments))
            if not m.result:
                self._scanning.set()
                threading.Thread(target=self._scan, args=(arguments,), daemon=True).start()
            return (("int", m.result),)
        if name == "ScGetTimeEstEx":
            return (("text", m.frame_s if m.estimate_s is None else m.estimate_s),)
        if name == "DtEnable":
            self._enabled[arguments[0]] = arguments[2] if len(arguments) > 2 else 8
        if name == "GUISetScanning":
            m.live = arguments[0]
        if name == "ScStopScan":
            self._scanning.clear()
        if name in ("DtEnable", "GUISetScanning", "ScStopScan"):
            return None
        if name == "GetGeometry":
            return (("text", 0.0), ("text", 0.0)) if arguments[0] == 0 else (("text", m.rotation_deg), ("text", 0.0))
        return {
            "TcpGetVersion": (("text", m.version),),
            "TcpGetDevice": (("text", "VG1234567US"),),
            "HVGetBeam": (("int", m.beam),),
            "ScGetBlanker": (("int", m.blanker),),
            "ScGetExternal": (("int", m.external),),
            "IsBusy": (("int", int(bool(m.busy & sum(arguments)))),),
            "GetViewField": (("text", f"{m.field_mm:.6e}"),),
            "ScGetSpeed": (("int", m.speed),),
            "ScEnumSpeeds": (("text", SPEEDS),),
            "SMGetMode": (("int", 1),),
            "SMEnumModes": (("text", MODES),),
            "DtGetSelected": (("int", m.detector),),
            "DtEnumDetectors": (("text", DETECTORS),),
            "EnumGeometries": (("text", GEOMETRIES),),
            "GUIGetScanning": (("int", m.live),),
        }[name]

    def _scan(self, arguments: list[int]) -> None:
        m, (frame, width, height) = self.microscope, arguments[:3]
        bits = self._enabled.get(0, 8)
        self._data_ready.wait(5)
        link = self._data_link
        assert link is not None
        pixels, bytes_each = m.image(width, height, bits, len(m.scans)), bits // 8
        pieces = 20
        step = -(-width * height // pieces)
        with contextlib.suppress(OSError):
            if m.data_fault == "old":
                link.sendall(_scan_data(frame - 1, 0, bits, pixels[: step * bytes_each]))
                link.sendall(_named("Heartbeat", b"1234"))
            for number in range(pieces):
                time.sleep(m.frame_s / pieces)
                if not self._scanning.is_set():
                    return
                if number == pieces // 2 and m.data_fault in ("close", "silent"):
                    if m.data_fault == "close":
                        link.sendall(_scan_data(frame, number * step, bits, pixels[:step])[:50])
                        link.shutdown(socket.SHUT_RDWR)
                    return
                first = number * step
                piece = pixels[first * bytes_each : (first + step) * bytes_each]
                if m.data_fault == "outside":
                    first += width * height
                if m.data_fault == "twice" and number:
                    link.sendall(_scan_data(frame, first - 1, bits, b"\xff" * bytes_each))
                    link.sendall(_scan_data(frame, first - 1, bits, pixels[(first - 1) * bytes_each : first * bytes_each]))
                data = _scan_data(frame, first, 24 - bits if m.data_fault == "bits" else bits, piece)
                link.sendall(_named("ScData", data[32:-5]) if m.data_fault == "short" else data)
        for name, value in m.after_scan.items():
            setattr(m, name, value)
        self._scanning.clear()


def _close(*links: socket.socket) -> None:
    for link in links:
        with contextlib.suppress(OSError):
            link.shutdown(socket.SHUT_RDWR)
        link.close()


def _named(name: str, body: bytes) -> bytes:
    return struct.pack("<16sIIHHI", name.encode(), len(body), 0, 0, 0, 0) + body


def _scan_data(frame: int, index: int, bits: int, pixels: bytes) -> bytes:
    return _named("ScData", struct.pack("<IiIiI", frame, 0, index, bits, len(pixels)) + pixels)


def _read(link: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        piece = link.recv(size - len(data))
        if not piece:
            raise EOFError
        data += piece
    return data


def _neighbours() -> tuple[socket.socket, socket.socket]:
    """Two listening sockets with consecutive ports."""
    while True:
        control, data = socket.create_server(("127.0.0.1", 0)), socket.socket()
        try:
            data.bind(("127.0.0.1", control.getsockname()[1] + 1))
        except OSError:
            control.close()
            data.close()
            continue
        data.listen()
        return control, data


if __name__ == "__main__":
    peer = Peer(Microscope())
    print(peer.port, flush=True)  # noqa: T201
    sys.stdin.read()
