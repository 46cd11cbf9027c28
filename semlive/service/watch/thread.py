"""The thread that watches the export folder."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable

from semlive.data.frame import ExportedFile
from semlive.ports import ClockSource
from semlive.service.runtime.memory import trim_heap
from semlive.service.watch.export_folder import ExportFolder, ignore
from semlive.service.watch.folder_events import FolderEvents
from semlive.service.watch.watch_settings import RejectedFile, WatchSettings

_TRIM_EVERY_S = 5.0  # a trim takes 0.2 to 1 ms
_MIN_PAUSE_S = 0.01
_MIN_PAUSE_SCANS = 1.0  # duration of the pause after a scan in durations of the scan, so that frequent events do not keep a processor busy


class FolderWatcher:
    """Scans the export folder in a separate thread and passes on each complete file once.

    Callbacks run in that thread. File-system events wake it early; they never replace a scan.

    Args:
        settings: what is watched.
        clock: experiment time for arrivals, monotonic time for stability.
        on_file: callback with each complete file once.
        on_refused: callback with each rejected file once.
        on_trouble: callback with one sentence when the folder disappears, is available again, or the watch itself fails.
        on_notice: callback with one sentence about an unusual observation.
        on_replaced: callback with one sentence when another folder replaces it; its files are accepted only after `accept`.

    Raises:
        BadConfig: the folder does not exist or cannot be read.
    """

    def __init__(
        self,
        settings: WatchSettings,
        clock: ClockSource,
        on_file: Callable[[ExportedFile], None],
        on_refused: Callable[[RejectedFile], None],
        on_trouble: Callable[[str], None],
        on_notice: Callable[[str], None] = ignore,
        on_replaced: Callable[[str], None] = ignore,
    ) -> None:
        self._folder = ExportFolder(settings, clock, on_file, on_refused, on_trouble, on_notice, on_replaced=on_replaced)
        self._poll_s, self._on_trouble = settings.poll_s, on_trouble
        self._wake = threading.Event()
        self._accepts = threading.Event()
        self._stop = threading.Event()
        self._failed = threading.Event()
        self._folder.open()
        self._events = FolderEvents(settings.folder, self.wake, on_notice) if settings.use_events else None
        self._thread = threading.Thread(target=self._run, name="watch", daemon=True)

    def start(self) -> None:
        """Start scanning. Files that appeared since the construction of the watcher are new."""
        self._thread.start()

    @property
    def failed(self) -> bool:
        """Whether the thread has ended after an error; no more files are accepted."""
        return self._failed.is_set()

    def wake(self) -> None:
        """Scan now."""
        self._wake.set()

    def accept(self) -> None:
        """Continue with a folder that replaced the original one; from any thread."""
        self._accepts.set()
        self._wake.set()

    def close(self, timeout_s: float = 5.0) -> None:
        """Stop scanning; may be called repeatedly, also before the start."""
        self._stop.set()
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(timeout_s)

    def _run(self) -> None:
        trimmed_s = time.monotonic()
        is_woken, events = False, self._events
        try:
            if events is not None:
                events.start()
            while not self._stop.is_set():
                if self._accepts.is_set():
                    self._accepts.clear()
                    with contextlib.suppress(OSError):  # it is unavailable again, which `poll` reports
                        self._folder.accept()
                started_s, news = time.monotonic(), self._folder.news
                self._folder.poll()
                pause_s = max(_MIN_PAUSE_S, _MIN_PAUSE_SCANS * (time.monotonic() - started_s))
                wait_s = min(self._poll_s, self._folder.next_due_s() or self._poll_s)
                if events is not None:
                    events.follow(is_woken=is_woken, has_news=self._folder.news > news)
                if time.monotonic() - trimmed_s > _TRIM_EVERY_S:  # no other thread waits for this one
                    trim_heap()
                    trimmed_s = time.monotonic()
                self._stop.wait(pause_s)
                is_woken = self._wake.wait(max(wait_s - pause_s, 0.0))
                self._wake.clear()
        except Exception as exc:
            self._failed.set()
            self._on_trouble(f"the watch of the export folder failed ({type(exc).__name__}: {exc}); stop the run and report this.")
        finally:
            if events is not None:
                events.close()
