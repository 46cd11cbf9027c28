"""Non-blocking reading of exported files: regular files of limited size only, in a thread that may hang.

A name in the export folder can refer to a kernel file that blocks, to a device without end, or to a share that does not answer. Such a read
cannot be cancelled; it continues in its thread, and other files are read in another thread.
"""

from __future__ import annotations

import errno
import os
import queue
import stat
import threading
from collections.abc import Callable
from concurrent.futures import Future, wait
from pathlib import Path

_WAIT_S = 1.0
_MAX_HANGING = 8
_NONBLOCK = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NOCTTY", 0)

Read = Callable[[Path, int], bytes]


class StillReading(Exception):
    """The read is not finished; to be tried again."""


def read_regular(path: Path, size: int) -> bytes:
    """The bytes of a regular file that is expected to hold `size` bytes.

    Raises:
        OSError: it cannot be read, is no regular file, or holds another number of bytes.
    """
    opened = os.open(path, os.O_RDONLY | _NONBLOCK)
    try:
        if not stat.S_ISREG(os.fstat(opened).st_mode):
            raise OSError(errno.EINVAL, "it is not a regular file")
        with os.fdopen(opened, "rb", closefd=False) as stream:
            data = stream.read(size + 1)
    finally:
        os.close(opened)
    if data is None or len(data) != size:
        raise OSError(errno.EIO, f"its size is {size} bytes, but not what can be read from it")
    return data


class FileReader:
    """Reads files in separate threads; to be called from one thread only.

    Args:
        wait_s: longest wait for a read in one call, wall seconds.
        read: reads a file of an expected size, in a separate thread.
    """

    def __init__(self, wait_s: float = _WAIT_S, read: Read = read_regular) -> None:
        self._wait_s, self._read = wait_s, read
        self._pending: dict[Path, Future[bytes]] = {}
        self._hanging: list[Future[bytes]] = []
        self._jobs: queue.SimpleQueue[tuple[Path, int, Future[bytes]] | None] | None = None

    def read(self, path: Path, size: int) -> bytes:
        """The bytes of a regular file.

        Args:
            path: of the file.
            size: how many bytes it is expected to hold.

        Raises:
            StillReading: it takes longer, or too many reads are pending already.
            OSError: it cannot be read, is no regular file, or holds another number of bytes.
        """
        future = self._pending.pop(path, None)
        if future is None:
            self._hanging = [read for read in self._hanging if not read.done()]
            if len(self._hanging) + sum(not read.done() for read in self._pending.values()) >= _MAX_HANGING:
                raise StillReading
            future = self._start(path, size)
            wait([future], self._wait_s)
        if not future.done():
            self._pending[path] = future
            self._abandon()
            raise StillReading
        return future.result()

    @property
    def is_hanging(self) -> bool:
        """Whether the read of any file is pending."""
        return bool(self._pending)

    def forget(self, path: Path) -> None:
        """Discard the pending read of a file."""
        future = self._pending.pop(path, None)
        if future is not None:
            self._hanging.append(future)

    def close(self) -> None:
        """End the idle thread."""
        self._abandon()

    def _abandon(self) -> None:
        """Let the thread end when its read returns, if ever; the next read starts another thread."""
        if self._jobs is not None:
            self._jobs.put(None)
        self._jobs = None

    def _start(self, path: Path, size: int) -> Future[bytes]:
        if self._jobs is None:
            self._jobs = queue.SimpleQueue()
            threading.Thread(target=self._work, args=(self._jobs,), name="file-reader", daemon=True).start()
        future: Future[bytes] = Future()
        self._jobs.put((path, size, future))
        return future

    def _work(self, jobs: queue.SimpleQueue[tuple[Path, int, Future[bytes]] | None]) -> None:
        while (job := jobs.get()) is not None:
            path, size, future = job
            try:
                future.set_result(self._read(path, size))
            except Exception as error:
                future.set_exception(error)
            del job, future
