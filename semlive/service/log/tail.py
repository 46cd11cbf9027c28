"""A log that is being written, read as it grows.

Only control writes; everybody else reads what stands in whole chunks and waits for the rest. A segment's torn end is what is still to
come, until the next segment exists: then it is what a kill left, and what can be read of it is taken.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import BinaryIO

from mcap.records import Channel, Footer, Message, Metadata

from semlive.errors import BadLog
from semlive.formats.log.repair import SegmentSpan, scan_spans
from semlive.formats.log.writer import CONTINUED_METADATA, LogMessage, rewritten_in
from semlive.service.log.files import PARTIAL_SUFFIX, open_segment, segments

_MARK_BYTES = 48
# A recorder repeats at most what waits for an acknowledgement of the disk; by default no more messages than these.
_RECENT = 100_000


class LogReplaced(BadLog):
    """Another log lies where the one was that is being read."""


class LogTail:
    """Gives each message of a growing log once, in order, over renames, recoveries and new segments.

    Between two calls no file is kept open: an open file cannot be renamed everywhere.

    Args:
        log: one file, finished or not, or a run folder; it need not exist yet.
        on_damage: told one sentence for each damage that was passed over.
    """

    def __init__(self, log: Path, on_damage: Callable[[str], None] | None = None) -> None:
        self._log, self._tell = log, on_damage
        self._name: str | None = None
        self._identity: tuple[int, int] | None = None
        self._first: LogMessage | None = None
        self._mark: tuple[int, bytes] | None = None
        self._at = self._given = 0
        self._ended = self._continued = False
        self._channels: dict[int, str] = {}
        self._waiting: deque[LogMessage] = deque()
        self._recent: deque[int] = deque(maxlen=_RECENT)
        self._repeated: frozenset[int] = frozenset()

    @property
    def finished(self) -> bool:
        """The newest segment that there was at the last `poll` is finished, its writer did not go on in another, and all was given."""
        return self._ended and not self._continued and not self._waiting

    def poll(self) -> Iterator[LogMessage]:
        """What is new and stands in whole chunks; ends when there is no more for now.

        What was not taken from one iterator comes with the next.

        Raises:
            BadLog: a file of the log cannot be read or is not MCAP.
            LogReplaced: what was read so far is not this log any more.
        """
        while True:
            while self._waiting:
                yield self._waiting.popleft()
            path, is_newest = self._segment()
            if path is None:
                return
            before = self._at, self._name
            yield from self._read(path, is_newest)
            if is_newest and (self._at, self._name) == before:
                return
            if not is_newest:
                self._ended = False
                self._next_after(path)

    def _segment(self) -> tuple[Path | None, bool]:
        """The segment to read, and whether it is the newest."""
        try:
            found = segments(self._log) if self._log.is_dir() else (self._log,)
        except BadLog:
            return None, True
        if self._name is None and not found[0].exists():
            return None, True  # nothing there yet: it may become a file or a folder
        names = [path.name.removesuffix(PARTIAL_SUFFIX) for path in found]
        if self._name is None:
            self._begin(names[0])
        if self._name not in names:
            # Never back to the first segment: it would be that of another run whose folder was put here.
            return None, True
        place = names.index(self._name)
        return found[place], place == len(found) - 1

    def _next_after(self, path: Path) -> None:
        names = [one.name.removesuffix(PARTIAL_SUFFIX) for one in segments(self._log)]
        place = names.index(path.name.removesuffix(PARTIAL_SUFFIX)) + 1
        if place < len(names):
            self._begin(names[place])

    def _begin(self, name: str) -> None:
        self._name, self._identity, self._first, self._mark = name, None, None, None
        self._ended = self._continued = False
        self._at = self._given = 0
        self._channels = {}
        self._repeated = frozenset()

    def _read(self, path: Path, is_newest: bool) -> Iterator[LogMessage]:
        try:
            with open_segment(path) as stream:
                self._look(path, stream)
                for piece in [] if self._ended else scan_spans(stream, self._at):
                    if is_newest and self._may_still_come(piece, stream):
                        return
                    self._take(path, piece, stream)
                    while self._waiting:
                        yield self._waiting.popleft()
        except FileNotFoundError:
            return
        except OSError as exc:
            raise BadLog(f"{path}: cannot be read ({exc.strerror}); check the file and its permissions.") from exc
        except LogReplaced:
            raise
        except BadLog as exc:
            raise BadLog(f"{path}: {exc}") from exc

    def _look(self, path: Path, stream: BinaryIO) -> None:
        """A segment that was recovered is another file: what was given of the old one is passed over."""
        identity = _identity(stream)
        if self._identity not in (None, identity) or self._is_other(stream):
            given, self._given = self._given, 0
            self._at, self._channels, self._ended, self._mark = 0, {}, False, None
            for piece in scan_spans(stream):
                self._at = piece.end
                told = self._messages(piece)
                self._check_first(path, piece, told, stream)
                self._give(islice(told, max(0, given - self._given), None))
                self._given += len(told)
                if self._given >= given or piece.truncated:
                    break
        self._identity = identity

    @staticmethod
    def _may_still_come(piece: SegmentSpan, stream: BinaryIO) -> bool:
        # On a share a chunk's length may be seen before its content is.
        return piece.truncated or (piece.damage != "" and piece.end >= stream.seek(0, os.SEEK_END))

    def _is_other(self, stream: BinaryIO) -> bool:
        """Whether the chunk that was read first is not there any more: the number of a deleted file is soon given to another."""
        if self._mark is None:
            return False
        stream.seek(self._mark[0])
        return stream.read(_MARK_BYTES) != self._mark[1]

    def _take(self, path: Path, piece: SegmentSpan, stream: BinaryIO) -> None:
        self._at = piece.end
        told = self._messages(piece)
        self._check_first(path, piece, told, stream)
        self._given += len(told)
        self._give(told)
        self._ended = bool(piece.records) and isinstance(piece.records[0], Footer)
        if piece.damage and self._tell is not None:
            self._tell(f"{path.name}: {piece.damage}.")

    def _check_first(self, path: Path, piece: SegmentSpan, messages: list[LogMessage], stream: BinaryIO) -> None:
        """A segment that is read from its begin again begins as it did; by content, as some shares give a file a new identity at will."""
        if self._given or not messages:
            return
        if self._first not in (None, messages[0]):
            raise LogReplaced(f"{path}: was replaced by the log of another run while it was read; look at what became of the folder.")
        self._first = messages[0]
        # A whole chunk: its times and checksum stand in its first bytes.
        stream.seek(piece.start)
        self._mark = piece.start, stream.read(_MARK_BYTES)

    def _give(self, told: Iterable[LogMessage]) -> None:
        """Without those that this segment repeats and that were given from the preceding one."""
        new = [one for one in told if one.log_time_ns not in self._repeated]
        self._recent.extend(one.log_time_ns for one in new)
        self._waiting.extend(new)

    def _messages(self, piece: SegmentSpan) -> list[LogMessage]:
        told = []
        for record in piece.records:
            if isinstance(record, Channel):
                self._channels[record.id] = record.topic
            elif isinstance(record, Metadata):
                self._continued = self._continued or record.name == CONTINUED_METADATA
                if (after_ns := rewritten_in(record)) is not None:
                    self._repeated = frozenset(time_ns for time_ns in self._recent if time_ns > after_ns)
            elif isinstance(record, Message) and record.channel_id in self._channels:
                topic = self._channels[record.channel_id]
                told.append(LogMessage(topic, record.log_time, record.publish_time, record.sequence, record.data))
        return told


def follow(log: Path, poll_s: float = 0.1, on_damage: Callable[[str], None] | None = None) -> Iterator[LogMessage]:
    """Messages of a log as they come, until its newest segment is finished; waits for what is not there yet.

    Raises:
        BadLog: a file of the log cannot be read or is not MCAP.
    """
    tail = LogTail(log, on_damage)
    while True:
        yield from tail.poll()
        if tail.finished:
            return
        time.sleep(poll_s)


def _identity(stream: BinaryIO) -> tuple[int, int]:
    status = os.fstat(stream.fileno())
    return status.st_dev, status.st_ino
