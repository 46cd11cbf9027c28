"""Pipe protocol of control and analysis: counts to the analysis; log messages and signs of life to control."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import IO

from semlive.errors import SemliveError
from semlive.formats.log.reader import LogMessage

# topic length, payload length, sequence, log time, publish time
_HEAD = struct.Struct("<HIIqq")
_COUNT = struct.Struct("<Q")

# Not a message of the log: who says it lives.
HEARTBEAT = LogMessage("", 0, 0, 0, b"")


def write_message(stream: IO[bytes], message: LogMessage) -> None:
    """Write one message and flush.

    Raises:
        OSError: the other end is gone.
    """
    topic = message.topic.encode("ascii")
    head = _HEAD.pack(len(topic), len(message.payload), message.sequence, message.log_time_ns, message.publish_time_ns)
    stream.write(head + topic + message.payload)
    stream.flush()


def read_message(stream: IO[bytes]) -> LogMessage | None:
    """Read one message; None at the end of the pipe.

    Raises:
        SemliveError: the pipe ended in the middle of a message.
    """
    head = stream.read(_HEAD.size)
    if not head:
        return None
    if len(head) < _HEAD.size:
        raise SemliveError("the pipe ended in the middle of a message; the other process died")
    topic_length, length, sequence, log_time_ns, publish_time_ns = _HEAD.unpack(head)
    topic, payload = stream.read(topic_length), stream.read(length)
    if len(topic) + len(payload) < topic_length + length:
        raise SemliveError("the pipe ended in the middle of a message; the other process died")
    return LogMessage(topic.decode("ascii"), log_time_ns, publish_time_ns, sequence, payload)


def write_count(stream: IO[bytes], count: int) -> None:
    """Write the present number of messages.

    Raises:
        OSError: the other end is gone.
    """
    stream.write(_COUNT.pack(count))
    stream.flush()


def read_counts(stream: IO[bytes]) -> Iterator[int]:
    """Yield every received count until the other end closes the pipe or ends."""
    while len(told := stream.read(_COUNT.size)) == _COUNT.size:
        yield _COUNT.unpack(told)[0]
