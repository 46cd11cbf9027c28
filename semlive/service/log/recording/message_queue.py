"""Messages between the threads that record them and the recorder thread, retained until the disk acknowledges them."""

from __future__ import annotations

import queue
import threading
import time
from collections import Counter, deque
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from semlive.errors import SemliveError
from semlive.formats.log.reader import LogMessage
from semlive.ports import ClockSource

MAX_BYTES = 2**29
_BATCH = 1000
Item = LogMessage | threading.Event | None
"""A message, an event that is set when everything before it is on the disk, or None for the end."""


@dataclass(frozen=True, slots=True)
class Backlog:
    """Messages that are not written yet.

    Attributes:
        messages: number of messages.
        waits_s: wall seconds since the last batch was written; 0 without messages.
        is_large: whether the queue is more than a quarter full.
    """

    messages: int
    waits_s: float
    is_large: bool


class MessageQueue:
    """Bounded queue of messages; all methods may be called from any thread.

    Args:
        clock: experiment time, for log times.
        after_ns: log time of the last message of the earlier segments of the run; 0 without any.
        max_messages: largest number of unwritten messages; beyond it `put` raises.
    """

    def __init__(self, clock: ClockSource, after_ns: int, max_messages: int) -> None:
        self._clock, self._max_messages = clock, max_messages
        self._lock = threading.Lock()
        self._queue: queue.SimpleQueue[Item] = queue.SimpleQueue()
        self._counts: Counter[str] = Counter()
        self._last_log_time_ns = after_ns
        self._waiting_messages = self._waiting_bytes = 0
        self._waits_since_s = 0.0
        self._unacknowledged: deque[LogMessage] = deque()
        self._closed = False

    def put(self, log: Path, topic: str, data: bytes, publish_time_ns: int | None, sequence: int | None) -> LogMessage:
        """Append a message with the next log time.

        Args:
            log: path of the log, for error messages.
            topic: topic of the message.
            data: payload.
            publish_time_ns: experiment time of the content; None for now.
            sequence: number of the message; None counts messages of the topic.

        Raises:
            SemliveError: the queue is full or closed.
        """
        with self._lock:
            if self._closed:
                raise SemliveError(f"{log}: the log is closed; {topic} was not recorded.")
            if self._waiting_messages >= self._max_messages or self._waiting_bytes + len(data) > MAX_BYTES:
                raise SemliveError(f"{log}: {self._waiting_messages} messages wait to be written; make room on the disk.")
            now_ns = max(self._clock.now_ns(), self._last_log_time_ns + 1)
            number = self._counts[topic] if sequence is None else sequence
            message = LogMessage(topic, now_ns, now_ns if publish_time_ns is None else publish_time_ns, number, data)
            self._counts[topic] += 1
            self._last_log_time_ns = now_ns
            if self._waiting_messages == 0:
                self._waits_since_s = time.monotonic()
            self._waiting_messages += 1
            self._waiting_bytes += len(data)
            self._unacknowledged.append(message)
            self._queue.put(message)
        return message

    def put_event(self) -> threading.Event | None:
        """Append an event that is set when everything before it is on the disk; None if the queue is closed."""
        with self._lock:
            if self._closed:
                return None
            written = threading.Event()
            self._queue.put(written)
        return written

    def close(self) -> None:
        """Append the end of the queue; may be called repeatedly."""
        with self._lock:
            if not self._closed:
                self._closed = True
                self._queue.put(None)

    def reject(self) -> None:
        """Reject further messages because nobody writes them any more."""
        self._closed = True

    def next_batch(self, until_s: float) -> list[Item]:
        """Return all queued items, or none after a timeout, monotonic seconds; one flush covers the batch."""
        batch: list[Item] = []
        try:
            batch.append(self._queue.get(timeout=max(until_s - time.monotonic(), 0.01)))
            while batch[-1] is not None and len(batch) < _BATCH:
                batch.append(self._queue.get_nowait())
        except queue.Empty:
            pass
        return batch

    def mark_written(self, messages: int, size: int) -> None:
        """Subtract written messages and their bytes from the backlog."""
        with self._lock:
            self._waiting_messages -= messages
            self._waiting_bytes -= size
            self._waits_since_s = time.monotonic()

    @property
    def backlog(self) -> Backlog:
        """Messages that are not written yet."""
        with self._lock:
            waits_s = time.monotonic() - self._waits_since_s if self._waiting_messages else 0.0
            is_large = 4 * self._waiting_messages > self._max_messages or 4 * self._waiting_bytes > MAX_BYTES
            return Backlog(self._waiting_messages, waits_s, is_large)

    def acknowledge(self, count: int) -> int | None:
        """Discard the first messages, which an fsync covers; return the log time of the last of them, None without any."""
        last_ns = None
        with self._lock:
            for _ in range(count):
                last_ns = self._unacknowledged.popleft().log_time_ns
        return last_ns

    def unacknowledged(self, count: int | None = None) -> tuple[LogMessage, ...]:
        """Return the first messages that no fsync covers yet; all of them without a count."""
        with self._lock:
            return tuple(islice(self._unacknowledged, count))
