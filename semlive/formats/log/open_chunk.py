"""Parts of a segment that is being written: channels, the chunk in progress and the index."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from io import RawIOBase

from mcap.records import Channel, Schema

CHUNK_BYTES = 64 * 1024
"""Size after which a chunk is closed."""


@dataclass(slots=True)
class OpenChannel:
    """A channel of the segment being written."""

    channel: Channel
    schema: Schema | None
    messages: int = 0
    chunks: int = 0


@dataclass(slots=True)
class OpenChunk:
    """The chunk in progress: its content in parts, and the places (log time, offset) of the messages of each channel."""

    parts: list[bytes] = field(default_factory=list)
    size: int = 0
    first_ns: int = 0
    last_ns: int = 0
    messages: int = 0
    places: dict[int, list[tuple[int, int]]] = field(default_factory=dict)

    def add(self, part: bytes) -> None:
        """Append bytes to the content."""
        self.parts.append(part)
        self.size += len(part)


class SummaryIndex:
    """Packed records that are written at the end of the segment; until then they are stored in a scratch file, if there is one.

    A chunk ends with every flush, at least once a second. As Python objects of 0.7 kB each, the records of a week would need 430 MB.

    Args:
        scratch: an unbuffered file; None stores the records in memory.
    """

    def __init__(self, scratch: RawIOBase | None) -> None:
        self.records = 0
        self._scratch, self._length = scratch, 0
        self._pending = bytearray()

    def add(self, record: bytes) -> None:
        """Append a packed record."""
        self.records += 1
        self._pending += record
        if self._scratch is None or len(self._pending) < CHUNK_BYTES:
            return
        with contextlib.suppress(OSError):  # the disk is full: the records stay in memory
            self._scratch.seek(self._length)
            written = self._scratch.write(self._pending) or 0
            del self._pending[:written]
            self._length += written

    @property
    def length(self) -> int:
        """Size of all records, bytes."""
        return self._length + len(self._pending)

    def cut(self, records: int, length: int) -> None:
        """Discard all but the first `records` records, which have `length` bytes."""
        self.records = records
        del self._pending[max(0, length - self._length) :]
        self._length = min(self._length, length)

    def blocks(self) -> Iterator[bytes]:
        """Yield the bytes of all records in order."""
        if self._scratch is not None:
            self._scratch.seek(0)
            for at in range(0, self._length, CHUNK_BYTES):
                yield self._scratch.read(min(CHUNK_BYTES, self._length - at)) or b""
        yield bytes(self._pending)


@dataclass(frozen=True, slots=True)
class LogMark:
    """State of a `LogWriter` between two chunks, to which it can return.

    Attributes:
        position: bytes of the segment so far.
        channels: messages and chunks of each topic so far.
        index_records: records of the index so far.
        index_bytes: bytes of these records.
        metadata: metadata records so far.
        first_ns: log time of the first message, ns.
        last_ns: log time of the last message, ns.
    """

    position: int
    channels: Mapping[str, tuple[int, int]]
    index_records: int
    index_bytes: int
    metadata: int
    first_ns: int
    last_ns: int
