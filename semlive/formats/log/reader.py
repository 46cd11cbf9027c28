"""Reading of log segments: reading continues behind damaged parts."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import IO

from mcap import records

from semlive.formats.log.records import REWRITTEN_METADATA
from semlive.formats.log.segment_scan import channels_and_schemas, scan_spans

# The header, the description of the run and the description of the rewritten messages.
_HEAD_SPANS = 4


@dataclass(frozen=True, slots=True)
class LogMessage:
    """A message of a log.

    Attributes:
        topic: topic of the message.
        log_time_ns: experiment time when it was recorded, strictly increasing within a run.
        publish_time_ns: experiment time of its content.
        sequence: number of the message within its topic, except for topics that define another meaning.
        payload: JSON, or bytes for raw topics.
    """

    topic: str
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    payload: bytes


def read_messages(stream: IO[bytes], on_damage: Callable[[str], None] | None = None) -> Iterator[LogMessage]:
    """Yield all undamaged messages of a segment in file order.

    Reading ends without an error where a segment is truncated. A chunk with a wrong checksum is skipped. `on_damage` receives both.

    Args:
        stream: the segment, seekable.
        on_damage: callback with a clause for each damage.

    Raises:
        BadLog: the stream is no MCAP file.
    """
    report = on_damage or _ignore
    channels: dict[int, str] = {}
    searched = False
    for span in scan_spans(stream):
        if span.damage:
            report(span.damage)
        for record in span.records:
            if isinstance(record, records.Channel):
                channels[record.id] = record.topic
            elif isinstance(record, records.Message):
                if record.channel_id not in channels and not searched:
                    # Older logs describe a channel in one chunk only, and that chunk is damaged.
                    searched = True
                    channels = {number: channel.topic for number, channel in channels_and_schemas(stream)[0].items()} | channels
                topic = channels.get(record.channel_id)
                if topic is None:
                    report(f"a message of the unknown channel {record.channel_id}")
                    continue
                yield LogMessage(topic, record.log_time, record.publish_time, record.sequence, record.data)


def rewritten_after(stream: IO[bytes]) -> int | None:
    """Return the log time, ns, after which a segment repeats the messages of the preceding one; None if it repeats none."""
    for span in islice(scan_spans(stream), _HEAD_SPANS):
        for record in span.records:
            if isinstance(record, records.Metadata) and (after_ns := rewritten_in(record)) is not None:
                return after_ns
    return None


def rewritten_in(record: records.Metadata) -> int | None:
    """Return the log time, ns, that `LogWriter.write_rewritten_metadata` wrote; None for other metadata."""
    text = record.metadata.get("after_log_time_ns", "") if record.name == REWRITTEN_METADATA else ""
    return int(text) if text.isdecimal() else None


def _ignore(_: str) -> None:
    return None
