"""One log reader for all viewers: it follows the log in a thread and serialises each change once."""

from __future__ import annotations

import asyncio
import threading
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from semlive.errors import BadLog
from semlive.formats.log.messages import SEM_ORIGINAL, SEM_SIDECAR
from semlive.formats.log.reader import LogMessage
from semlive.service.log.files import PARTIAL_SUFFIX, segments
from semlive.service.log.recording import is_being_written
from semlive.service.log.tail import LogTail
from semlive.service.runtime.clock import boot_id
from semlive.web.fields import FieldStore, fields_of
from semlive.web.frame_images import FrameImageStore
from semlive.web.page_state import PageState
from semlive.web.reducer import reduce, seconds, with_image, with_maps
from semlive.web.serialise import full_state, state_diff, to_json_line

POLL_S = 0.04
# A finished log gets another segment if the run is resumed.
_POLL_FINISHED_S = 0.5
_PUBLISH_INTERVAL_S = 0.25
_WRITER_CHECK_INTERVAL_S = 2.0
_MAX_CHANGES = 64


@dataclass(frozen=True, slots=True)
class NewestFile:
    """Bytes of the newest exported file."""

    export: int
    data: bytes
    sidecar: bytes | None


class LogBroadcaster:
    """Follows a log; `start` starts the thread, `changes` returns the changes after a version.

    Args:
        log: one file or a run folder, which need not exist yet.
    """

    def __init__(self, log: Path) -> None:
        self.fields = FieldStore()
        self.images = FrameImageStore()
        self.original: NewestFile | None = None
        self.run_message: LogMessage | None = None
        self.file_message: LogMessage | None = None
        self._log, self._tail = log, LogTail(log)
        self._orphaned, self._next_check_s = False, 0.0
        self._view = self._published = PageState()
        self._version = 0
        self._full_text: tuple[int, str] = (-1, "")
        self._changes: deque[tuple[int, str]] = deque(maxlen=_MAX_CHANGES)
        self._sidecar: bytes | None = None
        self._trouble = ""
        self._reading = True
        self._last_message_s = time.monotonic()
        self._closed = threading.Event()
        self._next_change: asyncio.Event = asyncio.Event()
        self._boot_id = boot_id()

    @property
    def view(self) -> PageState:
        """State of the page that was last published."""
        return self._published

    @property
    def finished(self) -> bool:
        """Whether the log is finished and was sent completely."""
        return self._tail.finished and not state_diff(self._published, self._view)

    def start(self, loop: asyncio.AbstractEventLoop) -> None:
        """Start to follow the log."""
        threading.Thread(target=self._follow, args=(loop,), name="log reader", daemon=True).start()

    def close(self) -> None:
        """Stop following the log."""
        self._closed.set()

    async def changes(self, version: int, timeout_s: float) -> tuple[int, list[str]]:
        """Return the changes after a version as lines of JSON, oldest first; empty if there were none within the timeout.

        A viewer that lacks too many changes receives the complete state; version -1 always does.
        """
        if version == self._version:
            change = self._next_change
            try:
                async with asyncio.timeout(timeout_s):
                    await change.wait()
            except TimeoutError:
                return version, []
        missed = [text for number, text in self._changes if number > version]
        if version < 0 or len(missed) != self._version - version:
            return self._version, [self._full_state()]
        return self._version, missed

    def heartbeat(self) -> str:
        """Return the time as a line of JSON."""
        return to_json_line({"now": self._now()})

    def _full_state(self) -> str:
        if self._full_text[0] != self._version:
            self._full_text = (self._version, to_json_line(full_state(self._published)))
        return f'{{"whole":true,"now":{to_json_line(self._now())},{self._full_text[1][1:]}'

    def _now(self) -> dict[str, Any]:
        """Return experiment time, its rate, and whether the log can still grow."""
        view, live = self._published, not self._tail.finished and not self._reading
        same_boot = view.clock is not None and view.boot_id == self._boot_id != ""
        running = live and view.clock is not None and same_boot
        now_ns = view.clock.time_ns(time.monotonic_ns()) if running and view.clock else view.earlier.last_ns
        return {
            "time_s": seconds(view, max(now_ns, view.earlier.last_ns)),
            "rate": view.clock.rate if running and view.clock else 0.0,
            "start_ms": view.run.start_ns // 1_000_000 if view.run else 0,
            "live": live,
            "reading": self._reading,
            "silent_s": round(time.monotonic() - self._last_message_s, 1),
            "orphaned": self._orphaned,
            "trouble": self._trouble,
        }

    def _follow(self, loop: asyncio.AbstractEventLoop) -> None:
        while not self._closed.is_set():
            published_s = time.monotonic()
            try:
                for message in self._tail.poll():
                    self._take(message)
                    if time.monotonic() > published_s + _PUBLISH_INTERVAL_S:
                        published_s = time.monotonic()
                        self._publish_changes(loop)
            except BadLog as error:
                self._trouble = str(error)
                self._closed.wait(1.0)
            if self._reading and self._view.earlier.last_ns:
                self._reading = False
                self._schedule(loop, state_diff(self._published, self._view))
            self._publish_changes(loop)
            self._check_writer()
            self._closed.wait(_POLL_FINISHED_S if self._tail.finished else POLL_S)

    def _check_writer(self) -> None:
        """Update whether the newest segment is unfinished and has no writer; the time without messages is no criterion without devices."""
        if time.monotonic() < self._next_check_s:
            return
        self._next_check_s = time.monotonic() + _WRITER_CHECK_INTERVAL_S
        try:
            newest = segments(self._log)[-1]
            with newest.open("rb") as stream:
                self._orphaned = newest.suffix == PARTIAL_SUFFIX and not is_being_written(stream)
        except (BadLog, OSError):
            self._orphaned = False

    def _take(self, message: LogMessage) -> None:
        self._last_message_s = time.monotonic()
        fields = fields_of(message)
        if fields is not None:
            self.fields.store(fields)
            self._view = with_maps(self._view, fields)
        elif (pictured := self.images.take(message)) is not None:
            self._view = with_image(self._view, pictured)
        elif message.topic == SEM_SIDECAR:
            self._sidecar = message.payload
        elif message.topic == SEM_ORIGINAL:
            self.original, self._sidecar = NewestFile(message.sequence, message.payload, self._sidecar), None
        if message.topic == "/run":
            self.run_message = message
        elif message.topic == "/sem/file" and b'"arrived"' in message.payload:
            self.file_message = message
        self._view = reduce(self._view, message)

    def _publish_changes(self, loop: asyncio.AbstractEventLoop) -> None:
        """Serialise the changes once for all viewers."""
        parts = state_diff(self._published, self._view)
        if parts:
            self._schedule(loop, parts)

    def _schedule(self, loop: asyncio.AbstractEventLoop, parts: dict[str, Any]) -> None:
        view = self._view
        self._published = view
        text = to_json_line({"now": self._now(), **parts})
        try:
            loop.call_soon_threadsafe(self._publish, text)
        except RuntimeError:
            self._closed.set()

    def _publish(self, text: str) -> None:
        self._version += 1
        self._changes.append((self._version, text))
        change, self._next_change = self._next_change, asyncio.Event()
        change.set()
