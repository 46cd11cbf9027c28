"""`semlive run` as a child process in the foreground of a terminal."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import IO


def run_daemon(config: Path, *options: str, output: IO[bytes] | None = None) -> int:
    """Run the daemon in the foreground; the daemon handles Ctrl-C, and this process waits until it has stopped the load frame.

    Args:
        config: path of the configuration.
        options: options of `semlive run`.
        output: file for the messages of the daemon; None: the terminal.
    """
    process = subprocess.Popen([sys.executable, "-m", "semlive", "run", str(config), *options], stdout=output, stderr=output)
    while True:
        try:
            return process.wait()
        except KeyboardInterrupt:
            continue
