"""Process of the page: ``python -m semlive.web LOG``; the first line on standard output is the port."""

from __future__ import annotations

import argparse
import os
import signal
import socket
import sys
import threading
import time
from pathlib import Path

import uvicorn

from semlive.service.runtime.garbage import enable_garbage_collection
from semlive.web.admission import Admission
from semlive.web.app import ControlAddress, make_app
from semlive.web.broadcaster import LogBroadcaster
from semlive.web.connection import bounded

_SHUTDOWN_TIMEOUT_S = 1
_BACKLOG = 16
# Connections that wait in the operating system; few, so that many new connections delay other requests by tenths of a second only.
_SYSTEM_BACKLOG = 256
_KEEP_ALIVE_S = 15
_MAX_LOG_END_S = 2.0
_DISPLAY_S = 0.5
_IDLE_S = 1.5
_MAX_VIEWERS_S = 10.0


def main() -> None:
    """Serve until a signal, or with `--exit-with-stdin` until the parent process has ended."""
    enable_garbage_collection()
    parser = argparse.ArgumentParser()
    parser.add_argument("log", type=Path)
    parser.add_argument("--host", required=True)
    parser.add_argument("--port", type=int, required=True, help="0 lets the system choose; so does a port in use, with --or-any")
    parser.add_argument("--or-any", action="store_true")
    parser.add_argument("--name", action="append", default=[], help="further name of this computer")
    parser.add_argument("--control", type=int, help="port on loopback where the run listens")
    parser.add_argument("--token-sha256", help="SHA-256 of the token of the run, in hexadecimal; needed with --control")
    parser.add_argument("--exit-with-stdin", action="store_true")
    arguments = parser.parse_args()
    if (arguments.control is None) != (arguments.token_sha256 is None):
        parser.error("give --control and --token-sha256 together")
    if hasattr(os, "nice"):
        # The page has a lower priority than control and its links, and a higher one than correlation.
        os.nice(5)
    control = None if arguments.control is None else ControlAddress("127.0.0.1", arguments.control, arguments.token_sha256)
    hub = LogBroadcaster(arguments.log)
    listening = _listen(arguments.host, arguments.port, arguments.or_any)
    admission = Admission()
    config = uvicorn.Config(
        make_app(hub, control, [arguments.host, *arguments.name], admission),
        http=bounded(admission),
        log_level="critical",
        access_log=False,
        ws="none",
        server_header=False,
        # Connections that are accepted before the first is read: far below the limit, so that each request is read first.
        backlog=_BACKLOG,
        timeout_keep_alive=_KEEP_ALIVE_S,
        timeout_graceful_shutdown=_SHUTDOWN_TIMEOUT_S,
    )
    server = _Server(config)
    if arguments.exit_with_stdin:
        threading.Thread(target=_end_with_stdin, args=(hub, server), daemon=True).start()
    sys.stdout.write(f"{listening.getsockname()[1]}\n")
    sys.stdout.flush()
    server.run(sockets=[listening])


class _Server(uvicorn.Server):
    """uvicorn's server; more connections may wait in the system than are accepted at once."""

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start listening."""
        await super().startup(sockets)
        for listener in sockets or ():
            listener.listen(_SYSTEM_BACKLOG)


def _listen(host: str, port: int, or_any: bool) -> socket.socket:
    """Create a listening socket.

    Raises:
        OSError: the address is not available.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family, backlog=128)
    except OSError:
        if not or_any or port == 0:
            raise
        return socket.create_server((host, 0), family=family, backlog=128)


def _end_with_stdin(hub: LogBroadcaster, server: uvicorn.Server) -> None:
    """Serve the last results after the parent process has closed the standard input, then end this process.

    A browser requests maps and frames after it has received the news of them, with a delay on a busy computer. Therefore the process
    ends only after an interval without requests.
    """
    while sys.stdin.buffer.read(1024):
        pass
    until_s = time.monotonic() + _MAX_LOG_END_S
    while time.monotonic() < until_s and not hub.finished:
        time.sleep(0.05)
    time.sleep(_DISPLAY_S)
    until_s, requests = time.monotonic() + _MAX_VIEWERS_S, -1
    while hub.finished and server.server_state.tasks and requests < server.server_state.total_requests and time.monotonic() < until_s:
        requests = server.server_state.total_requests
        time.sleep(_IDLE_S)
    signal.raise_signal(signal.SIGTERM)


if __name__ == "__main__":
    main()
