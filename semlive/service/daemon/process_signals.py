"""Signals between the daemon and the process that started it: stop signals in, notifications of the service manager out.

Theory of operation
-------------------
Python calls the signal handler in the main thread, between two instructions of the loop. The handler only counts the signal and schedules
the command of the operator, which the loop then executes. Notifications (the protocol of sd_notify(3)) never block and never raise.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import socket
import sys
from collections.abc import Iterator, Mapping

from semlive.engine import OperatorCommand
from semlive.service.control.control import Control

# SIGHUP: the terminal was closed; SIGBREAK: likewise, and Ctrl-Break, on Windows.
_STOP_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name))


class StopSignals:
    """Stop signals received so far.

    The first Ctrl-C or SIGTERM stops and finishes the run, the second aborts it. After the end of the protocol a signal skips the analysis.
    """

    def __init__(self) -> None:
        self.control: Control | None = None
        """Control of the run; None before it exists, when a signal is only counted."""
        self.count = 0
        self.skip_analysis = False

    @contextlib.contextmanager
    def handled(self) -> Iterator[None]:
        """Handle the signals; the previous handlers are restored at the end."""
        previous_handlers = {number: signal.signal(number, self._on_signal) for number in _STOP_SIGNALS}
        try:
            yield
        finally:
            for number, handler in previous_handlers.items():
                signal.signal(number, handler)

    def _on_signal(self, *_: object) -> None:
        self.count += 1
        control, command = self.control, OperatorCommand.STOP if self.count == 1 else OperatorCommand.ABORT
        if control is not None:
            self.skip_analysis = self.skip_analysis or control.dispatcher.finished.done()
            control.call_soon(control.operator.execute, command)


class SystemdNotifier:
    """Sends notifications to the service manager that the environment names; without one, does nothing.

    A notification never blocks and never raises; one that cannot be sent is lost.

    Args:
        environ: environment of this process.
        pid: identity of this process, by default the real one; a watchdog that is set for another process is ignored.
    """

    def __init__(self, environ: Mapping[str, str], pid: int | None = None) -> None:
        name = environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + name[1:] if name.startswith("@") else name
        own = environ.get("WATCHDOG_PID", "") in ("", str(os.getpid() if pid is None else pid))
        limit_us = environ.get("WATCHDOG_USEC", "")
        self.watchdog_s = int(limit_us) * 1e-6 if own and limit_us.isdigit() and self._address else None
        """The service manager kills the process after this time without a notification, s; None without a watchdog."""

    def ready(self, status: str) -> None:
        """Notify that the daemon is ready."""
        self._send(f"READY=1\nSTATUS={status}")

    def status(self, text: str) -> None:
        """Send a status line."""
        self._send(f"STATUS={text}")

    def stopping(self) -> None:
        """Notify that the daemon is stopping."""
        self._send("STOPPING=1")

    async def watchdog(self) -> None:
        """Send watchdog notifications, three per timeout, until cancelled."""
        while self.watchdog_s is not None:
            self._send("WATCHDOG=1")
            await asyncio.sleep(self.watchdog_s / 3.0)

    def _send(self, text: str) -> None:
        if not self._address or sys.platform == "win32":
            return
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
            channel.setblocking(False)  # a manager that does not read must not hold up the loop that stops a machine
            channel.sendto(text.encode("utf-8"), self._address)
