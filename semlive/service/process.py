"""Child processes that Ctrl-C does not reach: their parent ends them when it is done."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import IO


def start_apart(command: Sequence[str], *, stdout: int | IO[bytes], stderr: int | IO[bytes] | None = None) -> subprocess.Popen[bytes]:
    """Start a process in a group of its own, with a pipe to its standard input.

    A console sends Ctrl-C to every process of the foreground group at once, but devices and logs must be brought to rest
    in order, by the daemon.
    """
    if sys.platform == "win32":
        flags = subprocess.CREATE_NEW_PROCESS_GROUP
        return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=stdout, stderr=stderr, creationflags=flags)
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=stdout, stderr=stderr, process_group=0)


def boot_id() -> str:
    """Identity of this computer's boot, to which the monotonic clock belongs; empty where the system does not tell."""
    path = Path("/proc/sys/kernel/random/boot_id")
    return path.read_text(encoding="ascii").strip() if os.name == "posix" and path.exists() else ""
