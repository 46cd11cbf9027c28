"""The Trigger port over the remote interface of a microscope: one frame for each request, with its settings before and after.

Theory of operation
-------------------
Each request opens a session of its own in a new thread, because minutes pass between two requests, and because objects of COM belong to
the thread that made them. The caller waits at most `frame_timeout_s`; a session that takes longer is abandoned, publishes no file, and
blocks later requests, with a named reason, until it ends. The frame is written into the export folder only if the settings after the scan
are those before it. Stage and load frame are never commanded: a session has no such function.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Protocol, TypeVar

from pydantic import BaseModel, ConfigDict, Field

from semlive.data.scan_report import ScanReading, ScanReport, reading_difference
from semlive.errors import LinkError, SemliveError
from semlive_drivers.microscope.frame_files import PendingFrame

_CHECK_TIMEOUT_S = 8.0
"""Longest time for opening a session and reading its settings once, at the start of a run and in checks."""
T = TypeVar("T")


class MicroscopeSettings(BaseModel):
    """Settings that all triggers of microscopes share."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    folder: Path
    """Folder into which the frames are written: the same as `sem.folder`, as an absolute path."""
    prefix: str = Field(default="frame", pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,40}$")
    """Begin of the file names; a number follows, which is never used twice."""
    frame_timeout_s: float = Field(default=300.0, gt=0, le=86_400)
    """Time after which a frame that is not complete is a fault, s."""


class Session(Protocol):
    """A connection to a microscope. Every method may raise LinkError."""

    @property
    def name(self) -> str:
        """Who answers, for messages."""
        ...

    def read(self) -> ScanReading:
        """Read the settings with which a frame would be scanned; changes nothing.

        Raises:
            LinkError: the microscope cannot scan now (beam off or blanked), or does not answer.
        """
        ...

    def scan(self, before: ScanReading, frame: PendingFrame) -> tuple[int, float | None]:
        """Scan one frame and store it in `frame`.

        Returns:
            Experiment time of the end of the scan, ns, and the row time from the arrival of the image data, s, or None.
        """
        ...

    def close(self) -> None:
        """Close the connection; never raises."""
        ...


class MicroscopeTrigger:
    """The Trigger port over sessions of a microscope.

    Args:
        open_session: opens a session; called in a new thread for each request.
        settings: validated settings.
        where: address of the microscope, for messages.
        release: called once by `close`.
    """

    def __init__(
        self, open_session: Callable[[], Session], settings: MicroscopeSettings, where: str, release: Callable[[], object] = lambda: None
    ) -> None:
        self._open_session, self._settings, self._where, self._release = open_session, settings, where, release
        self._working = threading.Lock()
        self._session: Session | None = None

    def scan_once(self) -> ScanReport:
        """Scan one frame, write it into the export folder, and return its settings before and after.

        Raises:
            LinkError: there is no frame: no or a wrong answer, beam off, settings that changed during the scan, an earlier request that
                is not finished, or the time is over.
        """
        return self._bounded(self._frame, self._settings.frame_timeout_s, "the frame was not complete")

    def report(self) -> tuple[str, ScanReading]:
        """Return the name of the microscope and its present settings; changes nothing; raises LinkError like `scan_once`."""
        return self._bounded(self._read, _CHECK_TIMEOUT_S, "no answer was complete")

    def close(self) -> None:
        """Close a session that is still open, and release the device; never raises."""
        session = self._session
        if session is not None:
            session.close()
        self._release()

    def _frame(self, is_abandoned: threading.Event) -> ScanReport:
        with self._opened() as session:
            before = session.read()
            with PendingFrame.of(self._settings.folder, self._settings.prefix) as frame:
                end_ns, row_s = session.scan(before, frame)
                after = session.read()
                if difference := reading_difference(before, after):
                    raise LinkError(
                        f"{self._where}: the frame is refused: its settings changed during the scan, {difference} before it; "
                        "leave the microscope alone while frames are taken"
                    )
                if is_abandoned.is_set():
                    raise LinkError(f"{self._where}: the frame came too late and is not used")
                return ScanReport(before, after, frame.publish(), end_ns, row_s)

    def _read(self, is_abandoned: threading.Event) -> tuple[str, ScanReading]:
        del is_abandoned  # nothing is published
        with self._opened() as session:
            return session.name, session.read()

    @contextlib.contextmanager
    def _opened(self) -> Iterator[Session]:
        self._session = session = self._open_session()
        try:
            yield session
        finally:
            self._session = None
            session.close()

    def _bounded(self, work: Callable[[threading.Event], T], timeout_s: float, late: str) -> T:
        """Call `work` in a new thread and wait for it.

        Raises:
            LinkError: that of `work`; or it did not end in time; or the work of an earlier call has not ended.
        """
        if not self._working.acquire(blocking=False):
            raise LinkError(f"{self._where}: an earlier request is not finished; check the microscope, then resume")
        results: list[T] = []
        errors: list[BaseException] = []
        is_abandoned = threading.Event()

        def run() -> None:
            try:
                results.append(work(is_abandoned))
            except Exception as error:  # the programs of vendors raise errors of their own kinds
                errors.append(error)
            finally:
                self._working.release()

        thread = threading.Thread(target=run, name="microscope", daemon=True)
        thread.start()
        thread.join(timeout_s)
        if thread.is_alive():
            is_abandoned.set()
            raise LinkError(f"{self._where}: {late} within {timeout_s:g} s; check the microscope and frame_timeout_s")
        if errors:
            error = errors[0]
            if isinstance(error, SemliveError):
                raise error
            raise LinkError(f"{self._where}: {type(error).__name__}: {' '.join(str(error).split())[:200]}") from error
        return results[0]
