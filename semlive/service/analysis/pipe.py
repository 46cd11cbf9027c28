"""Pipe protocol of control and analysis: counts to the analysis; log messages, readiness and heartbeats to control."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import IO

from semlive.errors import SemliveError
from semlive.formats.log.reader import LogMessage

# kind, topic length, payload length, sequence, log time, publish time
_HEAD = struct.Struct("<BHIIqq")
_COUNT = struct.Struct("<Q")
_OUTPUT, _READY, _HEARTBEAT = 0, 1, 2

LOG_REPLACED = 4
"""Exit status of the analysis process if the log was replaced by the log of another run."""


@dataclass(frozen=True, slots=True)
class AnalysisReady:
    """The analysis has read the configuration of the run, compiled its kernels and analysed the pairs that the log already holds.

    Attributes:
        line: the line for `/log` that records it; one frame of the pipe carries both, so a crash cannot separate them.
    """

    line: LogMessage


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """The process of the analysis is alive; not an output, and not stored in the log."""


AnalysisOutput = LogMessage | AnalysisReady
"""An output of the analysis; control counts it, because a restarted analysis skips the outputs that the log already holds."""
PipeMessage = AnalysisOutput | Heartbeat
_NO_LINE = LogMessage("", 0, 0, 0, b"")


def write_message(stream: IO[bytes], message: PipeMessage) -> None:
    """Write one message and flush.

    Raises:
        OSError: the other end is closed.
    """
    match message:
        case AnalysisReady(line):
            kind = _READY
        case Heartbeat():
            kind, line = _HEARTBEAT, _NO_LINE
        case line:
            kind = _OUTPUT
    topic = line.topic.encode("ascii")
    head = _HEAD.pack(kind, len(topic), len(line.payload), line.sequence, line.log_time_ns, line.publish_time_ns)
    stream.write(head + topic + line.payload)
    stream.flush()


def read_message(stream: IO[bytes]) -> PipeMessage | None:
    """Read one message; None at the end of the pipe.

    Raises:
        SemliveError: the pipe ended in the middle of a message.
    """
    head = stream.read(_HEAD.size)
    if not head:
        return None
    if len(head) < _HEAD.size:
        raise SemliveError("the pipe ended in the middle of a message; the other process died")
    kind, topic_length, length, sequence, log_time_ns, publish_time_ns = _HEAD.unpack(head)
    topic, payload = stream.read(topic_length), stream.read(length)
    if len(topic) + len(payload) < topic_length + length:
        raise SemliveError("the pipe ended in the middle of a message; the other process died")
    if kind == _HEARTBEAT:
        return Heartbeat()
    line = LogMessage(topic.decode("ascii"), log_time_ns, publish_time_ns, sequence, payload)
    return AnalysisReady(line) if kind == _READY else line


def write_count(stream: IO[bytes], count: int) -> None:
    """Write the present number of messages.

    Raises:
        OSError: the other end is gone.
    """
    stream.write(_COUNT.pack(count))
    stream.flush()


def read_counts(stream: IO[bytes]) -> Iterator[int]:
    """Yield every received count until the other end closes the pipe or ends."""
    while len(packed := stream.read(_COUNT.size)) == _COUNT.size:
        yield _COUNT.unpack(packed)[0]
