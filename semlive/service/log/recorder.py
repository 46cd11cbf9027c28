"""The recorder: the only writer of a log, in a separate thread with a bounded queue.

Policy: every transition, command, file and result is flushed as soon as it is written and survives a kill; transitions,
pairs, faults and original images are also synced and survive a loss of power; telemetry is flushed once a second.
A disk that rejects writes is reported at once and retried every second; one that takes too long is slow. Both are reported by
`backlog_message`, on which the daemon pauses the run: telemetry continues into memory, for 40 minutes at 20 readings a second, and
nothing is dropped. When the queue is full, `write` raises, which stops the devices and ends the run.

A message stays in memory until an fsync that covers it has succeeded (at most 10 s or 64 MB beyond the queue). When an fsync fails, or a
write fails other than for want of room, the system may have dropped everything since the last successful fsync: it is written again into a
new segment, synced and read back; the old segment is cut where it was last acknowledged. A segment is written as
``<name>.part`` and renamed when it is whole. One that has become large is ended and the next begun: what a loss of power can
damage, and what then has to be read and written anew, is the newest alone.
"""

from __future__ import annotations

import queue
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from itertools import islice
from pathlib import Path

from semlive.errors import BadConfig, SemliveError
from semlive.formats.log.messages import RAW_TOPICS, SEM_ORIGINAL, SEM_SIDECAR, TOPICS, Payload, to_json, topic_of
from semlive.formats.log.reader import LogMessage
from semlive.ports import ClockSource
from semlive.service.log.files import PARTIAL_SUFFIX, next_segment
from semlive.service.log.segment import Segment, close, cut_back, give_name, open_segment, rewritten, scratch
from semlive.service.log.stream import OpenRaw, open_new
from semlive.service.log.unacknowledged import described, is_repeatable, remedy
from semlive.service.runtime.pause import pause

SYNCED = frozenset({"/run", "/snapshot", "/state", "/pair", "/fault", "/result", SEM_ORIGINAL, SEM_SIDECAR})
TELEMETRY = frozenset({"/load_frame/sample", "/stage/sample", "/log"})
MAX_MESSAGES = 50_000
MAX_BYTES = 2**29
FLUSH_EVERY_S = 1.0
RETRY_AFTER_S = 1.0
SLOW_AFTER_S = 5.0
SEGMENT_BYTES = 2 * 10**9
SYNC_EVERY_S = 10.0
SYNC_BYTES = 64 * 10**6
# Time after a failed fsync during which the log is reported as behind, so that the run is paused.
_SUSPECT_S = 2.0
_WRITTEN_AGAIN = "{}: the log is being written again; what the disk had refused was kept in memory and is written now."


class _Suspect(Exception):
    """The system may have discarded buffered data of the file of the segment."""

    def __init__(self, cause: OSError) -> None:
        super().__init__(str(cause.strerror or cause))
        self.cause = cause


class Recorder:
    """Writes the log of a run, beginning with one of its segments.

    Args:
        path: the finished segment; it grows as ``<path>.part``.
        clock: experiment time, for log times.
        on_fault: callback with one sentence, in the recorder thread, when the disk rejects writes and when it accepts them again.
        open_raw: opens the growing file.
        max_messages: largest number of unwritten messages; beyond it `write` raises.
        retry_after_s: wall seconds between attempts to write to a disk that rejects writes.
        after_ns: log time of the last message of the run's earlier segments; 0 without any.
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
        self.path = path
        self.part = path.with_name(path.name + PARTIAL_SUFFIX)
        self._clock, self._on_fault = clock, on_fault
        self._max_messages, self._retry_after_s, self._slow_after_s = max_messages, retry_after_s, slow_after_s
        self._refused = self._remedy = ""
        self._suspect_until_s = 0.0
        self._moved = self._cut = False
        self._flushed_bytes, self._segment_bytes = 0, segment_bytes
        self._run_message: bytes | None = None
        self._footed = False
        self._kept: deque[LogMessage] = deque()
        self._handed = self._handed_bytes = 0
        self._acknowledged_ns, self._acknowledged_at_s = after_ns, time.monotonic()
        self._open_raw = open_raw
        self._waits_since = 0.0
        self._lock = threading.Lock()
        self._queue: queue.SimpleQueue[LogMessage | threading.Event | None] = queue.SimpleQueue()
        self._counts: Counter[str] = Counter()
        self._last_log_time_ns = after_ns
        self._waiting_messages = self._waiting_bytes = 0
        self._closing = threading.Event()
        self._whole = False
        aside = scratch()
        try:
            self._segment = open_segment(path, self.part, open_raw, aside)
        except OSError as exc:
            if aside is not None:
                aside.close()
            raise BadConfig(f"{self.part}: cannot be created ({exc.strerror}); name another run or folder.") from exc
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

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
            if self._waiting_messages == 0:
                self._waits_since = time.monotonic()
            self._waiting_messages += 1
            self._waiting_bytes += len(data)
            self._kept.append(message)
            self._queue.put(message)
        return message

    @property
    def backlog_message(self) -> str | None:
        """Why new messages would not be on the disk soon, one sentence; None while the log keeps up."""
        with self._lock:
            waits_s = time.monotonic() - self._waits_since if self._waiting_messages else 0.0
            full = 4 * self._waiting_messages > self._max_messages or 4 * self._waiting_bytes > MAX_BYTES
            if self._refused:
                return f"the log cannot be written ({self._refused}): {self._remedy}"
            if time.monotonic() < self._suspect_until_s:
                return f"{self.part}: the disk failed to confirm what was written: check the disk before you resume"
        if self._moved or self._cut:
            done, remedy = ("cut short", "stop the run") if self._cut else ("moved or removed", "put it back, or stop the run")
            return f"{self.part}: another program has {done} the log while it is written: keep it away from there and {remedy}"
        if waits_s > self._slow_after_s or full:
            return f"the disk is too slow: {self._waiting_messages} messages wait for {waits_s:.0f} s to be written to the log"
        return None

    @property
    def write_failed(self) -> bool:
        """Whether written data do not reach the disk, or not the file that readers open."""
        return bool(self._refused) or self._moved or self._cut

    def flush(self, timeout_s: float = 10.0) -> bool:
        """Wait until everything written so far is on the disk; False if it is not in time."""
        with self._lock:
            if self._closing.is_set():
                return self._whole
            done = threading.Event()
            self._queue.put(done)
        return done.wait(timeout_s)

    @property
    def unacknowledged(self) -> str:
        """Messages that no successful fsync covers yet, by topic, image file and time."""
        with self._lock:
            return described(tuple(self._kept))

    def close(self, timeout_s: float = 10.0, refused_s: float = float("inf")) -> bool:
        """Finish the segment and rename it; may be called repeatedly.

        Args:
            timeout_s: wall seconds to wait for it.
            refused_s: wall seconds to wait while the disk refuses.

        Returns:
            True if the whole segment is on the disk; False if the disk still refused after `timeout_s`: the part that it
            took stays as ``.part``.
        """
        with self._lock:
            if not self._closing.is_set():
                self._closing.set()
                self._queue.put(None)
        accepted_s = began_s = time.monotonic()
        while self._thread.is_alive() and (now_s := time.monotonic()) < min(began_s + timeout_s, accepted_s + refused_s):
            self._thread.join(min(0.1, began_s + timeout_s - now_s))
            accepted_s = accepted_s if self.write_failed else time.monotonic()
        return self._whole

    def _run(self) -> None:
        try:
            self._work()
        except Exception as exc:
            self._closing.set()
            self._on_fault(f"{self.part}: the recorder failed ({type(exc).__name__}: {exc}); stop the run and report this.")
            raise
        finally:
            close(self._segment)

    def _work(self) -> None:
        flushed_at = looked_at = time.monotonic()
        closing = False
        while not closing:
            batch = self._next_batch(flushed_at + FLUSH_EVERY_S)
            messages = [item for item in batch if isinstance(item, LogMessage)]
            waiters = [item for item in batch if isinstance(item, threading.Event)]
            closing = None in batch
            for item in messages:
                self._segment.writer.write(item.topic, item.payload, item.log_time_ns, item.publish_time_ns, item.sequence)
                self._run_message = item.payload if item.topic == "/run" else self._run_message
            taken_bytes = sum(len(item.payload) for item in messages)
            self._handed, self._handed_bytes = self._handed + len(messages), self._handed_bytes + taken_bytes
            topics = {item.topic for item in messages}
            if closing:
                self._finish(continued=False)
            elif waiters or topics - TELEMETRY or time.monotonic() >= flushed_at + FLUSH_EVERY_S:
                self._save(sync=bool(waiters) or not topics.isdisjoint(SYNCED) or self._sync_is_due())
                flushed_at = time.monotonic()
            if not closing and self._segment.stream.tell() > self._segment_bytes:
                self._begin_next()
            if not closing and time.monotonic() >= looked_at + FLUSH_EVERY_S:
                self._look()
                looked_at = time.monotonic()
            with self._lock:
                self._waiting_messages -= len(messages)
                self._waiting_bytes -= taken_bytes
                self._waits_since = time.monotonic()
            for waiter in waiters:
                waiter.set()

    def _sync_is_due(self) -> bool:
        late = time.monotonic() >= self._acknowledged_at_s + SYNC_EVERY_S
        return self._handed > 0 and (late or self._handed_bytes > SYNC_BYTES)

    def _next_batch(self, until: float) -> list[LogMessage | threading.Event | None]:
        """Return all queued messages, or none after the timeout; one flush covers the batch."""
        batch: list[LogMessage | threading.Event | None] = []
        try:
            batch.append(self._queue.get(timeout=max(until - time.monotonic(), 0.01)))
            while batch[-1] is not None and len(batch) < 1000:
                batch.append(self._queue.get_nowait())
        except queue.Empty:
            pass
        return batch

    def _save(self, sync: bool) -> None:
        """Write everything to the disk; repeat while the disk rejects it."""
        self._patiently(lambda: self._bring(sync, self._segment.writer.flush))

    def _finish(self, continued: bool) -> None:
        """Finish and rename the segment; repeat while the disk rejects it, unless its folder was removed."""

        def whole() -> None:
            segment = self._segment
            if not self._footed:
                self._bring(False, segment.writer.flush)
                segment.writer.finish(continued)
                self._footed = True
            self._bring(True, segment.stream.flush)
            give_name(segment)
            self._whole = True

        self._footed = False
        self._patiently(whole)

    def _patiently(self, bring: Callable[[], None]) -> None:
        """Repeat an operation until it succeeds; continue in a new segment if the present file is unreliable."""
        reported = False
        while True:
            try:
                try:
                    bring()
                except _Suspect as suspect:
                    self._footed = False
                    self._rewrite(suspect.cause)
                    continue
            except OSError as exc:
                if not self.path.parent.is_dir():
                    self._moved = True
                    self._on_fault(f"{self.path.parent}: the run's folder was removed, and the log with it; stop the run.")
                    return
                if not reported:
                    self._on_fault(f"{self.part}: the log cannot be written ({exc.strerror or exc}); {remedy(exc)}.")
                reported = True
                self._refuse(exc)
                pause(self._retry_after_s)
            else:
                break
        self._refused = ""
        if reported:
            self._on_fault(_WRITTEN_AGAIN.format(self.part))

    def _bring(self, sync: bool, flush: Callable[[], None]) -> None:
        """Flush everything to the system, and fsync it.

        Raises:
            OSError: there is no room; the same can be repeated.
            _Suspect: the system may have dropped what was not yet acknowledged.
        """
        segment = self._segment
        try:
            flush()
        except OSError as exc:
            if is_repeatable(exc):
                raise
            raise _Suspect(exc) from exc
        self._flushed_bytes = segment.stream.tell()
        if not sync:
            return
        try:
            segment.stream.sync()
        except OSError as exc:
            raise _Suspect(exc) from exc
        self._acknowledge(segment)

    def _acknowledge(self, segment: Segment) -> None:
        """Discard the stored messages that a successful fsync covers."""
        if not self._footed:
            segment.mark = segment.writer.mark()
        with self._lock:
            for _ in range(self._handed):
                self._acknowledged_ns = self._kept.popleft().log_time_ns
        self._handed = self._handed_bytes = 0
        self._acknowledged_at_s = time.monotonic()

    def _rewrite(self, cause: OSError) -> None:
        """Write all unacknowledged messages to a new segment and continue there; repeat while the disk rejects it.

        Raises:
            OSError: the run's folder is gone.
        """
        old, path, why = self._segment, next_segment(self.path), str(cause.strerror or cause)
        with self._lock:
            messages = tuple(islice(self._kept, self._handed))
        self._refuse(cause)
        self._on_fault(
            f"{old.part}: the disk did not confirm what was written ({why}), so it is kept in memory and written again into "
            f"{path.name}: {described(messages)}; {remedy(cause)}."
        )
        while True:
            try:
                new = rewritten(path, messages, self._acknowledged_ns, self._run_message, self._open_raw)
            except OSError as exc:
                if not path.parent.is_dir():
                    raise
                self._refuse(exc)
                pause(self._retry_after_s)
            else:
                break
        self._segment, self.path, self.part = new, new.path, new.part
        self._flushed_bytes = new.stream.tell()
        self._acknowledge(new)
        try:
            cut_back(old, self._run_message)
            kept = f"{old.path.name} ends where it was last confirmed"
        except OSError as exc:
            kept = f"{old.part.name} stays unfinished ({exc.strerror or exc}) and can be recovered with `semlive recover`"
        self._suspect_until_s = time.monotonic() + _SUSPECT_S
        self._on_fault(
            f"{old.path.name}: {len(messages)} messages that its disk had not confirmed were written again into {new.path.name} "
            f"and read back from there; {kept}; check the disk before you resume."
        )

    def _refuse(self, error: OSError) -> None:
        self._refused, self._remedy = str(error.strerror or error), remedy(error)

    def _begin_next(self) -> None:
        """Finish this segment and continue in the next one; repeat while the disk rejects it."""
        self._finish(continued=True)
        self._whole = self._footed = False
        self.path = next_segment(self.path)
        self.part = self.path.with_name(self.path.name + PARTIAL_SUFFIX)
        self._segment, self._flushed_bytes = self._opened_at_last(), 0
        if self._run_message is not None:
            self._segment.writer.write_run_metadata(self._run_message)
        self._save(sync=False)

    def _opened_at_last(self) -> Segment:
        while True:
            try:
                segment = open_segment(self.path, self.part, self._open_raw, self._segment.aside)
            except OSError as exc:
                if not self._refused:
                    what = f"the log's next segment cannot be created ({exc.strerror or exc})"
                    self._on_fault(f"{self.part}: {what}; {remedy(exc)}.")
                self._refuse(exc)
                pause(self._retry_after_s)
            else:
                break
        if self._refused:
            self._refused = ""
            self._on_fault(_WRITTEN_AGAIN.format(self.part))
        return segment

    def _look(self) -> None:
        """Whether readers find the written file, by name and size, because some network shares change the identity of a file."""
        try:
            size = self.part.stat().st_size
        except FileNotFoundError:
            self._moved = True
            return
        except OSError:
            return  # a share that is away for a moment
        self._moved = False
        self._cut = self._cut or size < self._flushed_bytes
