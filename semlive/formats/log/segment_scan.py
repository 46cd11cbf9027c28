"""Scan of a log segment: the records of all readable parts, and the damaged parts.

A chunk contains its length three times and a checksum of its content. A chunk with damaged content is skipped by its length. A chunk with
a damaged length or opcode is recognised by its other lengths and the checksum. Where the beginning of a record is missing, the scan
continues at the next bytes that look like the beginning of a chunk. Every chunk of semlive begins with its channels, so it can be read
when all others are lost.
"""

from __future__ import annotations

import os
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from typing import IO

from mcap.opcode import Opcode
from mcap.records import Channel, Footer, McapRecord, Message, Schema

from semlive.errors import BadLog
from semlive.formats.log.records import (
    CHUNK_HEAD,
    DAMAGE_ERRORS,
    FOOTER_BYTES,
    MAGIC,
    MAX_RECORD_BYTES,
    PRIVATE_OPCODE,
    RECORD_HEAD,
    ChunkHead,
    chunk_head,
    is_consistent_chunk,
    read_record,
    read_records,
)
from semlive.formats.metadata.checksum import crc32
from semlive.formats.metadata.expand import expanded
from semlive.inputs.json_text import parse_json

_SEARCHED_BYTES = 2**20
# No chunk has 2^40 bytes, so the upper three bytes of its length are zero.
_LOOKS_LIKE_A_CHUNK = re.compile(rb"(?s)(?=\x06.{5}\x00\x00\x00)")
_TRUNCATED = "truncated: EndOfFile"


@dataclass(frozen=True, slots=True)
class SegmentSpan:
    """A span of bytes of a segment: a record, a chunk or a damaged part.

    Attributes:
        start: first byte.
        end: byte after the last.
        records: records of the span; of a chunk, the records inside it.
        damage: description of the damage, a clause; empty without damage.
        truncated: no complete chunk follows; if the file is growing, more bytes may be written.
    """

    start: int
    end: int
    records: tuple[McapRecord, ...] = ()
    damage: str = ""
    truncated: bool = False


def scan_spans(stream: IO[bytes], at: int = 0) -> Iterator[SegmentSpan]:
    """Yield all spans of a segment in order, complete and damaged, up to the footer or the truncation.

    Complete messages of a truncated last chunk are returned if they are JSON; other payloads cannot be verified without the checksum.

    Args:
        stream: the segment; it must be seekable, and may be read and moved between two spans.
        at: first byte of a span; 0 is the beginning of the file.

    Raises:
        BadLog: the stream is no MCAP file, or the content of a chunk exceeds the size limit.
    """
    view = _View(stream)
    if at == 0:
        head = view.read(0, len(MAGIC))
        if head == MAGIC:
            at = len(MAGIC)
        elif MAGIC.startswith(head):
            yield SegmentSpan(0, view.size, (), "truncated: nothing was written yet", True)
            return
        else:
            begin = view.next_chunk(1)
            if begin is None:
                raise BadLog("not an MCAP file; give a log that semlive wrote.")
            yield SegmentSpan(0, begin, (), "the beginning of the file is damaged")
            at = begin
    while at < view.size:
        span = _span(view, at)
        yield span
        if span.truncated or (span.records and isinstance(span.records[0], Footer)):
            return
        at = span.end
    yield SegmentSpan(at, at, (), _TRUNCATED, True)


def summary(stream: IO[bytes]) -> tuple[McapRecord, ...]:
    """Return the records of the summary at the end of a finished segment; empty without a summary or with a wrong checksum."""
    view = _View(stream)
    at = view.size - FOOTER_BYTES
    tail = view.read(at, FOOTER_BYTES) if at > 0 else b""
    if tail[-8:] != MAGIC or tail[:9] != RECORD_HEAD.pack(Opcode.FOOTER, 20):
        return ()
    start, _, checksum = struct.unpack_from("<QQI", tail, 9)
    if not 0 < start <= at:
        return ()
    data = view.read(start, at - start)
    if checksum and crc32(tail[:25], crc32(data)) != checksum:
        return ()
    return tuple(read_records(data)[0])


def channels_and_schemas(stream: IO[bytes]) -> tuple[dict[int, Channel], dict[int, Schema]]:
    """Return all channels and schemas of a segment by number; those of the summary, which has a checksum, take precedence."""
    channels: dict[int, Channel] = {}
    schemas: dict[int, Schema] = {}
    for records in chain((summary(stream),), (span.records for span in scan_spans(stream))):
        for record in records:
            if isinstance(record, Channel):
                channels.setdefault(record.id, record)
            elif isinstance(record, Schema):
                schemas.setdefault(record.id, record)
    return channels, schemas


class _View:
    """A stream with random access."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        self.size = stream.seek(0, os.SEEK_END)

    def read(self, at: int, count: int) -> bytes:
        self._stream.seek(at)
        return self._stream.read(max(0, min(count, self.size - at)))

    def next_chunk(self, at: int) -> int | None:
        """Return the place of the next beginning of a chunk, or None."""
        while at < self.size:
            block = self.read(at, _SEARCHED_BYTES + CHUNK_HEAD.size + 12)
            for match in _LOOKS_LIKE_A_CHUNK.finditer(block, 0, min(len(block), _SEARCHED_BYTES + 9)):
                place = at + match.start()
                if match.start() < _SEARCHED_BYTES and is_consistent_chunk(self.read(place, CHUNK_HEAD.size + 12)):
                    return place
            at += _SEARCHED_BYTES
        return None


def _span(view: _View, at: int) -> SegmentSpan:
    head = view.read(at, CHUNK_HEAD.size + 12)
    is_consistent = is_consistent_chunk(head)
    if len(head) >= 9:
        kind, length = RECORD_HEAD.unpack_from(head)
        end = at + 9 + length
        if is_consistent and end > view.size and view.next_chunk(at + 1) is None:
            return _truncated_chunk(view, at)
        if kind != Opcode.CHUNK and end <= view.size and length <= MAX_RECORD_BYTES:
            records = read_record(kind, view.read(at + 9, length))
            if records is not None:
                return SegmentSpan(at, end, records)
        chunk = chunk_head(head)
        if chunk is not None:
            span = _chunk(view, at, chunk)
            if span is not None:
                return span
        if end <= view.size and is_consistent:
            return SegmentSpan(at, end, _before_garbage(view, at, end), "a chunk is damaged: its checksum is wrong")
        if end <= view.size and kind >= PRIVATE_OPCODE:
            return SegmentSpan(at, end)
    begin = view.next_chunk(at + 1)
    if begin is not None:
        return SegmentSpan(at, begin, (), "a chunk is damaged: its beginning cannot be read")
    is_truncated = view.size - at < CHUNK_HEAD.size + 8 or head[0] == Opcode.CHUNK
    return SegmentSpan(at, view.size, (), _TRUNCATED if is_truncated else "damaged: no complete chunk follows", True)


def _chunk(view: _View, at: int, chunk: ChunkHead) -> SegmentSpan | None:
    """Read a complete chunk by the length that its checksum confirms; None if it confirms none."""
    begin = at + chunk.head_bytes
    lengths = {chunk.length + 9 - chunk.head_bytes, chunk.stored, chunk.stored if chunk.compression else chunk.size}
    for stored in sorted(lengths):
        if not 0 < stored <= MAX_RECORD_BYTES or begin + stored > view.size:
            continue
        data = view.read(begin, stored)
        if chunk.compression:
            try:
                data = expanded(chunk.compression.decode(), data)
            except DAMAGE_ERRORS:
                continue
        if chunk.checksum and crc32(data) != chunk.checksum:
            continue
        records, is_complete = read_records(data)
        if is_complete:
            return SegmentSpan(at, begin + stored, tuple(records))
    return None


def _truncated_chunk(view: _View, at: int) -> SegmentSpan:
    return SegmentSpan(at, view.size, _json_records(view, at, view.size)[0], _TRUNCATED, True)


def _before_garbage(view: _View, at: int, end: int) -> tuple[McapRecord, ...]:
    """Return the records before the truncation of a last chunk whose end consists of random bytes.

    If all records are complete JSON although the checksum is wrong, one of them is damaged. It is unknown which, so none is returned.
    """
    if view.next_chunk(end) is not None:
        return ()
    records, is_complete = _json_records(view, at, end)
    return () if is_complete else records


def _json_records(view: _View, at: int, end: int) -> tuple[tuple[McapRecord, ...], bool]:
    """Return the records of a chunk before the first one that cannot be read or is not JSON, and whether all can be read."""
    chunk = chunk_head(view.read(at, CHUNK_HEAD.size + 12))
    if chunk is None or chunk.compression:
        return (), True
    records, is_complete = read_records(view.read(at + chunk.head_bytes, end - at - chunk.head_bytes))
    first_bad = next((n for n, record in enumerate(records) if isinstance(record, Message) and not _is_json(record.data)), None)
    return tuple(records[:first_bad]), is_complete and first_bad is None


def _is_json(data: bytes) -> bool:
    try:
        return data[:1] == b"{" and isinstance(parse_json(data), dict)
    except ValueError:
        return False
