"""A file that never loses what it could not write yet."""

from __future__ import annotations

import os
from collections.abc import Callable
from io import RawIOBase
from pathlib import Path
from typing import BinaryIO, cast

OpenRaw = Callable[[Path], RawIOBase]


def open_new(path: Path) -> RawIOBase:
    """A new file for writing, unbuffered.

    Raises:
        FileExistsError: there is one already; a log is never overwritten.
    """
    return cast(RawIOBase, open(path, "xb", buffering=0))


class PatientStream:
    """Takes every byte at once and writes on `flush`; what a full disk refuses is kept and written by a later `flush`.

    The MCAP writer forgets a chunk when it has handed it over: an error half way through would leave a hole in the log.
    """

    def __init__(self, raw: RawIOBase) -> None:
        self._raw = raw
        self._waiting: list[memoryview] = []
        self._taken = 0

    def write(self, data: bytes) -> int:
        """Take bytes."""
        if data:
            self._waiting.append(memoryview(bytes(data)))
            self._taken += len(data)
        return len(data)

    def tell(self) -> int:
        """How many bytes were taken."""
        return self._taken

    def flush(self) -> None:
        """Hand everything to the operating system.

        Raises:
            OSError: it refused; nothing is lost, call again.
        """
        while self._waiting:
            written = self._raw.write(self._waiting[0]) or 0
            rest = self._waiting[0][written:]
            if rest:
                self._waiting[0] = rest
            else:
                del self._waiting[0]

    def sync(self) -> None:
        """Make everything survive a loss of power.

        Raises:
            OSError: the disk refused; nothing is lost, call again.
        """
        self.flush()
        if not self._raw.closed:
            os.fsync(self._raw.fileno())

    def close(self) -> None:
        """Close the file as it is."""
        self._raw.close()

    def as_binary(self) -> BinaryIO:
        """The same object for those who ask for a file: write, tell and flush are all that a log writer uses."""
        return cast(BinaryIO, self)
