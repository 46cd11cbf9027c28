"""MCAP logs over streams: writing that survives a kill after every flush, reading that goes on behind what was damaged.

Measured with mcap 1.6: its own writer with its default chunks of 1 MiB leaves 0 bytes of telemetry when it is killed;
`flush()` closes the chunk in progress, and everything flushed is kept. Nothing is compressed: SEM images gain 8 % at a
fifth of the speed, and every reader opens the log without a decompressor.

The writer is our own, because of where things stand: every chunk begins with the channels that it uses, the first two chunks of
a channel with its schema, and bytes (images, maps) stand alone in chunks of their own. So each chunk can be read when all others are
damaged, and an image costs one pass for its checksum and no copy.
"""

from __future__ import annotations

import contextlib
import json
import struct
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from io import RawIOBase
from itertools import islice
from typing import IO, Any

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
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

from semlive.formats.log.messages import RAW_TOPICS, TOPICS, Payload, schema_of, to_json, topic_of
from semlive.formats.log.repair import CHUNK_HEAD, MAGIC, channels_and_schemas, scan_spans
from semlive.formats.metadata.checksum import crc32
from semlive.inputs.json_text import parse_json

LIBRARY = "semlive"
RUN_METADATA = "semlive.run"
# Stands at the end of a segment that its writer ended to go on in the next.
CONTINUED_METADATA = "semlive.continued"
# Stands at the beginning of a segment that repeats messages of the one before, whose disk did not acknowledge them.
REWRITTEN_METADATA = "semlive.rewritten"
_CHUNK_BYTES = 64 * 1024
_SCHEMA_COPIES = 2
# The header, what the run is, what is rewritten.
_HEAD_PIECES = 4
_MESSAGE = struct.Struct("<BQHIQQ")


@dataclass(frozen=True, slots=True)
class LogMessage:
    """One message as it stands in a log.

    Attributes:
        topic: what it is about.
        log_time_ns: experiment time when it was recorded, strictly increasing through a run.
        publish_time_ns: experiment time of what it tells.
        sequence: counts messages of its topic, except where the topic says otherwise.
        payload: JSON, or bytes for raw topics.
    """

    topic: str
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    payload: bytes


@dataclass(slots=True)
class _OpenChannel:
    """A channel of the segment being written."""

    channel: Channel
    schema: Schema | None
    messages: int = 0
    chunks: int = 0


@dataclass(slots=True)
class _OpenChunk:
    """The chunk in progress: its content in parts, and for each channel where its messages stand."""

    parts: list[bytes] = field(default_factory=list)
    size: int = 0
    first_ns: int = 0
    last_ns: int = 0
    messages: int = 0
    places: dict[int, list[tuple[int, int]]] = field(default_factory=dict)

    def add(self, part: bytes) -> None:
        self.parts.append(part)
        self.size += len(part)


class _Index:
    """Packed records that are written at the segment's end; until then they lie aside, where there is such a place.

    A chunk ends with every flush, at least once a second: kept as objects, 0.7 kB each, those of a week would take 430 MB.
    """

    def __init__(self, aside: RawIOBase | None) -> None:
        self.records = 0
        self._aside, self._length = aside, 0
        self._waiting = bytearray()

    def add(self, record: bytes) -> None:
        self.records += 1
        self._waiting += record
        if self._aside is None or len(self._waiting) < _CHUNK_BYTES:
            return
        with contextlib.suppress(OSError):  # no room: it waits in memory
            self._aside.seek(self._length)
            written = self._aside.write(self._waiting) or 0
            del self._waiting[:written]
            self._length += written

    @property
    def length(self) -> int:
        """Bytes of all records."""
        return self._length + len(self._waiting)

    def cut(self, records: int, length: int) -> None:
        """Forget the records behind the first so many."""
        self.records = records
        del self._waiting[max(0, length - self._length) :]
        self._length = min(self._length, length)

    def pieces(self) -> Iterator[bytes]:
        if self._aside is not None:
            self._aside.seek(0)
            for at in range(0, self._length, _CHUNK_BYTES):
                yield self._aside.read(min(_CHUNK_BYTES, self._length - at)) or b""
        yield bytes(self._waiting)


@dataclass(frozen=True, slots=True)
class LogMark:
    """State of a `LogWriter` between two chunks, so that it can return to it.

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


class LogWriter:
    """Writes one segment of a log to a stream; knows every topic's schema.

    Args:
        stream: it goes to.
        aside: an unbuffered file of its own for what is written at the end, which grows with every chunk; in memory without.
    """

    def __init__(self, stream: IO[bytes], aside: RawIOBase | None = None) -> None:
        self._stream = stream
        self._channels: dict[str, _OpenChannel] = {}
        self._schemas = 0
        self._counts: Counter[str] = Counter()
        self._chunk = _OpenChunk()
        self._index = _Index(aside)
        self._metadata_indexes: list[MetadataIndex] = []
        self._first_ns = self._last_ns = 0
        stream.write(MAGIC + _packed(Header("", LIBRARY)))

    def write(self, topic: str, payload: Payload | bytes, log_time_ns: int, publish_time_ns: int, sequence: int | None = None) -> None:
        """Add one message; it is safe only after `flush`.

        Args:
            topic: one of `TOPICS` or `RAW_TOPICS`, or one that was adopted.
            payload: the topic's message, or bytes that already are its payload.
            log_time_ns: experiment time when it is recorded.
            publish_time_ns: experiment time of what it tells.
            sequence: for topics that give it a meaning; by default messages of the topic are counted.

        Raises:
            ValueError: the topic is unknown, the message belongs to another one, or a number is not finite.
        """
        data = payload if isinstance(payload, bytes) else _encode(topic, payload)
        one = self._channels.get(topic) or self._register(topic)
        number = self._counts[topic] if sequence is None else sequence
        self._counts[topic] += 1
        alone = one.channel.message_encoding != "json"
        if alone:
            self._close_chunk()
        self._add(one, data, log_time_ns, publish_time_ns, number & 0xFFFFFFFF)
        if alone or self._chunk.size > _CHUNK_BYTES:
            self._close_chunk()
        if topic == "/run":
            self.write_run_metadata(data)

    def register_channels(self, channel: Channel, schema: Schema | None) -> None:
        """Take a topic as another log has it, with that log's schema, so that its messages can be written as bytes."""
        own = None
        if schema is not None:
            self._schemas += 1
            own = replace(schema, id=self._schemas)
        number = len(self._channels) + 1
        self._channels[channel.topic] = _OpenChannel(replace(channel, id=number, schema_id=0 if own is None else own.id), own)

    def flush(self) -> None:
        """Close the chunk in progress and flush the stream: what was written so far survives a kill."""
        self._close_chunk()
        self._stream.flush()

    def write_run_metadata(self, payload: bytes) -> None:
        """What a run is, by its message, where every MCAP tool shows it."""
        try:
            told: dict[str, Any] = dict(parse_json(payload))
        except (ValueError, TypeError):  # of a damaged log that is being recovered
            return
        texts = {name: value if isinstance(value, str) else json.dumps(value, sort_keys=True) for name, value in told.items()}
        self._close_chunk()
        self._add_metadata(RUN_METADATA, texts)

    def tell_rewritten(self, after_log_time_ns: int) -> None:
        """State that this segment repeats all messages of the preceding one that are later than a log time, ns."""
        self._close_chunk()
        self._add_metadata(REWRITTEN_METADATA, {"after_log_time_ns": str(after_log_time_ns)})

    def mark(self) -> LogMark:
        """The present state; only directly after `flush`."""
        channels = {topic: (one.messages, one.chunks) for topic, one in self._channels.items()}
        index, metadata = self._index, len(self._metadata_indexes)
        return LogMark(self._stream.tell(), channels, index.records, index.length, metadata, self._first_ns, self._last_ns)

    def rewind(self, mark: LogMark) -> None:
        """Return to an earlier state; the caller cuts the stream to `mark.position` bytes."""
        self._chunk = _OpenChunk()
        self._channels = {topic: one for topic, one in self._channels.items() if topic in mark.channels}
        for topic, one in self._channels.items():
            one.messages, one.chunks = mark.channels[topic]
        self._schemas = sum(one.schema is not None for one in self._channels.values())
        self._index.cut(mark.index_records, mark.index_bytes)
        del self._metadata_indexes[mark.metadata :]
        self._first_ns, self._last_ns = mark.first_ns, mark.last_ns

    def finish(self, continued: bool = False) -> None:
        """Write index and footer; the stream stays open.

        Args:
            continued: the same writer goes on in another segment.
        """
        self._close_chunk()
        if continued:
            self._add_metadata(CONTINUED_METADATA, {})
        self._stream.write(_packed(DataEnd(0)))
        start = at = self._stream.tell()
        groups: list[tuple[Opcode, Iterable[bytes]]] = [
            (Opcode.SCHEMA, (_packed(one.schema) for one in self._channels.values() if one.schema is not None)),
            (Opcode.CHANNEL, (_packed(one.channel) for one in self._channels.values())),
            (Opcode.STATISTICS, (_packed(self._statistics()),)),
            (Opcode.CHUNK_INDEX, self._index.pieces()),
            (Opcode.METADATA_INDEX, (_packed(one) for one in self._metadata_indexes)),
        ]
        offsets, checksum = b"", 0
        for kind, packed in groups:
            begin = at
            for piece in packed:
                self._stream.write(piece)
                checksum, at = crc32(piece, checksum), at + len(piece)
            if at > begin:
                offsets += _packed(SummaryOffset(kind, begin, at - begin))
        footer = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, at)
        checksum = crc32(footer, crc32(offsets, checksum))
        self._stream.write(offsets + _packed(Footer(start, at, checksum)) + MAGIC)

    def _add(self, one: _OpenChannel, data: bytes, log_time_ns: int, publish_time_ns: int, number: int) -> None:
        chunk, channel = self._chunk, one.channel
        if channel.id not in chunk.places:
            if one.schema is not None and one.chunks < _SCHEMA_COPIES:
                chunk.add(_packed(one.schema))
            chunk.add(_packed(channel))
            chunk.places[channel.id] = []
            one.chunks += 1
        chunk.first_ns = min(chunk.first_ns, log_time_ns) if chunk.messages else log_time_ns
        chunk.last_ns = max(chunk.last_ns, log_time_ns)
        chunk.messages += 1
        chunk.places[channel.id].append((log_time_ns, chunk.size))
        one.messages += 1
        chunk.add(_MESSAGE.pack(Opcode.MESSAGE, 22 + len(data), channel.id, number, log_time_ns, publish_time_ns))
        chunk.add(data)

    def _close_chunk(self) -> None:
        chunk = self._chunk
        if not chunk.places:
            return
        self._chunk = _OpenChunk()
        # The last part is what may be large: an image is neither joined nor copied.
        small, last = b"".join(chunk.parts[:-1]), chunk.parts[-1]
        checksum = crc32(last, crc32(small))
        head = CHUNK_HEAD.pack(Opcode.CHUNK, CHUNK_HEAD.size - 1 + chunk.size, chunk.first_ns, chunk.last_ns, chunk.size, checksum, 0)
        start = self._stream.tell()
        self._stream.write(head + struct.pack("<Q", chunk.size) + small)
        self._stream.write(last)
        index_start, index, places = self._stream.tell(), b"", {}
        for channel, entries in chunk.places.items():
            places[channel] = index_start + len(index)
            index += _packed(MessageIndex(channel, entries))
        self._stream.write(index)
        if not self._index.records:
            self._first_ns, self._last_ns = chunk.first_ns, chunk.last_ns
        self._first_ns, self._last_ns = min(self._first_ns, chunk.first_ns), max(self._last_ns, chunk.last_ns)
        length = index_start - start
        told = ChunkIndex(length, start, "", chunk.size, chunk.last_ns, len(index), places, chunk.first_ns, chunk.size)
        self._index.add(_packed(told))

    def _add_metadata(self, name: str, texts: dict[str, str]) -> None:
        record = _packed(Metadata(name, texts))
        self._metadata_indexes.append(MetadataIndex(self._stream.tell(), len(record), name))
        self._stream.write(record)

    def _statistics(self) -> Statistics:
        counts = {one.channel.id: one.messages for one in self._channels.values()}
        return Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=counts,
            chunk_count=self._index.records,
            message_count=sum(counts.values()),
            message_end_time=self._last_ns,
            message_start_time=self._first_ns,
            metadata_count=len(self._metadata_indexes),
            schema_count=self._schemas,
        )

    def _register(self, topic: str) -> _OpenChannel:
        if topic not in TOPICS and topic not in RAW_TOPICS:
            raise ValueError(f"{topic} is not a topic of the log")
        told = schema_of(topic)
        schema = None if told is None else Schema(0, told[2], told[1], told[0])
        self.register_channels(Channel(0, topic, RAW_TOPICS.get(topic, "json"), {}, 0), schema)
        return self._channels[topic]


def read_messages(stream: IO[bytes], on_damage: Callable[[str], None] | None = None) -> Iterator[LogMessage]:
    """All messages of a segment in file order, without those that were damaged.

    Reading ends quietly where the segment was torn; a chunk whose checksum is wrong is left out. Both are told.

    Args:
        stream: the segment, seekable.
        on_damage: told one sentence fragment for each damage: what was met.

    Raises:
        BadLog: the stream is no MCAP file.
    """
    tell = on_damage or _ignore
    channels: dict[int, str] = {}
    looked = False
    for piece in scan_spans(stream):
        if piece.damage:
            tell(piece.damage)
        for record in piece.records:
            if isinstance(record, Channel):
                channels[record.id] = record.topic
            elif isinstance(record, Message):
                if record.channel_id not in channels and not looked:
                    # Older logs tell of a channel once, and that chunk was damaged.
                    looked = True
                    channels = {number: one.topic for number, one in channels_and_schemas(stream)[0].items()} | channels
                topic = channels.get(record.channel_id)
                if topic is None:
                    tell(f"a message of the unknown channel {record.channel_id}")
                    continue
                yield LogMessage(topic, record.log_time, record.publish_time, record.sequence, record.data)


def rewritten_after(stream: IO[bytes]) -> int | None:
    """Log time, ns, after which a segment repeats the messages of the preceding one; None if it repeats none."""
    for piece in islice(scan_spans(stream), _HEAD_PIECES):
        for record in piece.records:
            if isinstance(record, Metadata) and (after := rewritten_in(record)) is not None:
                return after
    return None


def rewritten_in(record: Metadata) -> int | None:
    """What `LogWriter.tell_rewritten` stated, if this is its record, ns."""
    told = record.metadata.get("after_log_time_ns", "") if record.name == REWRITTEN_METADATA else ""
    return int(told) if told.isdecimal() else None


def _packed(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


def _encode(topic: str, payload: Payload) -> bytes:
    if topic_of(payload) != topic:
        raise ValueError(f"{type(payload).__name__} does not belong to {topic}")
    return to_json(payload)


def _ignore(_: str) -> None:
    return None
