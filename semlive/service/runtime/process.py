"""Start of child processes in process groups of their own, which Ctrl-C does not reach; their parent ends them."""

from __future__ import annotations

import os
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from typing import IO

_starts: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
_starter_lock = threading.Lock()
_starter: list[threading.Thread] = []


def start_child(
    module: str, arguments: Sequence[str], *, stdout: int | IO[bytes], stderr: int | IO[bytes] | None = None
) -> subprocess.Popen[bytes]:
    """Start a module of semlive in a process group of its own; it ends within a second of the end of this process. From any thread.

    Raises:
        OSError: the system cannot start another process.
    """
    command = [sys.executable, "-m", "semlive.service.runtime.child_process", str(os.getpid()), module, *arguments]
    if threading.current_thread() is threading.main_thread():
        return start_in_own_group(command, stdout=stdout, stderr=stderr)
    # Linux treats the end of the thread that started a child as the end of the parent, so one thread that never ends starts all children.
    result: Future[subprocess.Popen[bytes]] = Future()

    def start() -> None:
        try:
            result.set_result(start_in_own_group(command, stdout=stdout, stderr=stderr))
        except Exception as error:
            result.set_exception(error)

    with _starter_lock:
        if not _starter:
            _starter.append(threading.Thread(target=_start_all, name="starter", daemon=True))
            _starter[0].start()
    _starts.put(start)
    return result.result()


def _start_all() -> None:
    while True:
        _starts.get()()


def start_in_own_group(
    command: Sequence[str], *, stdout: int | IO[bytes], stderr: int | IO[bytes] | None = None
) -> subprocess.Popen[bytes]:
    """Start a process in a process group of its own, with a pipe to its standard input.

    A console sends Ctrl-C to every process of the foreground group at once, but the daemon must stop devices and finish logs in order.
    """
    if sys.platform == "win32":
        flags = subprocess.CREATE_NEW_PROCESS_GROUP
        return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=stdout, stderr=stderr, creationflags=flags)
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=stdout, stderr=stderr, process_group=0)
