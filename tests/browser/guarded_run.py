"""A run behind the live page: its control socket, its log and the page itself."""

from __future__ import annotations

import asyncio
import http.client
import http.server
import json
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from semlive.engine import OperatorCommand
from semlive.formats.log.messages import SEM_ORIGINAL, FileMessage, RunMessage, StateMessage
from semlive.service.control.socket import ControlSocket, SocketAddress, token_digest
from semlive.service.log.files import segment_path
from semlive.service.log.recording import Recorder
from semlive.service.runtime.clock import SystemClock


@dataclass
class Run:
    """A growing log, a control socket that records its requests, and a page that uses both."""

    port: int
    control: SocketAddress
    recorder: Recorder
    clock: SystemClock
    heard: list[tuple[OperatorCommand | str, str]] = field(default_factory=list)

    def ask(self, method: str, path: str, body: bytes = b"", **headers: str) -> tuple[int, str]:
        line = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        try:
            line.request(method, path, body or None, {name.replace("_", "-"): value for name, value in headers.items()})
            reply = line.getresponse()
            return reply.status, reply.read(10_000).decode(errors="replace")
        finally:
            line.close()

    def say(self, body: Any, **headers: str) -> tuple[int, str]:
        own = {
            "origin": f"http://127.0.0.1:{self.port}",
            "content_type": "application/json",
            "authorization": f"Bearer {self.control.token}",
        }
        return self.ask("POST", "/say", json.dumps(body).encode(), **{**own, **headers})

    def export(self, number: int, name: str) -> None:
        """A file that nobody can read arrives."""
        reported = FileMessage(export=number, name=name, size=4, sha256="", mtime_ns=0, arrival_time_ns=0, decision="arrived", reason="")
        self.recorder.write(SEM_ORIGINAL, b"none", sequence=number)
        self.recorder.write("/sem/file", reported)
        self.recorder.flush()

    def enter(self, state: str) -> None:
        now_ns = self.clock.now_ns()
        self.recorder.write("/state", StateMessage(time_ns=now_ns, before="idle", after=state, cause="start", step=0, guards={}))


@contextmanager
def guarded_run(folder: Path) -> Iterator[Run]:
    """A run with a control socket, and its page, in a folder."""
    heard: list[tuple[OperatorCommand | str, str]] = []
    opened: queue.Queue[tuple[SocketAddress, Callable[[], object]]] = queue.Queue()
    listening = threading.Thread(target=lambda: asyncio.run(listen(heard, opened.put)))
    listening.start()
    control, leave = opened.get(timeout=60)
    clock = SystemClock()
    recorder = Recorder(segment_path(folder, "run", 0), clock, lambda _: None)
    recorder.write("/run", RunMessage(run="run", started_time_ns=clock.now_ns(), host="lab", versions={}, config={}))
    process = page_of(folder, "--control", str(control.port), "--token-sha256", token_digest(control.token))
    assert process.stdout is not None
    item = Run(int(process.stdout.readline()), control, recorder, clock, heard)
    item.enter("holding")
    yield item
    process.communicate()
    recorder.close()
    leave()
    listening.join()


async def listen(
    heard: list[tuple[OperatorCommand | str, str]], opened: Callable[[tuple[SocketAddress, Callable[[], object]]], object]
) -> None:
    """A door, until it is left."""
    door = ControlSocket(
        lambda verb, by: heard.append((verb, by)),
        lambda question, line: (question, line) == ("terminal.1", "5"),
        lambda alarm, by: alarm != "6" and not heard.append((alarm, by)),
    )
    loop, over = asyncio.get_running_loop(), asyncio.Event()
    opened((await door.open(), lambda: loop.call_soon_threadsafe(over.set)))
    await over.wait()
    door.close()


def page_of(folder: Path, *options: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "semlive.web", str(folder), "--host", "127.0.0.1", "--port", "0", "--exit-with-stdin", *options]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
