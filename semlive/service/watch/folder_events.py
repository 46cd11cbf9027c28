"""File-system events wake the scan of a folder; the scan decides.

Network shares send no events, an observer can fail, and the system drops events when there are too many. All of this is a note, never an
error: the folder is scanned at its interval in any case. The threads of watchdog only set a flag.
"""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable
from pathlib import Path

from watchdog.events import FileClosedEvent, FileCreatedEvent, FileModifiedEvent, FileMovedEvent, FileSystemEvent, FileSystemEventHandler
from watchdog.observers import Observer
from watchdog.observers.api import BaseObserver

_EVENTS: list[type[FileSystemEvent]] = [FileCreatedEvent, FileModifiedEvent, FileMovedEvent, FileClosedEvent]
"""Without openings and closings after reading, which the watch itself causes."""
_MAX_MISSES = 3
_RESTART_S = 10.0
_JOIN_S = 2.0


class FolderEvents:
    """Calls `wake` at each event in a folder, in a thread of watchdog; all other methods and `on_notice` run in the thread of the scan.

    Args:
        folder: watched folder.
        wake: wakes the scan; must not block.
        on_notice: callback with one sentence when events do not arrive.
    """

    def __init__(self, folder: Path, wake: Callable[[], None], on_notice: Callable[[str], None]) -> None:
        self._folder, self._wake, self._on_notice = folder, wake, on_notice
        self._observer: BaseObserver | None = None
        self._log = _WatchdogLog(wake)
        self._misses = 0
        self._is_reported = False
        self._started_s = 0.0

    def start(self) -> None:
        """Start to observe the folder; a failure is a note."""
        self._started_s, self._misses = time.monotonic(), 0
        self._log.install()
        try:
            self._observer = Observer()
            self._observer.schedule(_Handler(self._wake), str(self._folder), recursive=False, event_filter=_EVENTS)
            self._observer.start()
        except Exception as exc:  # each system has errors of its own; the scan does not need the observer
            self._stop_observer()
            self._report(f"file-system events are not available ({exc})")

    def follow(self, *, is_woken: bool, has_news: bool) -> None:
        """Check after each scan whether events arrive, and start a new observer from time to time if they do not.

        Args:
            is_woken: an event or another request woke the scan; otherwise it was due.
            has_news: the scan found a new or changed file.
        """
        if is_woken:
            self._misses = 0
            self._is_reported = self._is_reported and not has_news
        elif has_news:
            self._misses += 1
        problem = self._log.take()
        if problem is None and self._misses >= _MAX_MISSES:
            problem = "no file-system events arrive, as from a network share"
        if problem is None and self._observer is not None and not _is_running(self._observer):
            problem = "the observer of file-system events has ended"
        if problem is not None:
            self._report(problem)
        is_useless = self._observer is None or self._misses >= _MAX_MISSES or not _is_running(self._observer)
        if is_useless and time.monotonic() - self._started_s >= _RESTART_S:
            self._stop_observer()
            self.start()

    def close(self) -> None:
        """End the threads of the observer."""
        self._stop_observer()
        self._log.remove()

    def _report(self, problem: str) -> None:
        if not self._is_reported:
            self._on_notice(f"{self._folder}: {problem}; the folder is scanned every sem.poll_s instead, so nothing is lost.")
        self._is_reported = True

    def _stop_observer(self) -> None:
        observer, self._observer = self._observer, None
        if observer is None:
            return
        with contextlib.suppress(Exception):  # it may have failed at any point of its start
            observer.stop()
        if observer.is_alive():
            observer.join(_JOIN_S)


class _Handler(FileSystemEventHandler):
    def __init__(self, wake: Callable[[], None]) -> None:
        self._wake = wake

    def on_any_event(self, event: FileSystemEvent) -> None:
        del event
        self._wake()


class _WatchdogLog(logging.Handler):
    """Receives the warnings of watchdog, of lost events among others, instead of standard error."""

    def __init__(self, wake: Callable[[], None]) -> None:
        super().__init__(logging.WARNING)
        self._wake, self._problem = wake, None

    def install(self) -> None:
        """Receive from now on."""
        logger = logging.getLogger("watchdog")
        logger.addHandler(self)
        logger.propagate = False

    def remove(self) -> None:
        """Receive no more."""
        logger = logging.getLogger("watchdog")
        logger.removeHandler(self)
        logger.propagate = True

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a message and wake the scan, which reports it."""
        self._problem: str | None = record.getMessage()
        self._wake()

    def take(self) -> str | None:
        """Return the newest message once."""
        problem, self._problem = self._problem, None
        return problem


def _is_running(observer: BaseObserver) -> bool:
    return observer.is_alive() and all(emitter.is_alive() for emitter in observer.emitters)
