"""One segment that is being written: opened, written again elsewhere, cut back, and given its name."""

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
from semlive.service.log.stream import BufferedLogStream, OpenRaw, sync_folder
from semlive.service.log.unacknowledged import read_back

REWRITING = ".rewriting"
"""Ending of a segment that is being written again; it is not part of the log before it is complete."""


@dataclass(slots=True)
class Segment:
    """A segment that is being written.

    Attributes:
        path: its finished name.
        part: its name while it grows.
        stream: where its bytes go.
        writer: makes these bytes.
        aside: where the writer keeps the index until the end; None in memory.
        mark: state of the writer at the last successful fsync; None before the first.
    """

    path: Path
    part: Path
    stream: BufferedLogStream
    writer: LogWriter
    aside: RawIOBase | None
    mark: LogMark | None = None


def open_segment(path: Path, growing: Path, open_raw: OpenRaw, aside: RawIOBase | None) -> Segment:
    """Create a segment's file.

    Args:
        path: its finished name.
        growing: the name under which it is created.
        open_raw: opens the file.
        aside: scratch file for the index.

    Raises:
        OSError: the finished segment exists already, or the file cannot be created.
    """
    if path.exists():
        raise FileExistsError(0, "it exists already")
    stream = BufferedLogStream(open_raw(growing))
    return Segment(path, path.with_name(path.name + PARTIAL_SUFFIX), stream, LogWriter(stream.as_binary(), aside), aside)


def rewritten(path: Path, messages: Sequence[LogMessage], after_ns: int, run_message: bytes | None, open_raw: OpenRaw) -> Segment:
    """A new growing segment that repeats messages of the preceding one, synced and read back.

    Args:
        path: its finished name.
        messages: what it repeats.
        after_ns: log time of the last message of the preceding segment that is not repeated.
        run_message: payload of the run's `/run` message, if there was one.
        open_raw: opens the file.

    Raises:
        OSError: the disk refused, or returned other bytes when they were read back.
    """
    part = path.with_name(path.name + PARTIAL_SUFFIX)
    # An open file cannot be renamed on Windows.
    growing = part if os.name == "nt" else path.with_name(path.name + REWRITING)
    growing.unlink(missing_ok=True)
    segment = open_segment(path, growing, open_raw, scratch())
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


def cut_back(segment: Segment, run_message: bytes | None) -> None:
    """Finish a segment where it was last acknowledged; another continues it.

    Raises:
        OSError: the disk refused; the segment's file is closed and keeps its unfinished name.
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
        give_name(segment)
    finally:
        close(segment)


def give_name(segment: Segment) -> None:
    """Close a whole segment and give it its finished name; can be repeated.

    Raises:
        OSError: the system refused.
    """
    segment.stream.close()
    if segment.part.exists() or not segment.path.exists():  # otherwise it has its name, and only the folder's own fsync failed
        segment.part.replace(segment.path)
    sync_folder(segment.path.parent)


def close(segment: Segment) -> None:
    """Close a segment's files as they are."""
    with contextlib.suppress(OSError):
        segment.stream.close()
    if segment.aside is not None:
        segment.aside.close()


def scratch() -> RawIOBase | None:
    """A file without a name, gone with the process; None where the system gives none."""
    try:
        return cast(RawIOBase, tempfile.TemporaryFile(buffering=0))
    except OSError:
        return None
