"""A run is steered from another process: with its token, over its own socket, and a person's answers come that way too."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest

from semlive.engine import OperatorCommand
from semlive.service.control.socket import LINE_BYTES, Reply, Request, RequestStatus, send_request

from ..waiting import GrowingLog, logged

DAEMON = """
import json, queue, sys
from dataclasses import asdict
from pathlib import Path
from semlive.service.config.configuration import load_config
from semlive.service.daemon import RunInterface, run_experiment

show = lambda address: print(json.dumps(asdict(address)), flush=True)
run_experiment(load_config(Path(sys.argv[1])), RunInterface(lambda _: None, queue.SimpleQueue(), attended=True, on_socket_open=show))
"""


@dataclass
class Steered:
    """A daemon in a process of its own, and its address."""

    process: subprocess.Popen[str]
    address: dict[str, Any]
    one: Any
    wait_until: Callable[..., None]
    growing: GrowingLog = field(init=False)

    def __post_init__(self) -> None:
        self.growing = GrowingLog(self.one.log)

    def ask(self, **fields: Any) -> Reply:
        request = Request(**{"token": self.address["token"], **fields})
        return asyncio.run(send_request(self.address["host"], self.address["port"], request))

    def logged(self, topic: str) -> list[dict[str, Any]]:
        """Messages of a topic; of a daemon that has ended also those after the last complete chunk."""
        return self.growing.logged(topic) if self.process.poll() is None else logged(self.one.log, topic)

    def reach(self, state: str, times: int = 1) -> None:
        self.wait_until(lambda: sum(reported["after"] == state for reported in self.logged("/state")) >= times)

    def words(self, kind: str) -> list[dict[str, Any]]:
        return [reported["args"] for reported in self.logged("/operator") if reported["what"] == kind]


@pytest.fixture(scope="module")
def steered(instrument: Callable[..., Any], wait_until: Callable[..., None]) -> Iterator[Steered]:
    one = instrument("steered")
    one.config["load_frame"] = {"driver": "operator", "settings": {"program": "MICROTEST"}}
    # A hold of a minute: nobody waits for its end, and it must not end before somebody pauses it.
    one.config["protocol"].update(calibration_shifts_px=[], loads_n=[100.0], settle_s=1.0, hold_s=1200.0)
    command = [sys.executable, "-c", DAEMON, str(one.write_config())]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    yield Steered(process, json.loads(process.stdout.readline()), one, wait_until)
    if process.poll() is None:
        process.kill()
    process.communicate()


def send(steered: Steered, line: bytes) -> bytes:
    where = (steered.address["host"], steered.address["port"])
    # A line that is too long may be met with a reset instead of an end.
    with contextlib.suppress(ConnectionError), socket.create_connection(where, timeout=60) as caller:
        caller.sendall(line)
        return caller.makefile("rb").readline()
    return b""


def test_requests_without_the_token_are_refused(steered: Steered) -> None:
    steered.wait_until(lambda: len(steered.words("asked")) == 1)
    for token in ("", "a", steered.address["token"][:-1], steered.address["token"] + "a"):
        assert steered.ask(token=token, say=OperatorCommand.ABORT).heard is RequestStatus.UNAUTHORISED
    reported = {"token": "", "question": "terminal.1", "answer": "100"}
    assert Reply.model_validate_json(send(steered, json.dumps(reported).encode() + b"\n")).heard is RequestStatus.UNAUTHORISED
    assert steered.logged("/state")[-1]["after"] == "ramping"
    assert {reported["what"] for reported in steered.logged("/operator")} == {"start", "asked"}


@pytest.mark.parametrize(
    "line", [b"\n", b"stop\n", b'{"say": "stop"}\n', b"[" * 3000 + b"\n", b'{"token": "%s", "say": "jump"}\n', b"\xff\xfe\n"]
)
def test_what_is_no_request_is_rejected(steered: Steered, line: bytes) -> None:
    line = line.replace(b"%s", steered.address["token"].encode())
    assert Reply.model_validate_json(send(steered, line)).heard is RequestStatus.NO_REQUEST


def test_a_line_that_is_too_long_is_not_read(steered: Steered) -> None:
    assert send(steered, b"x" * (4 * LINE_BYTES)) == b""
    assert steered.ask(question="terminal.7", answer="").heard is RequestStatus.QUESTION_CLOSED
    assert steered.ask(question="nobody.1", answer="").heard is RequestStatus.QUESTION_CLOSED
    assert steered.ask(acknowledge="5").heard is RequestStatus.QUESTION_CLOSED


def test_a_load_is_entered_from_elsewhere(steered: Steered) -> None:
    (prompt,) = steered.words("asked")
    assert prompt["text"].startswith("in MICROTEST, bring the load to 100 N at ")
    assert (prompt["question"], prompt["wanted"]) == ("terminal.1", "load_n")
    assert steered.ask(question=prompt["question"], answer="ninety").heard is RequestStatus.ACCEPTED
    steered.wait_until(lambda: len(steered.words("told")) == 1)
    assert steered.words("told")[0]["text"] == "ninety is no load; type the load in N as MICROTEST shows it"
    assert not steered.words("answered")
    assert steered.ask(question=prompt["question"], answer=" 99,5 ").heard is RequestStatus.ACCEPTED
    steered.reach("holding")
    (answered,) = steered.words("answered")
    assert (answered["text"], answered["question"]) == ("99,5", "terminal.1")
    assert steered.logged("/load_frame/sample")[-1]["force_n"] == 99.5
    assert steered.ask(question=prompt["question"], answer="99.5").heard is RequestStatus.QUESTION_CLOSED


def test_a_run_is_paused_resumed_and_stopped_from_elsewhere(steered: Steered) -> None:
    assert steered.ask(say=OperatorCommand.PAUSE, by="page").heard is RequestStatus.ACCEPTED
    steered.reach("paused")
    assert steered.ask(say=OperatorCommand.RESUME, by="page").heard is RequestStatus.ACCEPTED
    steered.wait_until(lambda: len(steered.words("asked")) == 2)
    assert steered.ask(say=OperatorCommand.STOP, by="page").heard is RequestStatus.ACCEPTED
    assert steered.process.wait(150) == 0
    last = steered.logged("/state")[-1]
    assert (last["after"], last["before"]) == ("aborted", "stopping")
    assert steered.words("taken_back")[-1]["question"] == "terminal.2"
    printed = {reported["what"]: reported["args"] for reported in steered.logged("/operator") if reported["what"] in list(OperatorCommand)}
    assert printed == {"start": {}, "pause": {"by": "page"}, "resume": {"by": "page"}, "stop": {"by": "page"}}
    with pytest.raises(ConnectionRefusedError):
        steered.ask(say=OperatorCommand.ABORT)
