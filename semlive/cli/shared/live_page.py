"""Process of the live page, as commands start it."""

from __future__ import annotations

import subprocess
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from semlive.service.control.socket import SocketAddress, token_digest
from semlive.service.runtime.process import start_child

PORT = 8765
# Longer than the page waits for its open connections when it ends.
_ENDING_S = 20.0

Host = Annotated[
    str, typer.Option("--page-host", help="Address that the live page listens on; with 0.0.0.0 every computer of the network can open it.")
]
Port = Annotated[int, typer.Option("--page-port", help="Port of the live page; if it is in use, another port is chosen.", min=0, max=65535)]
Name = Annotated[
    list[str] | None, typer.Option("--page-name", help="Further name under which browsers address this computer; may be repeated.")
]


@dataclass(frozen=True, slots=True)
class PageAddress:
    """Address of the live page.

    Attributes:
        host: IP address that the page listens on.
        port: TCP port that is tried first.
        names: further names of this computer.
    """

    host: str = "127.0.0.1"
    port: int = PORT
    names: tuple[str, ...] = ()


class PageProcess:
    """The live page in a separate process, which ends when `close` is called or this process ends.

    Args:
        log: log to show.
        place: address of the page.
        ready: called in a separate thread: with the URL and "" as soon as the page listens, or with None and the last error line if it
            cannot start.
        control: address of the control socket of the run; None for a page without control. The page receives a digest of the token,
            not the token.
    """

    def __init__(
        self, log: Path, place: PageAddress, ready: Callable[[str | None, str], object], control: SocketAddress | None = None
    ) -> None:
        self._place, self._ready = place, ready
        arguments = [str(log), "--host", place.host, "--port", str(place.port), "--or-any"]
        arguments += ["--exit-with-stdin", *(part for name in place.names for part in ("--name", name))]
        if control is not None:
            arguments += ["--control", str(control.port), "--token-sha256", token_digest(control.token)]
        self._process = start_child("semlive.web", arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        threading.Thread(target=self._wait_ready, name="page", daemon=True).start()

    def close(self) -> None:
        """End the process; raises no exception."""
        if self._process.stdin is not None:
            self._process.stdin.close()
        try:
            self._process.wait(_ENDING_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def wait(self) -> int:
        """Wait for the end of the process; returns its exit code."""
        return self._process.wait()

    def _wait_ready(self) -> None:
        out, err = self._process.stdout, self._process.stderr
        if out is None or err is None:
            return
        line, last = out.readline().strip(), b""
        if line:
            self._ready(f"http://{self._shown_host()}:{int(line)}/", "")
        for message in err:  # read to the end, so that the process never blocks
            last = message.strip() or last
        if not line:
            self._ready(None, last.decode(errors="replace"))

    def _shown_host(self) -> str:
        host = "127.0.0.1" if self._place.host in ("0.0.0.0", "") else "::1" if self._place.host == "::" else self._place.host
        return f"[{host}]" if ":" in host else host
