"""One daemon for one run: a second one is refused while the first lives, and a killed one leaves nothing behind that is in the way.

A run's folder is held in two ways. A lock of its path survives the folder: while a process writes a run, no other begins one at the same
place, also after the folder was deleted or replaced. A lock of the folder itself is seen through other mounts and by containers.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path

from semlive import process_lock
from semlive.errors import BadConfig
from semlive.process_lock import Holder, ProcessLock

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl


@contextlib.contextmanager
def run_lock(folder: Path) -> Iterator[None]:
    """Hold a run's folder for as long as the context lasts; the system lets go of it when the process dies.

    Raises:
        BadConfig: another process holds it.
    """
    with only_one_at(folder), held_itself(folder):
        yield


@contextlib.contextmanager
def only_one_at(folder: Path) -> Iterator[None]:
    """Hold the place of a run's folder, whether or not the folder exists.

    Raises:
        BadConfig: another process holds it, or did when its folder was deleted.
    """
    with contextlib.ExitStack() as stack:
        for name in _names_of(folder):
            lock = _place_lock(name, folder)
            if isinstance(lock, Holder):
                raise _refused(folder, f" ({lock})")
            stack.callback(lock.release)
        yield


def _place_lock(name: str, folder: Path) -> ProcessLock | Holder:
    try:
        return process_lock.acquire(name)
    except OSError as error:
        raise BadConfig(f"{folder} cannot be reserved for this run ({error.strerror or error}); see docs/how-to/deploy.md") from error


def _names_of(folder: Path) -> list[str]:
    """What a place is called in locks: its real path, and its name in the folder above, which may be reached by several paths."""
    real = Path(os.path.realpath(folder))
    try:
        above = real.parent.stat()
    except OSError:
        return [f"run {real}"]
    return [f"run {real}", f"run {above.st_dev} {above.st_ino} {real.name}"]


@contextlib.contextmanager
def held_itself(folder: Path) -> Iterator[None]:
    """Hold a folder that exists, which processes of containers see as well.

    Raises:
        BadConfig: another process holds it.
    """
    handle = _hold(folder)
    if handle is None:
        raise _refused(folder, "")
    try:
        yield
    finally:
        os.close(handle)


def _refused(folder: Path, holder: str) -> BadConfig:
    return BadConfig(f"{folder}: another semlive is at work on this run{holder}; wait until it has ended, or stop it")


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
