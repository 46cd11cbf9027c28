"""Opening files that somebody else names: regular files only, without ever waiting, and no more bytes than allowed."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import BinaryIO

from semlive.errors import BadInput


def open_regular(path: Path) -> BinaryIO:
    """A regular file for reading; pipes, devices and folders are refused without being waited for.

    Raises:
        BadInput: it is no regular file.
        OSError: it cannot be opened.
    """
    flags = os.O_RDONLY
    for name in ("O_NONBLOCK", "O_NOCTTY", "O_CLOEXEC", "O_BINARY"):
        flags |= getattr(os, name, 0)
    # Looked at first: opening a device can already do something to it.
    if not stat.S_ISREG(path.stat().st_mode):
        raise BadInput(f"{path}: is no regular file; give a file.")
    handle = os.open(path, flags)
    try:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise BadInput(f"{path}: is no regular file; give a file.")
        return os.fdopen(handle, "rb")
    except BaseException:
        os.close(handle)
        raise


def read_regular(path: Path, most_bytes: int) -> bytes:
    """All bytes of a regular file.

    Args:
        path: of the file.
        most_bytes: a longer file is refused.

    Raises:
        BadInput: it is no regular file, or too long.
        OSError: it cannot be read.
    """
    with open_regular(path) as stream:
        size = os.fstat(stream.fileno()).st_size
        if size > most_bytes:
            raise BadInput(f"{path}: is longer than {most_bytes / 1e6:.0f} MB; split it, or export less.")
        return stream.read(size)
