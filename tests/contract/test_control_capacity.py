"""The operator's requests get through, whatever others open, send or leave unsent: at the page's server and at control's own socket."""

from __future__ import annotations

import asyncio
import contextlib
import http.client
import json
import queue
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import pytest

from semlive.engine import OperatorCommand
from semlive.formats.log.messages import RunMessage
from semlive.service.control.socket import ControlSocket, Request, RequestStatus, SocketAddress, send_request, token_digest
from semlive.service.log.files import segment_path
from semlive.service.log.recording import Recorder
from semlive.service.runtime.clock import SystemClock
from semlive.web.app import MAX_VIEWERS

NESTED = b'{"say":' + b"[" * 2000 + b"]" * 2000 + b"}"


@dataclass
class Stand:
    """A page over a door that notes which verbs it was given."""

    port: int
    door: SocketAddress
    verbs: list[OperatorCommand] = field(default_factory=list)

    def post(self, body: bytes, token: str | None = None) -> int:
        """The status of one request to the page."""
        line = http.client.HTTPConnection("127.0.0.1", self.port, timeout=20)
        try:
            headers = {"origin": f"http://127.0.0.1:{self.port}", "content-type": "application/json"}
            line.request("POST", "/say", body, {**headers, "authorization": f"Bearer {token or self.door.token}"})
            return line.getresponse().status
        finally:
            line.close()

    def stop(self) -> int:
        return self.post(b'{"say": "stop"}')


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stand]:
    folder = tmp_path_factory.mktemp("run")
    verbs: list[OperatorCommand] = []
    opened: queue.Queue[tuple[SocketAddress, Callable[[], object]]] = queue.Queue()
    listening = threading.Thread(target=lambda: asyncio.run(listen(verbs, opened.put)))
    listening.start()
    door, leave = opened.get(timeout=60)
    clock = SystemClock()
    recorder = Recorder(segment_path(folder, "run", 0), clock, lambda _: None)
    recorder.write("/run", RunMessage(run="run", started_time_ns=clock.now_ns(), host="lab", versions={}, config={}))
    recorder.flush()
    command = [sys.executable, "-m", "semlive.web", str(folder), "--host", "127.0.0.1", "--port", "0", "--exit-with-stdin"]
    command += ["--control", str(door.port), "--token-sha256", token_digest(door.token)]
    page = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert page.stdout is not None
    yield Stand(int(page.stdout.readline()), door, verbs)
    _, errors = page.communicate()
    recorder.close()
    leave()
    listening.join()
    assert errors == b"", "the page's process wrote to the terminal"


@pytest.fixture
def stand(running: Stand) -> Stand:
    running.verbs.clear()
    return running


async def listen(verbs: list[OperatorCommand], opened: Callable[[tuple[SocketAddress, Callable[[], object]]], object]) -> None:
    door = ControlSocket(lambda verb, _: verbs.append(verb), lambda *_: True, lambda *_: True)
    loop, over = asyncio.get_running_loop(), asyncio.Event()
    opened((await door.open(), lambda: loop.call_soon_threadsafe(over.set)))
    await over.wait()
    door.close()


@contextlib.contextmanager
def connections(port: int, count: int, sent: bytes = b"") -> Iterator[list[socket.socket]]:
    """So many connections that send something, or nothing, and then wait."""
    with contextlib.ExitStack() as stack:
        opened = [stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=20)) for _ in range(count)]
        for item in opened:
            # It may have been closed already in favour of a newer one.
            with contextlib.suppress(OSError):
                item.sendall(sent)
        yield opened


@contextlib.contextmanager
def renewed(port: int, count: int, sent: bytes = b"") -> Iterator[None]:
    """So many connections, each opened again as soon as it is closed, until the end of the context."""
    over = threading.Event()

    def keep() -> None:
        while not over.is_set():
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=20) as item:
                item.settimeout(0.2)
                item.sendall(sent)
                while not over.is_set():
                    with contextlib.suppress(TimeoutError):
                        if not item.recv(4096):
                            break

    threads = [threading.Thread(target=keep) for _ in range(count)]
    for item in threads:
        item.start()
    try:
        yield
    finally:
        over.set()
        for item in threads:
            item.join()


def ask(stand: Stand, verb: OperatorCommand) -> RequestStatus:
    return asyncio.run(send_request(stand.door.host, stand.door.port, Request(token=stand.door.token, say=verb))).heard


@pytest.mark.parametrize(
    ("count", "sent"),
    [
        (400, b""),
        (400, b"GET / HTTP/1.1\r\nhost: 127.0.0.1\r\n\r\n"),
        (400, b"GET / HTTP/1.1\r\nhost: 127.0"),
        (250, b"GET /events HTTP/1.1\r\nhost: 127.0.0.1\r\n\r\n"),
    ],
)
def test_the_page_takes_stop_whatever_number_of_connections_is_open(stand: Stand, count: int, sent: bytes) -> None:
    with connections(stand.port, count, sent):
        assert [stand.stop() for _ in range(20)] == [200] * 20
    assert stand.verbs == [OperatorCommand.STOP] * 20


def test_the_page_takes_stop_while_wrong_tokens_and_unsent_bodies_are_renewed(stand: Stand) -> None:
    head = b"POST /say HTTP/1.1\r\nhost: 127.0.0.1\r\norigin: http://127.0.0.1\r\ncontent-type: application/json\r\ncontent-length: 15\r\n"
    wrong = head + b"authorization: Bearer wrong\r\n\r\n"
    with renewed(stand.port, 20, wrong + b'{"say": "stop"}'), connections(stand.port, 250, wrong):
        began = time.monotonic()
        assert [stand.stop() for _ in range(20)] == [200] * 20
        assert time.monotonic() - began < 10.0
    assert stand.verbs == [OperatorCommand.STOP] * 20


@contextlib.contextmanager
def flooded(port: int, sent: bytes) -> Iterator[None]:
    """Connections are opened as fast as they can be, and the last 300 of them are held, until the end of the context."""
    over, held = threading.Event(), list[socket.socket]()

    def flood() -> None:
        while not over.is_set():
            with contextlib.suppress(OSError):
                held.append(socket.create_connection(("127.0.0.1", port), timeout=5))
                held[-1].sendall(sent)
            if len(held) > 300:
                held.pop(0).close()

    thread = threading.Thread(target=flood)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        for item in held:
            item.close()


@pytest.mark.parametrize("sent", [b"", b"GET /about HTTP/1.1\r\nhost: 127.0.0.1\r\n\r\n"])
def test_stop_gets_through_while_connections_are_opened_without_pause(stand: Stand, sent: bytes) -> None:
    with flooded(stand.port, sent):
        assert [stand.stop() for _ in range(10)] == [200] * 10
    with flooded(stand.door.port, b'{"token": "wrong", "say": "stop"}\n'):
        assert [ask(stand, OperatorCommand.STOP) for _ in range(10)] == [RequestStatus.ACCEPTED] * 10


@pytest.mark.parametrize("sent", [b"", b'{"token": "wrong", "say": "stop"}\n', b'{"token": '])
def test_control_takes_a_request_while_others_hold_its_socket(stand: Stand, sent: bytes) -> None:
    with renewed(stand.door.port, 40, sent), connections(stand.door.port, 200, sent):
        assert [ask(stand, verb) for verb in (OperatorCommand.PAUSE, OperatorCommand.RESUME, OperatorCommand.STOP) * 4] == [
            RequestStatus.ACCEPTED
        ] * 12
        assert stand.stop() == 200
    assert len(stand.verbs) == 13


def test_of_many_viewers_at_once_no_more_come_in_than_may(stand: Stand) -> None:
    ask_events = f"GET /events HTTP/1.1\r\nhost: 127.0.0.1:{stand.port}\r\n\r\n".encode()
    with connections(stand.port, 180) as opened:
        for item in opened:
            item.sendall(ask_events)
        statuses = [item.recv(4096).split(b" ", 2)[1] for item in opened]
    assert statuses.count(b"200") == MAX_VIEWERS
    assert statuses.count(b"503") == 180 - MAX_VIEWERS


def test_viewers_that_leave_make_room_for_others(stand: Stand) -> None:
    ask_events = f"GET /events HTTP/1.1\r\nhost: 127.0.0.1:{stand.port}\r\n\r\n".encode()
    with connections(stand.port, MAX_VIEWERS, ask_events) as opened:
        assert all(b" 200 " in item.recv(4096) for item in opened)
    deadline = time.monotonic() + 20.0
    while time.monotonic() < deadline:
        with connections(stand.port, 1, ask_events) as (item,):
            if b" 200 " in item.recv(4096):
                return
        time.sleep(0.1)
    raise AssertionError("no viewer was let in after all others had left")


@pytest.mark.parametrize("sent", [b"", b"GET / HTTP/1.1\r\nhost: 127", b"GET /about HTTP/1.1\r\nhost: 127.0.0.1\r\n\r\nGET"])
def test_a_connection_without_a_complete_request_is_closed(stand: Stand, sent: bytes) -> None:
    with connections(stand.port, 1, sent) as (item,):
        item.settimeout(15)
        with contextlib.suppress(ConnectionResetError):
            while item.recv(4096):
                pass


def test_deeply_nested_json_is_a_bad_request(stand: Stand) -> None:
    assert stand.post(NESTED) == 400
    assert stand.post(NESTED, "wrong") == 400
    assert stand.post(json.dumps(["stop"]).encode()) == 400
    with connections(stand.door.port, 1, NESTED[:4000] + b"\n") as (item,):
        assert b"no_request" in item.recv(4096)
    assert not stand.verbs
