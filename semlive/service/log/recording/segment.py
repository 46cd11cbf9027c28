"""Operations on a segment that is being written: open, write again to another segment, truncate, rename."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from io import RawIOBase
from pathlib import Path
from typing import cast

from semlive.formats.log.open_chunk import LogMark
from semlive.formats.log.reader import LogMessage
from semlive.formats.log.writer import LogWriter
from semlive.service.log.files import PARTIAL_SUFFIX
from semlive.service.log.recording.stream import BufferedLogStream, OpenRaw, sync_folder
from semlive.service.log.recording.unacknowledged import read_back

REWRITING = ".rewriting"
"""Ending of the name of a segment that is being written again; it belongs to the log only when it is complete."""


@dataclass(slots=True)
class Segment:
    """A segment that is being written.

    Attributes:
        path: finished name.
        part: name while it grows.
        stream: stream of its bytes to the disk.
        writer: writer of these bytes.
        scratch: file in which the writer stores the index until the end; None for memory.
        mark: state of the writer at the last successful fsync; None before the first.
        flushed_bytes: size of the data that the system has accepted, bytes.
        has_footer: index and footer are written.
    """

    path: Path
    part: Path
    stream: BufferedLogStream
    writer: LogWriter
    scratch: RawIOBase | None
    mark: LogMark | None = None
    flushed_bytes: int = 0
    has_footer: bool = False


def open_segment(path: Path, growing: Path, open_raw: OpenRaw, scratch: RawIOBase | None) -> Segment:
    """Create the file of a segment.

    Args:
        path: finished name.
        growing: name under which it is created.
        open_raw: opens the file.
        scratch: file for the index; None for memory.

    Raises:
        OSError: the finished segment exists already, or the file cannot be created.
    """
    if path.exists():
        raise FileExistsError(0, "it exists already")
    stream = BufferedLogStream(open_raw(growing))
    return Segment(path, path.with_name(path.name + PARTIAL_SUFFIX), stream, LogWriter(stream.as_binary(), scratch), scratch)


def rewritten(path: Path, messages: Sequence[LogMessage], after_ns: int, run_message: bytes | None, open_raw: OpenRaw) -> Segment:
    """Create a growing segment that repeats messages of the preceding one, synced and read back.

    Args:
        path: finished name.
        messages: the messages that it repeats.
        after_ns: log time of the last message of the preceding segment that is not repeated.
        run_message: payload of the `/run` message, None without one.
        open_raw: opens the file.

    Raises:
        OSError: the disk refused, or returned other bytes when they were read back.
    """
    part = path.with_name(path.name + PARTIAL_SUFFIX)
    # An open file cannot be renamed on Windows.
    growing = part if os.name == "nt" else path.with_name(path.name + REWRITING)
    growing.unlink(missing_ok=True)
    segment = open_segment(path, growing, open_raw, scratch_file())
    try:
        segment.writer.write_rewritten_metadata(after_ns)
        if run_message is not None:
            segment.writer.write_run_metadata(run_message)
        for message in messages:
            segment.writer.write(message.topic, message.payload, message.log_time_ns, message.publish_time_ns, message.sequence)
        segment.writer.flush()
        segment.stream.sync()
        read_back(growing, messages)
        if growing != part:
            growing.replace(part)
        sync_folder(part.parent)
    except OSError:
        close(segment)
        raise
    return segment


def finish_acknowledged(segment: Segment, run_message: bytes | None) -> None:
    """Truncate a segment to the part that was acknowledged and finish it; another segment continues it.

    Raises:
        OSError: the disk refused; the file of the segment is closed and keeps its unfinished name.
    """
    try:
        if segment.mark is None:
            segment.stream.cut(0)
            segment.writer = LogWriter(segment.stream.as_binary())
            if run_message is not None:
                segment.writer.write_run_metadata(run_message)
        else:
            segment.stream.cut(segment.mark.position)
            segment.writer.rewind(segment.mark)
        segment.writer.finish(continued=True)
        segment.stream.sync()
        rename_finished(segment)
    finally:
        close(segment)


def rename_finished(segment: Segment) -> None:
    """Close a complete segment and give it its finished name; can be repeated.

    Raises:
        OSError: the system refused.
    """
    segment.stream.close()
    if segment.part.exists() or not segment.path.exists():  # otherwise it has been renamed, and only the fsync of the folder failed
        segment.part.replace(segment.path)
    sync_folder(segment.path.parent)


def close(segment: Segment) -> None:
    """Close the files of a segment in their present state."""
    with contextlib.suppress(OSError):
        segment.stream.close()
    if segment.scratch is not None:
        segment.scratch.close()


def scratch_file() -> RawIOBase | None:
    """Open a temporary file without a name, which is deleted with the process; None where the system has none."""
    try:
        return cast(RawIOBase, tempfile.TemporaryFile(buffering=0))
    except OSError:
        return None
