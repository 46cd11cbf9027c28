"""Output and priority of the analysis process: lowest priority, first to be killed, with periodic signs of life."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import IO

from semlive.formats.log.reader import LogMessage
from semlive.service.analysis.pipe import HEARTBEAT, write_message

_BEAT_S = 1.0
# A pair of 16 million pixels takes some seconds, the conclusion of 22 pairs took two minutes on a busy computer.
_STUCK_S = 600.0
_FIRST_TO_GO = "500"


class OutputStream:
    """Writes outputs and, if requested, a sign of life every second, except after ten minutes in one message."""

    def __init__(self, stream: IO[bytes], beats: bool) -> None:
        self._stream = stream
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._busy_since_s: float | None = None
        self._thread = threading.Thread(target=self._beat, name="beat", daemon=True) if beats else None

    def __enter__(self) -> OutputStream:
        if self._thread is not None:
            self._thread.start()
        return self

    def __exit__(self, _kind: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None) -> None:
        self._over.set()
        if self._thread is not None:
            self._thread.join()

    def write(self, message: LogMessage) -> None:
        """Write one output."""
        with self._lock:
            write_message(self._stream, message)

    @contextlib.contextmanager
    def busy(self) -> Iterator[None]:
        """Mark the processing of one message."""
        self._busy_since_s = time.monotonic()
        yield
        self._busy_since_s = None

    def _beat(self) -> None:
        while not self._over.wait(_BEAT_S):
            since_s = self._busy_since_s
            if since_s is not None and time.monotonic() - since_s > _STUCK_S:
                continue
            try:
                with self._lock:
                    write_message(self._stream, HEARTBEAT)
            except OSError:
                # Control died, and what was announced may never come into the log: nobody waits for us any more.
                os._exit(1)


def lower_priority() -> None:
    """Lower the priority for processors and memory below all processes that supervise the machine; control ends this process."""
    if hasattr(os, "nice"):
        # Links, watcher and recorder come first: they are late by milliseconds if correlation takes both cores.
        os.nice(10)
    # Where memory is short Linux ends this process, which is started again, and not control.
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(_FIRST_TO_GO, encoding="ascii")
    for name in ("SIGTERM", "SIGHUP"):
        # A service manager tells the whole group to end; control ends us when the log is whole.
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
