"""Records of an MCAP segment: their binary layout, and reading of records from bytes that may be damaged."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from typing import cast

from mcap import records
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEAD = struct.Struct("<BQ")
# Opcode, length, first and last log time, size, checksum, and the length of the name of the compression.
CHUNK_HEAD = struct.Struct("<BQQQQII")
FOOTER_BYTES = 9 + 20 + 8
PRIVATE_OPCODE = 0x80
"""Smallest opcode of records that programs define for themselves."""
MAX_RECORD_BYTES = 2**31
"""Largest stored record that is read: an image of 32768 x 24576 px at 16 bit has 1.6e9 bytes. A larger length is damaged."""
DAMAGE_ERRORS = (McapError, struct.error, ValueError, OverflowError, MemoryError)
"""Errors of readers on damaged bytes."""

RUN_METADATA = "semlive.run"
CONTINUED_METADATA = "semlive.continued"
"""Metadata at the end of a segment whose writer continues in the next one."""
REWRITTEN_METADATA = "semlive.rewritten"
"""Metadata at the beginning of a segment that repeats messages of the preceding one, whose disk did not acknowledge them."""

_MESSAGE_HEAD = struct.Struct("<HIQQ")
_COMPRESSIONS = (b"", b"lz4", b"zstd")
_READERS: dict[int, Callable[[ReadDataStream], records.McapRecord]] = {
    Opcode.HEADER: records.Header.read,
    Opcode.FOOTER: records.Footer.read,
    Opcode.SCHEMA: records.Schema.read,
    Opcode.CHANNEL: records.Channel.read,
    Opcode.MESSAGE_INDEX: records.MessageIndex.read,
    Opcode.CHUNK_INDEX: records.ChunkIndex.read,
    Opcode.ATTACHMENT: records.Attachment.read,
    Opcode.ATTACHMENT_INDEX: records.AttachmentIndex.read,
    Opcode.STATISTICS: records.Statistics.read,
    Opcode.METADATA: records.Metadata.read,
    Opcode.METADATA_INDEX: records.MetadataIndex.read,
    Opcode.SUMMARY_OFFSET: records.SummaryOffset.read,
    Opcode.DATA_END: records.DataEnd.read,
}


@dataclass(frozen=True, slots=True)
class ChunkHead:
    """Lengths of a chunk as its head states them.

    Attributes:
        length: of the record, bytes.
        size: of the content after decompression, bytes.
        stored: size of the content in the file, bytes.
        checksum: CRC-32 of the content; 0 without one.
        compression: name of the compression; empty without one.
    """

    length: int
    size: int
    stored: int
    checksum: int
    compression: bytes

    @property
    def head_bytes(self) -> int:
        """Size of the head itself."""
        return CHUNK_HEAD.size + len(self.compression) + 8


def chunk_head(head: bytes) -> ChunkHead | None:
    """Read the head of a chunk, whatever its opcode; None if there are too few bytes."""
    if len(head) < CHUNK_HEAD.size + 8:
        return None
    _, length, _, _, size, checksum, name_bytes = CHUNK_HEAD.unpack_from(head)
    # Any other length of the name is damaged: the chunks of semlive have no compression.
    compression = head[CHUNK_HEAD.size : CHUNK_HEAD.size + name_bytes] if name_bytes in (3, 4) else b""
    if compression not in _COMPRESSIONS or len(head) < CHUNK_HEAD.size + len(compression) + 8:
        compression = b""
    (stored,) = struct.unpack_from("<Q", head, CHUNK_HEAD.size + len(compression))
    return ChunkHead(length, size, stored, checksum, compression)


def is_consistent_chunk(head: bytes) -> bool:
    """Whether bytes are the head of a chunk whose lengths agree."""
    chunk = chunk_head(head)
    if chunk is None or head[0] != Opcode.CHUNK:
        return False
    name_bytes = struct.unpack_from("<I", head, CHUNK_HEAD.size - 4)[0]
    lengths_agree = chunk.length + 9 == chunk.head_bytes + chunk.stored and name_bytes == len(chunk.compression)
    return lengths_agree and (chunk.compression != b"" or chunk.size == chunk.stored)


def read_record(kind: int, body: bytes) -> tuple[records.McapRecord, ...] | None:
    """Read a record that is not a chunk; None if its content does not fit its opcode."""
    if kind == Opcode.MESSAGE:
        return None if len(body) < _MESSAGE_HEAD.size else (_message(body),)
    read = _READERS.get(kind)
    if read is None:
        return None
    stream = ReadDataStream(BytesIO(body))
    try:
        record = read(stream)
    except DAMAGE_ERRORS:
        return None
    return (record,) if stream.count == len(body) else None


def read_records(data: bytes) -> tuple[list[records.McapRecord], bool]:
    """Read consecutive records up to the first incomplete one; return them and whether all are complete."""
    complete: list[records.McapRecord] = []
    at, view = 0, memoryview(data)
    while at + 9 <= len(data):
        kind, length = RECORD_HEAD.unpack_from(data, at)
        body = view[at + 9 : at + 9 + length]
        if len(body) < length:
            return complete, False
        if kind == Opcode.MESSAGE and length >= _MESSAGE_HEAD.size:
            complete.append(_message(body))
        elif (record := read_record(kind, bytes(body))) is not None:
            complete.extend(record)
        elif kind < PRIVATE_OPCODE:
            return complete, False
        at += 9 + length
    return complete, at == len(data)


def packed(record: records.McapRecord) -> bytes:
    """Return the bytes of a record."""
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


def _message(body: bytes | memoryview) -> records.Message:
    channel, sequence, log_time, publish_time = _MESSAGE_HEAD.unpack_from(body)
    return records.Message(channel, log_time, cast(bytes, bytes(body[_MESSAGE_HEAD.size :])), publish_time, sequence)
