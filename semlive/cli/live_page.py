"""The live page's process, as commands start it."""

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
# As long as the page itself waits for those who still look, and some time to end.
_ENDING_S = 20.0

Host = Annotated[str, typer.Option("--page-host", help="Address that the live page listens on; 0.0.0.0 shows it to the whole network.")]
Port = Annotated[int, typer.Option("--page-port", help="Its port; another is taken if it is not free.", min=0, max=65535)]
Name = Annotated[list[str] | None, typer.Option("--page-name", help="A further name by which browsers call this computer.")]


@dataclass(frozen=True, slots=True)
class PageAddress:
    """Where a page listens.

    Attributes:
        host: address.
        port: TCP port that is tried first.
        names: further names of this computer.
    """

    host: str = "127.0.0.1"
    port: int = PORT
    names: tuple[str, ...] = ()


class PageProcess:
    """The page in a process of its own, which ends when `close` is called or this process is gone.

    Args:
        log: what it reads.
        place: where it listens.
        ready: told its address when it listens, or None and its last words if it does not come up; in a thread of ours.
        control: where on loopback the run can be spoken to; None for a page that only shows. The page gets a digest of the token, not
            the token itself.
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
        """End it; never raises."""
        if self._process.stdin is not None:
            self._process.stdin.close()
        try:
            self._process.wait(_ENDING_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def wait(self) -> int:
        """Until it ends by itself; its exit code."""
        return self._process.wait()

    def _wait_ready(self) -> None:
        out, err = self._process.stdout, self._process.stderr
        if out is None or err is None:
            return
        line, last = out.readline().strip(), b""
        if line:
            self._ready(f"http://{self._shown_host()}:{int(line)}/", "")
        for said in err:  # to its end, so that it never waits for a reader
            last = said.strip() or last
        if not line:
            self._ready(None, last.decode(errors="replace"))

    def _shown_host(self) -> str:
        host = "127.0.0.1" if self._place.host in ("0.0.0.0", "") else "::1" if self._place.host == "::" else self._place.host
        return f"[{host}]" if ":" in host else host
