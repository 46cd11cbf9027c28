"""Regular files only, opened without blocking and read up to a stated size.

A FIFO without a writer blocks at `open`, a character device such as /dev/zero never ends, and some kernel files block at `read`:
each of them would stop a command for good.
"""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

MOST_IMAGE_BYTES = 2_000_000_000
"""Size of an image file that is still read: 32768 x 24576 px at 16 bit are 1.6e9 bytes."""

_FLAGS = os.O_RDONLY
for _name in ("O_NONBLOCK", "O_NOCTTY", "O_CLOEXEC", "O_BINARY"):  # as far as the system has them
    _FLAGS |= getattr(os, _name, 0)
_BLOCK_BYTES = 2**20


def open_regular(path: Path) -> BinaryIO:
    """A regular file, opened for reading; opening never blocks.

    Raises:
        OSError: it cannot be opened, or is a folder, a device, a FIFO or a socket.
    """
    # Before it is opened, as opening a serial port can reset what is connected; and again, as the path may be another file by then.
    _require_regular(path.stat().st_mode, path)
    descriptor = os.open(path, _FLAGS)
    try:
        _require_regular(os.fstat(descriptor).st_mode, path)
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def _require_regular(mode: int, path: Path) -> None:
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, "it is a folder", str(path))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "it is not a regular file", str(path))


def read_regular(path: Path, most_bytes: int) -> bytes:
    """The content of a regular file of limited size.

    Args:
        path: of the file.
        most_bytes: size that is still read.

    Raises:
        OSError: it cannot be opened or read, is not a regular file, or is larger than `most_bytes`.
    """
    blocks, size = list[bytes](), 0
    with open_regular(path) as stream:
        # The size that the file system reports may be 0 (kernel files) or change while it is read: what is read counts.
        while block := os.read(stream.fileno(), min(_BLOCK_BYTES, most_bytes + 1 - size)):
            blocks.append(block)
            size += len(block)
            if size > most_bytes:
                raise OSError(errno.EFBIG, f"it is larger than {_megabytes(most_bytes)}", str(path))
    return b"".join(blocks)


def _megabytes(size: int) -> str:
    return f"{size / 1e6:g} MB"
