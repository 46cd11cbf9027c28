"""Log messages over a pipe between control and analysis, exactly as they stand in the log."""

from __future__ import annotations

import struct
from typing import IO

from semlive.errors import SemliveError
from semlive.formats.log import LogMessage

# topic length, payload length, sequence, log time, publish time
_HEAD = struct.Struct("<HIIqq")


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
