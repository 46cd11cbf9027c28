"""Locks of a run: a second daemon is rejected while the first is running; the lock of a killed daemon is released.

A run has two locks. The lock of its path outlives the folder: while a process writes a run, no other process begins one at the same path,
even after the folder was deleted or replaced. The lock of the folder itself is visible through other mounts and in containers.
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
    """Lock the folder of a run within the context; the system releases the lock when the process ends.

    Raises:
        BadConfig: another process holds it.
    """
    with only_one_at(folder), held_itself(folder):
        yield


@contextlib.contextmanager
def only_one_at(folder: Path) -> Iterator[None]:
    """Lock the path of a run folder, whether or not the folder exists.

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
    """Return the names of a path in locks: the resolved path, and the name in the parent folder, which may have several paths."""
    real = Path(os.path.realpath(folder))
    try:
        above = real.parent.stat()
    except OSError:
        return [f"run {real}"]
    return [f"run {real}", f"run {above.st_dev} {above.st_ino} {real.name}"]


@contextlib.contextmanager
def held_itself(folder: Path) -> Iterator[None]:
    """Lock an existing folder, also for processes in containers.

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


def is_held(folder: Path) -> bool:
    """Whether a process of this computer holds the lock of an existing folder itself, or the system does not show it."""
    try:
        handle = _hold(folder)
    except OSError:
        return True
    if handle is not None:
        os.close(handle)
    return handle is None


def _refused(folder: Path, holder: str) -> BadConfig:
    return BadConfig(f"{folder}: another semlive is at work on this run{holder}; wait until it has ended, or stop it")


def _hold(folder: Path) -> int | None:
    """Return a handle that locks the folder; None if another process holds the lock."""
    if sys.platform == "win32":
        # Windows cannot lock folders, so a file in the parent folder is locked instead.
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
