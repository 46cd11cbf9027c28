"""Notifications to the service manager that started the daemon: ready, watchdog, stopping (the protocol of sd_notify(3))."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import sys
from collections.abc import Mapping


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
