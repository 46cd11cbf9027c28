"""File stream that retains data which the disk has rejected."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from io import FileIO, RawIOBase
from pathlib import Path
from typing import BinaryIO, cast

try:
    import fcntl
except ImportError:  # Windows, where an open file cannot be renamed or replaced anyway
    fcntl = None

# Linux accepts 1024 buffers in a call, POSIX guarantees 16.
_MAX_BUFFERS = 16
OpenRaw = Callable[[Path], RawIOBase]


def open_new(path: Path) -> RawIOBase:
    """Create a file for writing, unbuffered and locked, so that other processes can detect that it is being written.

    Raises:
        FileExistsError: the file exists; a log is never overwritten.
    """
    raw = open(path, "xb", buffering=0)  # noqa: SIM115  # the caller closes it
    if fcntl is not None:
        # Some network file systems have no locks.
        with contextlib.suppress(OSError):
            fcntl.flock(raw, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return cast(RawIOBase, raw)


def is_being_written(stream: BinaryIO) -> bool:
    """Whether another process, or another part of this one, is writing the file."""
    if fcntl is None:
        return False
    try:
        fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    fcntl.flock(stream, fcntl.LOCK_UN)
    return False


def sync_folder(folder: Path) -> None:
    """Sync the names in a folder to the disk, where the system supports it."""
    if hasattr(os, "O_DIRECTORY"):
        opened = os.open(folder, os.O_DIRECTORY)
        try:
            os.fsync(opened)
        finally:
            os.close(opened)


class BufferedLogStream:
    """Accepts every byte at once and writes on `flush`; data that a full disk rejects are retained for a later `flush`.

    The MCAP writer does not retain a chunk after passing it on: an error within a chunk would leave a gap in the log.
    """

    def __init__(self, raw: RawIOBase) -> None:
        self._raw = raw
        self._pending: list[memoryview] = []
        self._accepted = self._synced = 0

    def write(self, data: bytes) -> int:
        """Accept bytes."""
        if data:
            # Bytes are immutable, so they are stored without a copy.
            self._pending.append(memoryview(data if isinstance(data, bytes) else bytes(data)))
            self._accepted += len(data)
        return len(data)

    def tell(self) -> int:
        """Return the number of accepted bytes."""
        return self._accepted

    def flush(self) -> None:
        """Write everything to the operating system.

        Raises:
            OSError: it refused; nothing is lost, call again.
        """
        while self._pending:
            self._drop(self._write_some())

    def _write_some(self) -> int:
        """Write as much as the system accepts in one call, without concatenating the buffers."""
        if type(self._raw) is FileIO and hasattr(os, "writev"):
            return os.writev(self._raw.fileno(), self._pending[:_MAX_BUFFERS])
        return self._raw.write(self._pending[0]) or 0

    def _drop(self, written: int) -> None:
        done = 0
        while done < len(self._pending) and written >= len(self._pending[done]):
            written -= len(self._pending[done])
            done += 1
        del self._pending[:done]
        if written:
            self._pending[0] = self._pending[0][written:]

    def sync(self) -> None:
        """Sync everything to the disk; data that are already synced cost nothing.

        Raises:
            OSError: the disk refused; nothing is lost, call again.
        """
        self.flush()
        if not self._raw.closed and (self._synced < self._accepted or not self._accepted):
            accepted = self._accepted
            os.fsync(self._raw.fileno())
            self._synced = accepted

    def cut(self, position: int) -> None:
        """Truncate the file and discard pending data; later data are appended at the new end.

        Raises:
            OSError: the disk refused.
        """
        self._pending.clear()
        self._raw.truncate(position)
        self._raw.seek(position)
        self._accepted = self._synced = position

    def close(self) -> None:
        """Close the file as it is."""
        self._raw.close()

    def as_binary(self) -> BinaryIO:
        """Return this object as a binary file; a log writer uses `write`, `tell` and `flush` only."""
        return cast(BinaryIO, self)
