"""Words for the service manager that started the daemon: it is ready, it lives, it stops (the protocol of sd_notify(3))."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import sys
from collections.abc import Mapping


class SystemdNotifier:
    """Speaks to the service manager that the environment names; says nothing where there is none.

    Nobody waits for it and nothing fails because of it: a word that does not get through is lost.

    Args:
        environ: of this process.
        pid: of this process; a watchdog set for another one is not ours.
    """

    def __init__(self, environ: Mapping[str, str], pid: int | None = None) -> None:
        name = environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + name[1:] if name.startswith("@") else name
        own = environ.get("WATCHDOG_PID", "") in ("", str(os.getpid() if pid is None else pid))
        limit_us = environ.get("WATCHDOG_USEC", "")
        self.watchdog_s = int(limit_us) * 1e-6 if own and limit_us.isdigit() and self._address else None
        """The process is killed when it was silent for so long; None if nobody watches."""

    def ready(self, status: str) -> None:
        """The daemon is up."""
        self._say(f"READY=1\nSTATUS={status}")

    def status(self, text: str) -> None:
        """One line for whoever asks the service manager."""
        self._say(f"STATUS={text}")

    def stopping(self) -> None:
        """The daemon is going to end."""
        self._say("STOPPING=1")

    async def watchdog(self) -> None:
        """Say that the event loop lives, three times in the time allowed, until cancelled."""
        while self.watchdog_s is not None:
            self._say("WATCHDOG=1")
            await asyncio.sleep(self.watchdog_s / 3.0)

    def _say(self, words: str) -> None:
        if not self._address or sys.platform == "win32":
            return
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as one:
            one.setblocking(False)  # a manager that does not read must not hold up the loop that stops a machine
            one.sendto(words.encode("utf-8"), self._address)
