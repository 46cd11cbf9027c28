"""Evaluates the pairs of a qualifying run in a separate process, and stops the run as soon as no further pair is needed."""

from __future__ import annotations

import asyncio
import subprocess
import threading
from collections.abc import Callable
from pathlib import Path

from semlive.engine import OperatorCommand
from semlive.service.control.socket import Request, SocketAddress, send_request
from semlive.service.runtime.process import start_child

ENOUGH = "every figure is known well enough; the run ends"
_ORIGIN = "semlive qualify"
_LAST_LINES_S = 5.0
"""Longest wait for the last messages of the process after its end, s."""


class QualificationProcess:
    """`semlive qualify --follow` of a run in progress, whose messages are shown in the terminal of the run.

    A process of its own, because an evaluation takes seconds, and the loop of the run must not wait. If it fails, its message is shown and
    the run continues to its last pair.

    Args:
        log: run folder.
        show_line: shows a line, from any thread; returns at once.

    Attributes:
        has_stopped_run: whether the run was stopped because no further pair is needed.
    """

    def __init__(self, log: Path, show_line: Callable[[str], object]) -> None:
        self._log, self._show_line, self.has_stopped_run = log, show_line, False
        self._process: subprocess.Popen[bytes] | None = None
        self._ended = threading.Event()

    def start(self, control: SocketAddress) -> None:
        """Start the process.

        Args:
            control: address of the control socket of the run.
        """
        arguments = ["qualify", "--from", str(self._log), "--follow", "--quick"]
        self._process = start_child("semlive", arguments, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        threading.Thread(target=self._wait, args=(self._process, control), name="qualification", daemon=True).start()

    def close(self) -> None:
        """End the process; raises no exception."""
        if self._process is not None:
            self._process.kill()
            self._ended.wait(_LAST_LINES_S)

    def _wait(self, process: subprocess.Popen[bytes], control: SocketAddress) -> None:
        with process:
            for line in process.stderr or ():
                if text := line.decode(errors="replace").strip():
                    self._show_line(text)
        if process.returncode == 0:
            self._stop_run(control)
        self._ended.set()

    def _stop_run(self, control: SocketAddress) -> None:
        """Stop the run, unless it has ended, which ends the evaluation too."""
        request = Request(token=control.token, by=_ORIGIN, say=OperatorCommand.STOP)
        try:
            asyncio.run(send_request(control.host, control.port, request))
        except OSError:  # nothing listens any more
            return
        self.has_stopped_run = True
        self._show_line(ENOUGH)
