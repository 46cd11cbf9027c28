"""Writing of messages to the segments of a log; every operation is repeated while the disk rejects it.

When an fsync fails, or a write fails for another reason than lack of space, the system may have discarded everything since the last
successful fsync. These messages are written again to a new segment, synced and read back, and the old segment is truncated to the part
that was acknowledged.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

from semlive.formats.log.reader import LogMessage
from semlive.service.log.files import PARTIAL_SUFFIX, next_segment
from semlive.service.log.recording.disk_state import DiskState
from semlive.service.log.recording.message_queue import MessageQueue
from semlive.service.log.recording.segment import (
    Segment,
    close,
    finish_acknowledged,
    open_segment,
    rename_finished,
    rewritten,
    scratch_file,
)
from semlive.service.log.recording.stream import OpenRaw
from semlive.service.log.recording.unacknowledged import described, is_repeatable, remedy
from semlive.service.runtime.pause import pause

SYNC_EVERY_S = 10.0
SYNC_BYTES = 64 * 10**6
_WRITTEN_AGAIN = "{}: the log is being written again; the data that the disk had rejected were kept in memory and are written now."


class _Suspect(Exception):
    """The system may have discarded buffered data of the file of the segment."""

    def __init__(self, cause: OSError) -> None:
        super().__init__(str(cause.strerror or cause))
        self.cause = cause


class DiskWriter:
    """Writes the growing segment; to be called from the recorder thread only.

    Args:
        path: the finished segment; it grows as ``<path>.part``.
        queue: retains the messages until they are acknowledged.
        disk: receives the problems of the disk.
        on_fault: callback with one sentence when the disk rejects writes and when it accepts them again.
        open_raw: opens the growing file.
        retry_after_s: wall seconds between attempts to write to a disk that rejects writes.
        after_ns: log time of the last message of the earlier segments of the run; 0 without any.

    Raises:
        OSError: the segment cannot be created.
    """

    def __init__(
        self,
        path: Path,
        queue: MessageQueue,
        disk: DiskState,
        on_fault: Callable[[str], None],
        open_raw: OpenRaw,
        retry_after_s: float,
        after_ns: int,
    ) -> None:
        self.path = path
        self.is_complete = False
        self._queue, self._disk, self._on_fault = queue, disk, on_fault
        self._open_raw, self._retry_after_s = open_raw, retry_after_s
        self._run_message: bytes | None = None
        self._unsynced = self._unsynced_bytes = 0
        self._acknowledged_ns, self._acknowledged_at_s = after_ns, time.monotonic()
        scratch = scratch_file()
        try:
            self._segment = open_segment(path, self.part, open_raw, scratch)
        except OSError:
            if scratch is not None:
                scratch.close()
            raise

    @property
    def part(self) -> Path:
        """The growing file."""
        return self.path.with_name(self.path.name + PARTIAL_SUFFIX)

    @property
    def size(self) -> int:
        """Size of the segment so far, bytes."""
        return self._segment.stream.tell()

    @property
    def sync_is_due(self) -> bool:
        """Whether so much time or so many bytes have passed since the last fsync that the next save should sync."""
        is_late = time.monotonic() >= self._acknowledged_at_s + SYNC_EVERY_S
        return self._unsynced > 0 and (is_late or self._unsynced_bytes > SYNC_BYTES)

    def write(self, messages: Sequence[LogMessage]) -> None:
        """Add messages to the segment; `save` writes them to the disk."""
        for message in messages:
            self._segment.writer.write(message.topic, message.payload, message.log_time_ns, message.publish_time_ns, message.sequence)
            self._run_message = message.payload if message.topic == "/run" else self._run_message
        self._unsynced += len(messages)
        self._unsynced_bytes += sum(len(message.payload) for message in messages)

    def save(self, sync: bool) -> None:
        """Write everything to the disk; repeat while the disk rejects it."""
        self._retry(lambda: self._flush(sync, self._segment.writer.flush))

    def finish(self, continued: bool) -> None:
        """Finish and rename the segment; repeat while the disk rejects it, unless its folder was removed."""

        def complete() -> None:
            segment = self._segment
            if not segment.has_footer:
                self._flush(False, segment.writer.flush)
                segment.writer.finish(continued)
                segment.has_footer = True
            self._flush(True, segment.stream.flush)
            rename_finished(segment)
            self.is_complete = True

        self._segment.has_footer = False
        self._retry(complete)

    def begin_next(self) -> None:
        """Finish this segment and continue in the next one; repeat while the disk rejects it."""
        self.finish(continued=True)
        self.is_complete = False
        self.path = next_segment(self.path)
        self._segment = self._opened()
        if self._run_message is not None:
            self._segment.writer.write_run_metadata(self._run_message)
        self.save(sync=False)

    def check_file(self) -> None:
        """Check that readers find the written file, by name and size, because some network shares change the identity of a file."""
        try:
            size = self.part.stat().st_size
        except FileNotFoundError:
            self._disk.moved = True
            return
        except OSError:
            return  # the share is unavailable for a moment
        self._disk.moved = False
        self._disk.truncated = self._disk.truncated or size < self._segment.flushed_bytes

    def close(self) -> None:
        """Close the files of the segment in their present state."""
        close(self._segment)

    def _retry(self, operation: Callable[[], None]) -> None:
        """Repeat an operation until it succeeds; continue in a new segment if the present file is unreliable."""
        reported = False
        while True:
            try:
                try:
                    operation()
                except _Suspect as suspect:
                    self._segment.has_footer = False
                    self._rewrite(suspect.cause)
                    continue
            except OSError as exc:
                if not self.path.parent.is_dir():
                    self._disk.moved = True
                    self._on_fault(f"{self.path.parent}: the run's folder was removed, and the log with it; stop the run.")
                    return
                if not reported:
                    self._on_fault(f"{self.part}: the log cannot be written ({exc.strerror or exc}); {remedy(exc)}.")
                reported = True
                self._disk.refuse(exc)
                pause(self._retry_after_s)
            else:
                break
        self._disk.refused = ""
        if reported:
            self._on_fault(_WRITTEN_AGAIN.format(self.part))

    def _flush(self, sync: bool, flush: Callable[[], None]) -> None:
        """Flush everything to the system, and fsync it.

        Raises:
            OSError: there is no room; the same can be repeated.
            _Suspect: the system may have discarded data that were not acknowledged.
        """
        segment = self._segment
        try:
            flush()
        except OSError as exc:
            if is_repeatable(exc):
                raise
            raise _Suspect(exc) from exc
        segment.flushed_bytes = segment.stream.tell()
        if not sync:
            return
        try:
            segment.stream.sync()
        except OSError as exc:
            raise _Suspect(exc) from exc
        self._acknowledge(segment)

    def _acknowledge(self, segment: Segment) -> None:
        """Discard the stored messages that a successful fsync covers."""
        if not segment.has_footer:
            segment.mark = segment.writer.mark()
        last_ns = self._queue.acknowledge(self._unsynced)
        self._acknowledged_ns = self._acknowledged_ns if last_ns is None else last_ns
        self._unsynced = self._unsynced_bytes = 0
        self._acknowledged_at_s = time.monotonic()

    def _rewrite(self, cause: OSError) -> None:
        """Write all unacknowledged messages to a new segment and continue there; repeat while the disk rejects it.

        Raises:
            OSError: the folder of the run was removed.
        """
        old, path, reason = self._segment, next_segment(self.path), str(cause.strerror or cause)
        messages = self._queue.unacknowledged(self._unsynced)
        self._disk.refuse(cause)
        self._on_fault(
            f"{old.part}: the disk did not confirm what was written ({reason}), so it is kept in memory and written again into "
            f"{path.name}: {described(messages)}; {remedy(cause)}."
        )
        while True:
            try:
                new = rewritten(path, messages, self._acknowledged_ns, self._run_message, self._open_raw)
            except OSError as exc:
                if not path.parent.is_dir():
                    raise
                self._disk.refuse(exc)
                pause(self._retry_after_s)
            else:
                break
        self._segment, self.path = new, new.path
        new.flushed_bytes = new.stream.tell()
        self._acknowledge(new)
        try:
            finish_acknowledged(old, self._run_message)
            old_state = f"{old.path.name} ends where it was last confirmed"
        except OSError as exc:
            old_state = f"{old.part.name} stays unfinished ({exc.strerror or exc}) and can be recovered with `semlive recover`"
        self._disk.suspect()
        self._on_fault(
            f"{old.path.name}: {len(messages)} messages that its disk had not confirmed were written again into {new.path.name} "
            f"and read back from there; {old_state}; check the disk before you resume."
        )

    def _opened(self) -> Segment:
        while True:
            try:
                segment = open_segment(self.path, self.part, self._open_raw, self._segment.scratch)
            except OSError as exc:
                if not self._disk.refused:
                    problem = f"the log's next segment cannot be created ({exc.strerror or exc})"
                    self._on_fault(f"{self.part}: {problem}; {remedy(exc)}.")
                self._disk.refuse(exc)
                pause(self._retry_after_s)
            else:
                break
        if self._disk.refused:
            self._disk.refused = ""
            self._on_fault(_WRITTEN_AGAIN.format(self.part))
        return segment
