"""Reading of regular files only, without blocking and up to a limit.

A FIFO without a writer blocks at `open`, a character device such as /dev/zero never ends, and some kernel files block at `read`:
each of them would block a command permanently.
"""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

MAX_IMAGE_BYTES = 2_000_000_000
"""Largest size of an image file that is read: 32768 x 24576 px at 16 bit are 1.6e9 bytes."""

_FLAGS = os.O_RDONLY
for _name in ("O_NONBLOCK", "O_NOCTTY", "O_CLOEXEC", "O_BINARY"):  # flags that the system supports
    _FLAGS |= getattr(os, _name, 0)
_BLOCK_BYTES = 2**20


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file for reading; opening never blocks.

    Raises:
        OSError: the file cannot be opened, or is a folder, a device, a FIFO or a socket.
    """
    # Checked before opening, because opening a serial port can reset a device, and again, because the path may refer to another file then.
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


def read_regular(path: Path, max_bytes: int) -> bytes:
    """Return the content of a regular file of limited size.

    Args:
        path: path of the file.
        max_bytes: largest size that is read.

    Raises:
        OSError: the file cannot be opened or read, is not a regular file, or is larger than `max_bytes`.
    """
    blocks, size = list[bytes](), 0
    with open_regular(path) as stream:
        # The size in the file system may be 0 (kernel files) or change during reading, so the number of read bytes is limited.
        while block := os.read(stream.fileno(), min(_BLOCK_BYTES, max_bytes + 1 - size)):
            blocks.append(block)
            size += len(block)
            if size > max_bytes:
                raise OSError(errno.EFBIG, f"it is larger than {_megabytes(max_bytes)}", str(path))
    return b"".join(blocks)


def _megabytes(size: int) -> str:
    return f"{size / 1e6:g} MB"
