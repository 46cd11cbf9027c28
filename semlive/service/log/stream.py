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

# Linux takes 1024 pieces in a call, POSIX promises 16.
_PIECES = 16
OpenRaw = Callable[[Path], RawIOBase]


def open_new(path: Path) -> RawIOBase:
    """A new file for writing, unbuffered; others can see that it is being written.

    Raises:
        FileExistsError: there is one already; a log is never overwritten.
    """
    raw = open(path, "xb", buffering=0)  # noqa: SIM115  # whoever asked for it closes it
    if fcntl is not None:
        # Some network file systems know no locks.
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
    """Make names in a folder survive a loss of power, where the system can."""
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
        self._waiting: list[memoryview] = []
        self._taken = self._safe = 0

    def write(self, data: bytes) -> int:
        """Accept bytes."""
        if data:
            # Bytes never change, so they are kept as they are.
            self._waiting.append(memoryview(data if isinstance(data, bytes) else bytes(data)))
            self._taken += len(data)
        return len(data)

    def tell(self) -> int:
        """Return the number of accepted bytes."""
        return self._taken

    def flush(self) -> None:
        """Write everything to the operating system.

        Raises:
            OSError: it refused; nothing is lost, call again.
        """
        while self._waiting:
            self._drop(self._write_some())

    def _write_some(self) -> int:
        """Write as much as the system accepts in one call, without concatenating the buffers."""
        if type(self._raw) is FileIO and hasattr(os, "writev"):
            return os.writev(self._raw.fileno(), self._waiting[:_PIECES])
        return self._raw.write(self._waiting[0]) or 0

    def _drop(self, written: int) -> None:
        done = 0
        while done < len(self._waiting) and written >= len(self._waiting[done]):
            written -= len(self._waiting[done])
            done += 1
        del self._waiting[:done]
        if written:
            self._waiting[0] = self._waiting[0][written:]

    def sync(self) -> None:
        """Sync everything to the disk; data that are already synced cost nothing.

        Raises:
            OSError: the disk refused; nothing is lost, call again.
        """
        self.flush()
        if not self._raw.closed and (self._safe < self._taken or not self._taken):
            taken = self._taken
            os.fsync(self._raw.fileno())
            self._safe = taken

    def cut(self, position: int) -> None:
        """Truncate the file and discard pending data; later data are appended at the new end.

        Raises:
            OSError: the disk refused.
        """
        self._waiting.clear()
        self._raw.truncate(position)
        self._raw.seek(position)
        self._taken = self._safe = position

    def close(self) -> None:
        """Close the file as it is."""
        self._raw.close()

    def as_binary(self) -> BinaryIO:
        """The same object for those who ask for a file: write, tell and flush are all that a log writer uses."""
        return cast(BinaryIO, self)
