"""Messages of SharkSEM: a header of 32 bytes and a body of arguments, little endian (manual, "Message Structure").

Header: name of the command (16 bytes, zero-terminated), size of the body (u32), identification (u32, copied into the reply), flags (u16),
queue (u16), reserved (4 bytes). An integer takes 4 bytes. A text is its size in bytes (u32) and its characters with a final zero, padded to
a multiple of four. A floating-point number is such a text. A map is a text with one ``key=value`` on each line.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from enum import IntFlag

from semlive.errors import LinkError

HEADER_BYTES = 32
MAX_BODY_BYTES = 2**26
"""Largest body that is accepted: 50 ms of image data at 16 bit are far below it."""
_HEADER = struct.Struct("<16sIIHHI")
_SCAN_DATA = struct.Struct("<IiIiI")


class Flag(IntFlag):
    """Flags in the header of a request."""

    REPLY = 1 << 0
    WAIT_SCAN = 1 << 8
    WAIT_STAGE = 1 << 9
    WAIT_OPTICS = 1 << 10
    WAIT_AUTOMATIC = 1 << 11


@dataclass(frozen=True, slots=True)
class Header:
    """Header of a message: name of the command, size of the body in bytes, and identification."""

    name: str
    body_bytes: int
    identity: int


def request(name: str, arguments: tuple[int, ...], identity: int, flags: Flag) -> bytes:
    """Return a request with integer arguments; no command of the trigger has others."""
    body = b"".join(struct.pack("<i" if value < 0 else "<I", value) for value in arguments)
    return _HEADER.pack(name.encode("ascii"), len(body), identity, flags, 0, 0) + body


def header(data: bytes) -> Header:
    """Return the header of a message.

    Raises:
        LinkError: the bytes are no header of SharkSEM.
    """
    raw, body_bytes, identity, _flags, _queue, _reserved = _HEADER.unpack(data)
    name, end, _ = raw.partition(b"\0")
    if not end or not name.isalnum() or body_bytes > MAX_BODY_BYTES:
        raise LinkError(f"sent no header of SharkSEM but {data[:16]!r}; is another program listening at this port?")
    return Header(name.decode("ascii"), body_bytes, identity)


class Body:
    """Arguments of a reply, read one after another; each method raises LinkError if the body ends before the value does."""

    def __init__(self, name: str, data: bytes) -> None:
        self._name, self._data, self._at = name, data, 0

    def integer(self) -> int:
        """A signed integer of 32 bit."""
        return struct.unpack("<i", self._take(4))[0]

    def text(self) -> str:
        """A text without its final zero."""
        size = struct.unpack("<I", self._take(4))[0]
        raw = self._take(size)
        self._at += -size % 4
        return raw.split(b"\0", 1)[0].decode("utf-8", errors="replace")

    def number(self) -> float:
        """A finite floating-point number."""
        text = self.text()
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise LinkError(f"answered {text[:40]!r} to {self._name}, which is no number")
        return value

    def map(self) -> dict[str, str]:
        """The pairs of a map."""
        pairs = (line.partition("=") for line in self.text().splitlines())
        return {key.strip(): value.strip() for key, mark, value in pairs if mark}

    def _take(self, size: int) -> bytes:
        piece = self._data[self._at : self._at + size]
        if len(piece) < size:
            raise LinkError(f"answered only {len(self._data)} bytes to {self._name}")
        self._at += size
        return piece


@dataclass(frozen=True, slots=True, eq=False)
class ScanData:
    """A message of the data connection: pixels of a frame, from `index` on, in the order of the scan."""

    frame: int
    channel: int
    index: int
    bits: int
    pixels: bytes


def scan_data(body: bytes) -> ScanData:
    """Return the content of a message ``ScData``.

    Raises:
        LinkError: the body is shorter than it states.
    """
    if len(body) < _SCAN_DATA.size:
        raise LinkError(f"sent a message of image data with only {len(body)} bytes")
    frame, channel, index, bits, size = _SCAN_DATA.unpack_from(body)
    pixels = body[_SCAN_DATA.size : _SCAN_DATA.size + size]
    if len(pixels) < size:
        raise LinkError(f"sent {len(pixels)} bytes of image data instead of {size}")
    return ScanData(frame, channel, index, bits, pixels)
