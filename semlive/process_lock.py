"""A lock that one process of this computer holds under a name: across users, working folders and mount namespaces.

The operating system releases it when the process ends, however it ends, and nothing is left behind that could be stale or be deleted:

| system | mechanism | limit |
|---|---|---|
| Linux | a listening socket in the abstract unix namespace | one network namespace: a container needs the host's network |
| Windows | a named mutex in the global namespace | |
| others | `flock` on a file in ``/var/tmp`` that is never removed | whoever deletes that file while it is locked defeats it |

A process that is forked from the holder without starting another program holds the lock, too.
"""

from __future__ import annotations

import contextlib
import errno
import getpass
import hashlib
import os
import socket
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

if sys.platform == "win32":
    import ctypes
else:
    import fcntl
    import pwd

_BACKLOG = 4096
"""Each refused process adds an entry to the queue of the holder's socket, which is never emptied."""
_CONNECT_TRIES = 3
_LONGEST_COMMAND = 120
_ERROR_ACCESS_DENIED, _ERROR_ALREADY_EXISTS = 5, 183


@dataclass(frozen=True, slots=True)
class Holder:
    """The process that holds a lock, as far as the system reports it.

    Attributes:
        pid: process number; 0 if unknown.
        user: account name; empty if unknown.
        command: how the process was started; empty if unknown.
    """

    pid: int = 0
    user: str = ""
    command: str = ""

    def __str__(self) -> str:
        details = ", ".join(([f"user {self.user}"] if self.user else []) + ([f"`{self.command}`"] if self.command else []))
        return f"process {self.pid or 'of unknown number'}{f' ({details})' if details else ''}"


class ProcessLock:
    """A lock that is held; made by `acquire`."""

    def __init__(self, release: Callable[[], object]) -> None:
        self._release: Callable[[], object] | None = release

    def release(self) -> None:
        """Release the lock; never raises, any number of times."""
        release, self._release = self._release, None
        if release is not None:
            with contextlib.suppress(OSError):
                release()


def acquire(name: str) -> ProcessLock | Holder:
    """The lock of a name, or who holds it; does not wait.

    Args:
        name: any text; equal texts are one lock, also within one process.

    Raises:
        OSError: the system offers no such lock here.
    """
    digest = hashlib.sha256(name.encode("utf-8", "surrogateescape")).hexdigest()[:40]
    if sys.platform == "win32":
        return _acquire_mutex(digest)
    if sys.platform == "linux":
        return _acquire_socket(digest)
    return acquire_file(Path("/var/tmp") / f"semlive-{digest}.lock")


def _acquire_socket(digest: str) -> ProcessLock | Holder:
    address = f"\0semlive-{digest}"
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        listener.bind(address)
        listener.listen(_BACKLOG)
    except OSError as error:
        listener.close()
        if error.errno != errno.EADDRINUSE:
            raise
        return _listener_of(address)
    return ProcessLock(listener.close)


def _listener_of(address: str) -> Holder:
    """The process that listens at an address, by the credentials that the kernel keeps of it."""
    for _ in range(_CONNECT_TRIES):
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
            asking.setblocking(False)
            try:
                asking.connect(address)
                credentials = asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12)
            except OSError:
                continue
        pid, uid = (int.from_bytes(credentials[at : at + 4], sys.byteorder) for at in (0, 4))
        return Holder(pid, _user(uid), _command(pid))
    return Holder()


def acquire_file(path: Path) -> ProcessLock | Holder:
    """The lock of a file, which is made if it is missing and never removed, or who holds it (POSIX only).

    Raises:
        OSError: the file cannot be made or opened.
    """
    while True:
        handle = _opened(path)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = _written_in(handle)
            os.close(handle)
            return holder
        except OSError:
            os.close(handle)
            raise
        if _is_at(handle, path):
            break
        os.close(handle)  # deleted between opening and locking
    with contextlib.suppress(OSError):
        os.ftruncate(handle, 0)
        os.pwrite(handle, f"{os.getpid()}\n{_user(os.getuid())}\n{_command(os.getpid())}\n".encode(), 0)
    return ProcessLock(lambda: os.close(handle))


def _opened(path: Path) -> int:
    """A handle of the file, which other users can lock as well, whatever the umask."""
    flags = os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW
    while True:
        with contextlib.suppress(FileNotFoundError):
            return os.open(path, flags)
        with contextlib.suppress(FileExistsError):
            handle = os.open(path, flags | os.O_CREAT | os.O_EXCL, 0o666)
            os.fchmod(handle, 0o666)
            return handle


def _is_at(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), path.lstat())
    except FileNotFoundError:
        return False


def _written_in(handle: int) -> Holder:
    """What the holder wrote of itself; whatever is not understood is unknown."""
    lines = os.pread(handle, 4096, 0).decode("utf-8", "replace").splitlines()
    pid, user, command = (*lines, "", "", "")[:3]
    return Holder(int(pid) if pid.isascii() and pid.isdigit() else 0, _printable(user), _printable(command))


def _acquire_mutex(digest: str) -> ProcessLock | Holder:
    if sys.platform != "win32":
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))
    kernel = ctypes.WinDLL("kernel32", use_last_error=True)
    kernel.CreateMutexW.restype = kernel.OpenMutexW.restype = ctypes.c_void_p
    kernel.CloseHandle.argtypes = [ctypes.c_void_p]
    handle = kernel.CreateMutexW(None, False, f"Global\\semlive-{digest}")
    status = ctypes.get_last_error()
    if handle and status != _ERROR_ALREADY_EXISTS:
        return ProcessLock(lambda: kernel.CloseHandle(handle))
    if handle:
        kernel.CloseHandle(handle)
    elif status != _ERROR_ACCESS_DENIED:  # denied: it exists, and belongs to another user
        raise ctypes.WinError(status)
    return Holder()


def _user(uid: int) -> str:
    if sys.platform == "win32":
        return getpass.getuser()
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return str(uid)


def _command(pid: int) -> str:
    """How a process was started, without the paths of interpreter and program, where the system provides it."""
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes().decode("utf-8", "replace").split("\0")
    except OSError:
        return ""
    words = [Path(word).name if place < 2 and "/" in word else word for place, word in enumerate(words) if word]
    if len(words) > 1 and words[0].startswith("python"):
        words = words[2:] if words[1] == "-m" else words[1:]
    return _printable(" ".join(words))


def _printable(text: str) -> str:
    """Without control characters, in bounded length: it is shown on a terminal."""
    shown = "".join(letter for letter in text if letter.isprintable() and letter != "`")
    return shown if len(shown) <= _LONGEST_COMMAND else shown[: _LONGEST_COMMAND - 3] + "..."
