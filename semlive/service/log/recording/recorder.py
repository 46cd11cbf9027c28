"""The recorder: the only writer of a log, in a separate thread with a bounded queue.

Policy: transitions, commands, files and results are flushed as soon as they are written and survive a kill. Transitions,
pairs, faults and original images are also synced and survive a loss of power. Telemetry is flushed once a second.
A disk that rejects writes is reported at once and retried every second; a disk that takes too long is reported as slow. The daemon
reads both from `backlog_message` and pauses the run: telemetry continues into memory, for 40 minutes at 20 readings a second, and
no message is discarded. When the queue is full, `write` raises, which stops the devices and ends the run.

A message stays in memory until an fsync that covers it has succeeded (at most 10 s or 64 MB beyond the queue); see `disk_writer` for
failed fsyncs. A segment is written as ``<name>.part`` and renamed when it is complete. A large segment is finished and a new one started,
so that a loss of power can damage, and a failed fsync can repeat, only the newest segment.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

from semlive.errors import BadConfig
from semlive.formats.log.messages import RAW_TOPICS, SEM_ORIGINAL, SEM_SIDECAR, TOPICS, Payload, to_json, topic_of
from semlive.formats.log.reader import LogMessage
from semlive.ports import ClockSource
from semlive.service.log.files import PARTIAL_SUFFIX
from semlive.service.log.recording.disk_state import DiskState
from semlive.service.log.recording.disk_writer import DiskWriter
from semlive.service.log.recording.message_queue import MessageQueue
from semlive.service.log.recording.stream import OpenRaw, open_new
from semlive.service.log.recording.unacknowledged import described

SYNCED = frozenset({"/run", "/snapshot", "/state", "/pair", "/fault", "/result", SEM_ORIGINAL, SEM_SIDECAR})
TELEMETRY = frozenset({"/load_frame/sample", "/stage/sample", "/log"})
MAX_MESSAGES = 50_000
FLUSH_EVERY_S = 1.0
RETRY_AFTER_S = 1.0
SLOW_AFTER_S = 5.0
SEGMENT_BYTES = 2 * 10**9


class Recorder:
    """Writes the log of a run, beginning with one of its segments.

    Args:
        path: the finished segment; it grows as ``<path>.part``.
        clock: experiment time, for log times.
        on_fault: callback with one sentence, in the recorder thread, when the disk rejects writes and when it accepts them again.
        open_raw: opens the growing file.
        max_messages: largest number of unwritten messages; beyond it `write` raises.
        retry_after_s: wall seconds between attempts to write to a disk that rejects writes.
        after_ns: log time of the last message of the earlier segments of the run; 0 without any.
        slow_after_s: wall seconds after which unwritten data mean that the log is behind.
        segment_bytes: size of a segment after which the next one begins.

    Raises:
        BadConfig: the segment cannot be created.
    """

    def __init__(
        self,
        path: Path,
        clock: ClockSource,
        on_fault: Callable[[str], None],
        *,
        open_raw: OpenRaw = open_new,
        max_messages: int = MAX_MESSAGES,
        retry_after_s: float = RETRY_AFTER_S,
        after_ns: int = 0,
        slow_after_s: float = SLOW_AFTER_S,
        segment_bytes: int = SEGMENT_BYTES,
    ) -> None:
        self._on_fault, self._slow_after_s, self._segment_bytes = on_fault, slow_after_s, segment_bytes
        self._queue = MessageQueue(clock, after_ns, max_messages)
        self._disk = DiskState()
        try:
            self._writer = DiskWriter(path, self._queue, self._disk, on_fault, open_raw, retry_after_s, after_ns)
        except OSError as exc:
            part = path.with_name(path.name + PARTIAL_SUFFIX)
            raise BadConfig(f"{part}: cannot be created ({exc.strerror}); name another run or folder.") from exc
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    @property
    def path(self) -> Path:
        """The newest segment, under its finished name."""
        return self._writer.path

    @property
    def part(self) -> Path:
        """The growing file of the newest segment."""
        return self._writer.part

    def write(self, topic: str, payload: Payload | bytes, publish_time_ns: int | None = None, sequence: int | None = None) -> LogMessage:
        """Record a message; returns at once, from any thread.

        Args:
            topic: topic of the message.
            payload: the message of the topic, or its bytes.
            publish_time_ns: experiment time of the content; now by default.
            sequence: for topics that give it a meaning; by default messages of the topic are counted.

        Returns:
            The message as stored in the log.

        Raises:
            ValueError: the topic is unknown, or the payload does not fit it.
            SemliveError: the disk has refused for so long that the queue is full, or the recorder is closed.
        """
        if topic not in TOPICS and topic not in RAW_TOPICS:
            raise ValueError(f"{topic} is not a topic of the log")
        if not isinstance(payload, bytes) and topic_of(payload) != topic:
            raise ValueError(f"{type(payload).__name__} does not belong to {topic}")
        data = payload if isinstance(payload, bytes) else to_json(payload)
        return self._queue.put(self.path, topic, data, publish_time_ns, sequence)

    @property
    def backlog_message(self) -> str | None:
        """Why new messages will not be on the disk soon, a clause; None while the log keeps up."""
        return self._disk.message(self.part, self._queue.backlog, self._slow_after_s)

    @property
    def write_failed(self) -> bool:
        """Whether written data do not reach the disk, or not the file that readers open."""
        return self._disk.write_failed

    def flush(self, timeout_s: float = 10.0) -> bool:
        """Wait until everything written so far is on the disk; False after the timeout."""
        written = self._queue.put_event()
        return self._writer.is_complete if written is None else written.wait(timeout_s)

    @property
    def unacknowledged(self) -> str:
        """Messages that no successful fsync covers yet, by topic, image file and time."""
        return described(self._queue.unacknowledged())

    def close(self, timeout_s: float = 10.0, refused_s: float = float("inf")) -> bool:
        """Finish the segment and rename it; may be called repeatedly.

        Args:
            timeout_s: longest wait, wall seconds.
            refused_s: longest wait while the disk rejects writes, wall seconds.

        Returns:
            True if the complete segment is on the disk; False if the disk still refused after `timeout_s`: the part that it
            accepted stays as ``.part``.
        """
        self._queue.close()
        accepted_s = began_s = time.monotonic()
        while self._thread.is_alive() and (now_s := time.monotonic()) < min(began_s + timeout_s, accepted_s + refused_s):
            self._thread.join(min(0.1, began_s + timeout_s - now_s))
            accepted_s = accepted_s if self.write_failed else time.monotonic()
        return self._writer.is_complete

    def _run(self) -> None:
        try:
            self._work()
        except Exception as exc:
            self._queue.reject()
            self._on_fault(f"{self.part}: the recorder failed ({type(exc).__name__}: {exc}); stop the run and report this.")
            raise
        finally:
            self._writer.close()

    def _work(self) -> None:
        flushed_at_s = checked_at_s = time.monotonic()
        closing = False
        while not closing:
            batch = self._queue.next_batch(flushed_at_s + FLUSH_EVERY_S)
            messages = [item for item in batch if isinstance(item, LogMessage)]
            waiters = [item for item in batch if isinstance(item, threading.Event)]
            closing = None in batch
            self._writer.write(messages)
            topics = {message.topic for message in messages}
            if closing:
                self._writer.finish(continued=False)
            elif waiters or topics - TELEMETRY or time.monotonic() >= flushed_at_s + FLUSH_EVERY_S:
                self._writer.save(sync=bool(waiters) or not topics.isdisjoint(SYNCED) or self._writer.sync_is_due)
                flushed_at_s = time.monotonic()
            if not closing and self._writer.size > self._segment_bytes:
                self._writer.begin_next()
            if not closing and time.monotonic() >= checked_at_s + FLUSH_EVERY_S:
                self._writer.check_file()
                checked_at_s = time.monotonic()
            self._queue.mark_written(len(messages), sum(len(message.payload) for message in messages))
            for waiter in waiters:
                waiter.set()
