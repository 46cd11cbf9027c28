"""The recorder: the only writer of a log, a thread of its own behind a bounded queue.

Policy: every transition, command, file and result is flushed as soon as it is written and survives a kill; transitions,
pairs, faults and original images are also synced and survive a loss of power; telemetry is flushed once a second.
A disk that refuses is reported at once and tried again every second: nothing is dropped, and when the queue is full,
`write` says so. A segment is written as ``<name>.part`` and renamed when it is whole.
"""

from __future__ import annotations

import os
import queue
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from semlive.errors import BadConfig, SemliveError
from semlive.formats.log import LogMessage, LogWriter
from semlive.formats.messages import RAW_TOPICS, SEM_ORIGINAL, TOPICS, Payload, to_json, topic_of
from semlive.ports import ClockSource
from semlive.service.log_files import PART
from semlive.service.log_stream import OpenRaw, PatientStream, open_new

SYNCED = frozenset({"/run", "/state", "/pair", "/fault", "/result", SEM_ORIGINAL})
TELEMETRY = frozenset({"/load_frame/sample", "/stage/sample", "/log"})
MAX_MESSAGES = 50_000
MAX_BYTES = 2**29
FLUSH_EVERY_S = 1.0
RETRY_AFTER_S = 1.0


class Recorder:
    """Writes one segment of a run's log.

    Args:
        path: the finished segment; it grows as ``<path>.part``.
        clock: experiment time, for log times.
        on_fault: told one sentence, from the recorder's thread, when the disk refuses and when it takes again.
        open_raw: opens the file that grows.
        max_messages: `write` refuses beyond so many messages not yet written.
        retry_after_s: wall seconds between attempts to write to a disk that refuses.

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
    ) -> None:
        self.path = path
        self.part = path.with_name(path.name + PART)
        self._clock, self._on_fault = clock, on_fault
        self._max_messages, self._retry_after_s = max_messages, retry_after_s
        self._lock = threading.Lock()
        self._queue: queue.SimpleQueue[LogMessage | threading.Event | None] = queue.SimpleQueue()
        self._counts: Counter[str] = Counter()
        self._last_log_time_ns = 0
        self._waiting_messages = self._waiting_bytes = 0
        self._closing = threading.Event()
        self._whole = False
        self._stream = self._open(open_raw)
        self._writer = LogWriter(self._stream.as_binary())
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def write(self, topic: str, payload: Payload | bytes, publish_time_ns: int | None = None, sequence: int | None = None) -> LogMessage:
        """Record a message; returns at once, from any thread.

        Args:
            topic: what it is about.
            payload: the topic's message, or its bytes.
            publish_time_ns: experiment time of what it tells; now by default.
            sequence: for topics that give it a meaning; by default messages of the topic are counted.

        Returns:
            The message as it will stand in the log.

        Raises:
            ValueError: the topic is unknown, or the payload does not fit it.
            SemliveError: the disk has refused for so long that the queue is full, or the recorder is closed.
        """
        if topic not in TOPICS and topic not in RAW_TOPICS:
            raise ValueError(f"{topic} is not a topic of the log")
        if not isinstance(payload, bytes) and topic_of(payload) != topic:
            raise ValueError(f"{type(payload).__name__} does not belong to {topic}")
        data = payload if isinstance(payload, bytes) else to_json(payload)
        with self._lock:
            if self._closing.is_set():
                raise SemliveError(f"{self.path}: the log is closed; {topic} was not recorded.")
            if self._waiting_messages >= self._max_messages or self._waiting_bytes + len(data) > MAX_BYTES:
                raise SemliveError(f"{self.path}: {self._waiting_messages} messages wait to be written; make room on the disk.")
            now_ns = max(self._clock.now_ns(), self._last_log_time_ns + 1)
            number = self._counts[topic] if sequence is None else sequence
            message = LogMessage(topic, now_ns, now_ns if publish_time_ns is None else publish_time_ns, number, data)
            self._counts[topic] += 1
            self._last_log_time_ns = now_ns
            self._waiting_messages += 1
            self._waiting_bytes += len(data)
            self._queue.put(message)
        return message

    def flush_wait(self, timeout_s: float = 10.0) -> bool:
        """Wait until everything written so far is on the disk; False if it is not in time."""
        with self._lock:
            if self._closing.is_set():
                return self._whole
            done = threading.Event()
            self._queue.put(done)
        return done.wait(timeout_s)

    def close(self, timeout_s: float = 10.0) -> bool:
        """Finish the segment and give it its name; any number of times.

        Returns:
            True if the whole segment is on the disk; False if the disk still refused after `timeout_s`: the part that it
            took stays as ``.part``.
        """
        with self._lock:
            if not self._closing.is_set():
                self._closing.set()
                self._queue.put(None)
        self._thread.join(timeout_s)
        return self._whole

    def _open(self, open_raw: OpenRaw) -> PatientStream:
        try:
            if self.path.exists():
                raise FileExistsError(0, "it exists already")
            return PatientStream(open_raw(self.part))
        except OSError as exc:
            raise BadConfig(f"{self.part}: cannot be created ({exc.strerror}); name another run or folder.") from exc

    def _run(self) -> None:
        try:
            self._work()
        except Exception as exc:
            self._closing.set()
            self._on_fault(f"{self.part}: the recorder failed ({type(exc).__name__}: {exc}); stop the run and report this.")
            raise

    def _work(self) -> None:
        flushed_at = time.monotonic()
        closing = False
        while not closing:
            batch = self._next_batch(flushed_at + FLUSH_EVERY_S)
            messages = [item for item in batch if isinstance(item, LogMessage)]
            waiters = [item for item in batch if isinstance(item, threading.Event)]
            closing = None in batch
            for item in messages:
                self._writer.write(item.topic, item.payload, item.log_time_ns, item.publish_time_ns, item.sequence)
            if closing:
                self._writer.finish()
            topics = {item.topic for item in messages}
            if closing or waiters or topics - TELEMETRY or time.monotonic() >= flushed_at + FLUSH_EVERY_S:
                self._save(sync=closing or bool(waiters) or not topics.isdisjoint(SYNCED), finished=closing)
                flushed_at = time.monotonic()
            with self._lock:
                self._waiting_messages -= len(messages)
                self._waiting_bytes -= sum(len(item.payload) for item in messages)
            for waiter in waiters:
                waiter.set()

    def _next_batch(self, until: float) -> list[LogMessage | threading.Event | None]:
        """What has come, all of it, or nothing if nothing comes until then: one flush serves the whole batch."""
        batch: list[LogMessage | threading.Event | None] = []
        try:
            batch.append(self._queue.get(timeout=max(until - time.monotonic(), 0.01)))
            while batch[-1] is not None and len(batch) < 1000:
                batch.append(self._queue.get_nowait())
        except queue.Empty:
            pass
        return batch

    def _save(self, sync: bool, finished: bool) -> None:
        """Bring everything to the disk, however long it refuses."""
        refused = False
        while True:
            try:
                if not finished:
                    self._writer.flush()
                self._stream.sync() if sync else self._stream.flush()
                if finished:
                    self._rename()
            except OSError as exc:
                if not refused:
                    self._on_fault(f"{self.part}: the log cannot be written ({exc.strerror or exc}); make room on the disk.")
                refused = True
                time.sleep(self._retry_after_s)
            else:
                break
        if refused:
            self._on_fault(f"{self.part}: the log is being written again; nothing was lost.")

    def _rename(self) -> None:
        self._stream.close()
        self.part.replace(self.path)
        if hasattr(os, "O_DIRECTORY"):
            folder = os.open(self.path.parent, os.O_DIRECTORY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
        self._whole = True
