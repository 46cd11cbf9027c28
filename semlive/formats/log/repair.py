"""What stands where in a segment of a log, whatever happened to it.

A chunk says its length three times and carries a checksum of its content. So a chunk whose content is damaged is passed
over by its length; one whose length, kind or both are damaged is found again by the other lengths and the checksum; and
where the beginning of a record is gone, reading goes on at the next place that looks like the beginning of a chunk. Every
chunk that semlive writes begins with the channels it uses, so it can be read when all others are gone.
"""

from __future__ import annotations

import os
import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from itertools import chain
from typing import IO, cast

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from semlive.errors import BadLog
from semlive.formats.metadata.checksum import crc32
from semlive.formats.metadata.expand import expanded
from semlive.inputs.json_text import parse_json

MAGIC = b"\x89MCAP0\r\n"
_RECORD = struct.Struct("<BQ")
# Kind, length, first and last log time, size, checksum, and the length of the compression's name.
CHUNK_HEAD = struct.Struct("<BQQQQII")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_FOOTER_BYTES = 9 + 20 + 8
_SEARCHED_BYTES = 2**20
# No chunk of 2^40 bytes is ever written, so the upper three bytes of its length are zero.
_LOOKS_LIKE_A_CHUNK = re.compile(rb"(?s)(?=\x06.{5}\x00\x00\x00)")
_COMPRESSIONS = (b"", b"lz4", b"zstd")
_PRIVATE = 0x80
MOST_STORED_BYTES = 2**31
"""Size of a stored record that is still read: an image of 32768 x 24576 px at 16 bit has 1.6e9 bytes. Whoever says more is damaged."""
_DAMAGE = (McapError, struct.error, ValueError, OverflowError, MemoryError)

_Read = Callable[[ReadDataStream], McapRecord]
_PLAIN: dict[int, _Read] = {
    Opcode.HEADER: Header.read,
    Opcode.FOOTER: Footer.read,
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.MESSAGE_INDEX: MessageIndex.read,
    Opcode.CHUNK_INDEX: ChunkIndex.read,
    Opcode.ATTACHMENT: Attachment.read,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex.read,
    Opcode.STATISTICS: Statistics.read,
    Opcode.METADATA: Metadata.read,
    Opcode.METADATA_INDEX: MetadataIndex.read,
    Opcode.SUMMARY_OFFSET: SummaryOffset.read,
    Opcode.DATA_END: DataEnd.read,
}


@dataclass(frozen=True, slots=True)
class SegmentSpan:
    """Some bytes of a segment, and what was read from them.

    Attributes:
        start: first byte.
        end: byte after the last.
        records: what stands there; of a chunk, what stands in it.
        damage: what is wrong, a fragment of a sentence; empty if nothing is.
        truncated: no whole chunk follows: in a file that grows, the rest may still come.
    """

    start: int
    end: int
    records: tuple[McapRecord, ...] = ()
    damage: str = ""
    truncated: bool = False


def scan_spans(stream: IO[bytes], at: int = 0) -> Iterator[SegmentSpan]:
    """All pieces of a segment in order, whole and damaged, up to the footer or the tear.

    Messages that stand whole in a torn last chunk are given if they are JSON; nothing vouches for the others.

    Args:
        stream: the segment; it must be seekable, and may be read and moved between two pieces.
        at: where a piece begins; 0 is the beginning of the file.

    Raises:
        BadLog: the stream is no MCAP file, or a chunk expands to more than is read.
    """
    view = _View(stream)
    if at == 0:
        head = view.read(0, len(MAGIC))
        if head == MAGIC:
            at = len(MAGIC)
        elif MAGIC.startswith(head):
            yield SegmentSpan(0, view.size, (), "torn: nothing was written yet", True)
            return
        else:
            found = view.next_chunk(1)
            if found is None:
                raise BadLog("not an MCAP file; give a log that semlive wrote.")
            yield SegmentSpan(0, found, (), "the beginning of the file is damaged")
            at = found
    while at < view.size:
        piece = _piece(view, at)
        yield piece
        if piece.truncated or (piece.records and isinstance(piece.records[0], Footer)):
            return
        at = piece.end
    yield SegmentSpan(at, at, (), "torn: EndOfFile", True)


def summary(stream: IO[bytes]) -> tuple[McapRecord, ...]:
    """Records of the summary at the end of a finished segment; empty if it is not there or its checksum is wrong."""
    view = _View(stream)
    at = view.size - _FOOTER_BYTES
    tail = view.read(at, _FOOTER_BYTES) if at > 0 else b""
    if tail[-8:] != MAGIC or tail[:9] != _RECORD.pack(Opcode.FOOTER, 20):
        return ()
    start, _, checksum = struct.unpack_from("<QQI", tail, 9)
    if not 0 < start <= at:
        return ()
    data = view.read(start, at - start)
    if checksum and crc32(tail[:25], crc32(data)) != checksum:
        return ()
    return tuple(_inside(data)[0])


def channels_and_schemas(stream: IO[bytes]) -> tuple[dict[int, Channel], dict[int, Schema]]:
    """Every channel and schema that stands anywhere in a segment, by its number; those with a checksum come first."""
    channels: dict[int, Channel] = {}
    schemas: dict[int, Schema] = {}
    for records in chain((summary(stream),), (piece.records for piece in scan_spans(stream))):
        for record in records:
            if isinstance(record, Channel):
                channels.setdefault(record.id, record)
            elif isinstance(record, Schema):
                schemas.setdefault(record.id, record)
    return channels, schemas


class _View:
    """A stream that is read by places."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        self.size = stream.seek(0, os.SEEK_END)

    def read(self, at: int, count: int) -> bytes:
        self._stream.seek(at)
        return self._stream.read(max(0, min(count, self.size - at)))

    def next_chunk(self, at: int) -> int | None:
        """Where the next beginning of a chunk stands, or None."""
        while at < self.size:
            block = self.read(at, _SEARCHED_BYTES + CHUNK_HEAD.size + 12)
            for match in _LOOKS_LIKE_A_CHUNK.finditer(block, 0, min(len(block), _SEARCHED_BYTES + 9)):
                place = at + match.start()
                if match.start() < _SEARCHED_BYTES and _agreeing(self.read(place, CHUNK_HEAD.size + 12)):
                    return place
            at += _SEARCHED_BYTES
        return None


@dataclass(frozen=True, slots=True)
class _ChunkHead:
    length: int
    size: int
    stored: int
    checksum: int
    compression: bytes

    @property
    def head_bytes(self) -> int:
        return CHUNK_HEAD.size + len(self.compression) + 8


def _chunk_head(head: bytes) -> _ChunkHead | None:
    """The beginning of a chunk, whatever it says of its kind; None if there is too little of it."""
    if len(head) < CHUNK_HEAD.size + 8:
        return None
    _, length, _, _, size, checksum, name = CHUNK_HEAD.unpack_from(head)
    # A damaged length of the name: semlive's chunks have none.
    compression = head[CHUNK_HEAD.size : CHUNK_HEAD.size + name] if name in (3, 4) else b""
    if compression not in _COMPRESSIONS or len(head) < CHUNK_HEAD.size + len(compression) + 8:
        compression = b""
    (stored,) = struct.unpack_from("<Q", head, CHUNK_HEAD.size + len(compression))
    return _ChunkHead(length, size, stored, checksum, compression)


def _agreeing(head: bytes) -> bool:
    """Whether what a chunk says of its lengths agrees."""
    chunk = _chunk_head(head)
    if chunk is None or head[0] != Opcode.CHUNK:
        return False
    name = struct.unpack_from("<I", head, CHUNK_HEAD.size - 4)[0]
    lengths = chunk.length + 9 == chunk.head_bytes + chunk.stored and name == len(chunk.compression)
    return lengths and (chunk.compression != b"" or chunk.size == chunk.stored)


def _piece(view: _View, at: int) -> SegmentSpan:
    head = view.read(at, CHUNK_HEAD.size + 12)
    agreeing = _agreeing(head)
    if len(head) >= 9:
        kind, length = _RECORD.unpack_from(head)
        end = at + 9 + length
        if agreeing and end > view.size and view.next_chunk(at + 1) is None:
            return _torn_chunk(view, at)
        if kind != Opcode.CHUNK and end <= view.size and length <= MOST_STORED_BYTES:
            records = _plain(kind, view.read(at + 9, length))
            if records is not None:
                return SegmentSpan(at, end, records)
        chunk = _chunk_head(head)
        if chunk is not None:
            piece = _chunk(view, at, chunk)
            if piece is not None:
                return piece
        if end <= view.size and agreeing:
            return SegmentSpan(at, end, _before_rubbish(view, at, end), "a chunk is damaged: its checksum is wrong")
        if end <= view.size and kind >= _PRIVATE:
            return SegmentSpan(at, end)
    found = view.next_chunk(at + 1)
    if found is not None:
        return SegmentSpan(at, found, (), "a chunk is damaged: its beginning cannot be read")
    torn = "torn: EndOfFile" if view.size - at < CHUNK_HEAD.size + 8 or head[0] == Opcode.CHUNK else "damaged: no whole chunk follows"
    return SegmentSpan(at, view.size, (), torn, True)


def _chunk(view: _View, at: int, chunk: _ChunkHead) -> SegmentSpan | None:
    """A whole chunk by whichever of its lengths its checksum confirms."""
    begin = at + chunk.head_bytes
    lengths = {chunk.length + 9 - chunk.head_bytes, chunk.stored, chunk.stored if chunk.compression else chunk.size}
    for stored in sorted(lengths):
        if not 0 < stored <= MOST_STORED_BYTES or begin + stored > view.size:
            continue
        data = view.read(begin, stored)
        if chunk.compression:
            try:
                data = expanded(chunk.compression.decode(), data)
            except _DAMAGE:
                continue
        if chunk.checksum and crc32(data) != chunk.checksum:
            continue
        records, is_whole = _inside(data)
        if is_whole:
            return SegmentSpan(at, begin + stored, tuple(records))
    return None


def _torn_chunk(view: _View, at: int) -> SegmentSpan:
    return SegmentSpan(at, view.size, _json_inside(view, at, view.size)[0], "torn: EndOfFile", True)


def _before_rubbish(view: _View, at: int, end: int) -> tuple[McapRecord, ...]:
    """What stood before the tear in a last chunk whose rest was filled up with rubbish.

    Where all its records stand one behind the other and all are JSON, one of them is wrong, and nobody knows which.
    """
    if view.next_chunk(end) is not None:
        return ()
    records, is_whole = _json_inside(view, at, end)
    return () if is_whole else records


def _json_inside(view: _View, at: int, end: int) -> tuple[tuple[McapRecord, ...], bool]:
    """What a chunk holds up to `end` before the first that cannot be read or is no JSON, and whether there is none such."""
    chunk = _chunk_head(view.read(at, CHUNK_HEAD.size + 12))
    if chunk is None or chunk.compression:
        return (), True
    records, is_whole = _inside(view.read(at + chunk.head_bytes, end - at - chunk.head_bytes))
    wrong = next((n for n, record in enumerate(records) if isinstance(record, Message) and not _is_json(record.data)), None)
    return tuple(records[:wrong]), is_whole and wrong is None


def _is_json(data: bytes) -> bool:
    try:
        return data[:1] == b"{" and isinstance(parse_json(data), dict)
    except ValueError:
        return False


def _plain(kind: int, body: bytes) -> tuple[McapRecord, ...] | None:
    """A record that is no chunk; None if it is not what it says it is."""
    if kind == Opcode.MESSAGE:
        return None if len(body) < _MESSAGE_HEAD.size else (_message(body),)
    read = _PLAIN.get(kind)
    if read is None:
        return None
    stream = ReadDataStream(BytesIO(body))
    try:
        record = read(stream)
    except _DAMAGE:
        return None
    return (record,) if stream.count == len(body) else None


def _inside(data: bytes) -> tuple[list[McapRecord], bool]:
    """Records that stand one behind the other, as far as they are whole, and whether they are to the end."""
    records: list[McapRecord] = []
    at, view = 0, memoryview(data)
    while at + 9 <= len(data):
        kind, length = _RECORD.unpack_from(data, at)
        body = view[at + 9 : at + 9 + length]
        if len(body) < length:
            return records, False
        if kind == Opcode.MESSAGE and length >= _MESSAGE_HEAD.size:
            records.append(_message(body))
        elif (plain := _plain(kind, bytes(body))) is not None:
            records.extend(plain)
        elif kind < _PRIVATE:
            return records, False
        at += 9 + length
    return records, at == len(data)


def _message(body: bytes | memoryview) -> Message:
    channel, sequence, log_time, publish_time = _MESSAGE_HEAD.unpack_from(body)
    return Message(channel, log_time, cast(bytes, bytes(body[_MESSAGE_HEAD.size :])), publish_time, sequence)
