"""One daemon for one run: a second one is refused while the first lives, and a killed one leaves nothing behind that is in the way."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path

from semlive.errors import BadConfig

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl


@contextlib.contextmanager
def only_one(folder: Path) -> Iterator[None]:
    """Hold a run's folder for as long as the context lasts; the system lets go of it when the process dies.

    Raises:
        BadConfig: another process holds it.
    """
    handle = _hold(folder)
    if handle is None:
        raise BadConfig(f"{folder}: another semlive is at work on this run; wait until it has ended, or stop it")
    try:
        yield
    finally:
        os.close(handle)


def _hold(folder: Path) -> int | None:
    """A handle that holds the folder, or None if somebody else does."""
    if sys.platform == "win32":
        # Windows locks no folders: a file beside it stands for it.
        handle = os.open(folder.with_name(f".{folder.name}.lock"), os.O_RDWR | os.O_CREAT)
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except OSError:
            os.close(handle)
            return None
        return handle
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        return None
    return handle
