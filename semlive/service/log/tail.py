"""Reader of a log while it is being written.

Only control writes; readers read complete chunks and wait for more. An incomplete end of a segment is still being written until the next
segment exists. After that, it is the end of a killed process, and its readable messages are used.
"""

from __future__ import annotations

import os
import socket
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import BinaryIO

from mcap.records import Channel, Footer, Message, Metadata

from semlive.errors import BadLog, SemliveError
from semlive.formats.log.messages import RunMessage, from_json
from semlive.formats.log.reader import LogMessage, rewritten_in
from semlive.formats.log.records import CONTINUED_METADATA
from semlive.formats.log.segment_scan import SegmentSpan, scan_spans
from semlive.service.log.files import PARTIAL_SUFFIX, open_segment, segments
from semlive.service.log.lock import is_held

_MARK_BYTES = 48
# Upper limit of the number of messages that a recorder repeats because the disk has not acknowledged them.
_RECENT = 100_000
SILENT_S = 10.0
"""Time without a new message, s, after which it is checked whether a process still writes the log. A run writes several in a second."""
LOST_S = 900.0
"""Time without a new message, s, after which a log is given up whose process cannot be checked: it is on another computer, or not known
before the first message. An operator may think for minutes, and a share may be away for some.
"""


class LogReplaced(BadLog):
    """The log that is being read was replaced by another log."""


class LogAbandoned(SemliveError):
    """A log receives no further messages, although it is not finished."""


class LogTail:
    """Yields each message of a growing log once, in order, across renames, repairs and new segments.

    No file stays open between two calls, because some systems cannot rename an open file.

    Args:
        log: one file, finished or not, or a run folder; it need not exist yet.
        on_damage: callback with one sentence for each damage that was skipped.
    """

    def __init__(self, log: Path, on_damage: Callable[[str], None] | None = None) -> None:
        self._log, self._on_damage = log, on_damage
        self._name: str | None = None
        self._identity: tuple[int, int] | None = None
        self._first: LogMessage | None = None
        self._mark: tuple[int, bytes] | None = None
        self._at = self._yielded = 0
        self._ended = self._continued = False
        self._channels: dict[int, str] = {}
        self._waiting: deque[LogMessage] = deque()
        self._recent: deque[int] = deque(maxlen=_RECENT)
        self._repeated: frozenset[int] = frozenset()

    @property
    def finished(self) -> bool:
        """Whether the newest segment at the last `poll` is finished, has no successor, and was yielded completely."""
        return self._ended and not self._continued and not self._waiting

    def poll(self) -> Iterator[LogMessage]:
        """Yield the new messages in complete chunks; end when there are no more at present.

        Messages that one iterator did not yield are yielded by the next.

        Raises:
            BadLog: a file of the log cannot be read or is not MCAP.
            LogReplaced: another log has replaced the one that was read so far.
        """
        while True:
            while self._waiting:
                yield self._waiting.popleft()
            path, is_newest = self._segment()
            if path is None:
                return
            previous = self._at, self._name
            yield from self._read(path, is_newest)
            if is_newest and (self._at, self._name) == previous:
                return
            if not is_newest:
                self._ended = False
                self._next_after(path)

    def _segment(self) -> tuple[Path | None, bool]:
        """Return the segment to read, and whether it is the newest."""
        try:
            paths = segments(self._log) if self._log.is_dir() else (self._log,)
        except BadLog:
            return None, True
        if self._name is None and (not paths[0].exists() or paths[0].is_dir()):
            return None, True  # nothing exists yet, or a folder that was created after the first check: the next poll reads it
        names = [path.name.removesuffix(PARTIAL_SUFFIX) for path in paths]
        if self._name is None:
            self._begin(names[0])
        if self._name not in names:
            # The first segment is never read again: it would belong to another run whose folder was moved here.
            return None, True
        place = names.index(self._name)
        return paths[place], place == len(paths) - 1

    def _next_after(self, path: Path) -> None:
        names = [segment.name.removesuffix(PARTIAL_SUFFIX) for segment in segments(self._log)]
        place = names.index(path.name.removesuffix(PARTIAL_SUFFIX)) + 1
        if place < len(names):
            self._begin(names[place])

    def _begin(self, name: str) -> None:
        self._name, self._identity, self._first, self._mark = name, None, None, None
        self._ended = self._continued = False
        self._at = self._yielded = 0
        self._channels = {}
        self._repeated = frozenset()

    def _read(self, path: Path, is_newest: bool) -> Iterator[LogMessage]:
        try:
            with open_segment(path) as stream:
                self._check_identity(path, stream)
                for span in [] if self._ended else scan_spans(stream, self._at):
                    if is_newest and self._is_incomplete(span, stream):
                        return
                    self._add_span(path, span, stream)
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

    def _check_identity(self, path: Path, stream: BinaryIO) -> None:
        """Read a repaired segment, which is another file, and skip the messages that were already yielded."""
        identity = _identity(stream)
        if self._identity not in (None, identity) or self._first_chunk_changed(stream):
            yielded, self._yielded = self._yielded, 0
            self._at, self._channels, self._ended, self._mark = 0, {}, False, None
            for span in scan_spans(stream):
                self._at = span.end
                messages = self._messages(span)
                self._check_first(path, span, messages, stream)
                self._queue_new(islice(messages, max(0, yielded - self._yielded), None))
                self._yielded += len(messages)
                if self._yielded >= yielded or span.truncated:
                    break
        self._identity = identity

    @staticmethod
    def _is_incomplete(span: SegmentSpan, stream: BinaryIO) -> bool:
        # On a share, the length of a chunk may be visible before its content.
        return span.truncated or (span.damage != "" and span.end >= stream.seek(0, os.SEEK_END))

    def _first_chunk_changed(self, stream: BinaryIO) -> bool:
        """Whether the first chunk has changed; the inode number alone is not sufficient, because the system reuses it."""
        if self._mark is None:
            return False
        stream.seek(self._mark[0])
        return stream.read(_MARK_BYTES) != self._mark[1]

    def _add_span(self, path: Path, span: SegmentSpan, stream: BinaryIO) -> None:
        self._at = span.end
        messages = self._messages(span)
        self._check_first(path, span, messages, stream)
        self._yielded += len(messages)
        self._queue_new(messages)
        self._ended = bool(span.records) and isinstance(span.records[0], Footer)
        if span.damage and self._on_damage is not None:
            self._on_damage(f"{path.name}: {span.damage}.")

    def _check_first(self, path: Path, span: SegmentSpan, messages: list[LogMessage], stream: BinaryIO) -> None:
        """Check that a segment begins with the same content, because some network shares change the identity of a file."""
        if self._yielded or not messages:
            return
        if self._first not in (None, messages[0]):
            raise LogReplaced(f"{path}: was replaced by the log of another run while it was read; check what happened to the folder.")
        self._first = messages[0]
        # The head of the chunk contains its times and its checksum.
        stream.seek(span.start)
        self._mark = span.start, stream.read(_MARK_BYTES)

    def _queue_new(self, messages: Iterable[LogMessage]) -> None:
        """Queue messages, without those that this segment repeats from the preceding one."""
        new = [message for message in messages if message.log_time_ns not in self._repeated]
        self._recent.extend(message.log_time_ns for message in new)
        self._waiting.extend(new)

    def _messages(self, span: SegmentSpan) -> list[LogMessage]:
        messages = []
        for record in span.records:
            if isinstance(record, Channel):
                self._channels[record.id] = record.topic
            elif isinstance(record, Metadata):
                self._continued = self._continued or record.name == CONTINUED_METADATA
                if (after_ns := rewritten_in(record)) is not None:
                    self._repeated = frozenset(time_ns for time_ns in self._recent if time_ns > after_ns)
            elif isinstance(record, Message) and record.channel_id in self._channels:
                topic = self._channels[record.channel_id]
                messages.append(LogMessage(topic, record.log_time, record.publish_time, record.sequence, record.data))
        return messages


def follow(
    log: Path,
    poll_s: float = 0.1,
    on_damage: Callable[[str], None] | None = None,
    silent_s: float = SILENT_S,
    lost_s: float = LOST_S,
) -> Iterator[LogMessage]:
    """Yield the messages of a growing log until its newest segment is finished; waits for new messages.

    Args:
        log: one file, finished or not, or a run folder; it need not exist yet.
        poll_s: time between two looks at the log, s.
        on_damage: callback with one sentence for each damage that was skipped.
        silent_s: time without a new message after which a process of this computer is searched that writes the log, s.
        lost_s: longest time without a new message of a log whose process cannot be checked, s.

    Raises:
        BadLog: a file of the log cannot be read or is not MCAP.
        LogAbandoned: no message came for `silent_s`, and no process of this computer, on which the run began, writes the log; or none came
            for `lost_s`, and the run began on another computer, or has no first message.
    """
    tail, host = LogTail(log, on_damage), ""
    newest_s, ended, checked_s = time.monotonic(), False, time.monotonic()
    while True:
        for message in tail.poll():
            host = host or _host(message)
            yield message
            newest_s, ended = time.monotonic(), False
        if tail.finished:
            return
        now_s = time.monotonic()
        if ended:  # before this poll
            raise LogAbandoned(
                f"{log}: the process that wrote it has ended before the run did; resume the run with semlive run CONFIG --resume, "
                "or read the log as it is, without following it"
            )
        is_local = host == socket.gethostname()
        if not is_local and now_s - newest_s > lost_s:
            raise LogAbandoned(f"{log}: {_no_message(host)} for {lost_s / 60.0:.3g} min; {_CHECK_RUN if host else _CHECK_PATH}")
        if now_s - max(newest_s, checked_s) > silent_s:
            ended, checked_s = is_local and not is_held(log if log.is_dir() else log.parent), now_s
        time.sleep(poll_s)


_CHECK_RUN = "see whether the run there is in progress and the share is connected, then follow it again, or read it without following it"
_CHECK_PATH = "start the run, check that this is the folder of its log, then follow it again"


def _no_message(host: str) -> str:
    return f"no message came from the run on {host}" if host else "it has no message of a run, although it was awaited"


def _host(message: LogMessage) -> str:
    """Name of the computer of a run by its first message; empty for other messages."""
    if message.topic != "/run":
        return ""
    run = from_json(message.topic, message.payload)
    return run.host if isinstance(run, RunMessage) else ""


def _identity(stream: BinaryIO) -> tuple[int, int]:
    status = os.fstat(stream.fileno())
    return status.st_dev, status.st_ino
