"""The rehearsal as a person takes it: with Enter, loads, and answers that are wrong at first, at the terminal and on the page."""

from __future__ import annotations

import http.client
import json
import os
import pty
import re
import select
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from semlive.service.log.files import messages

from ..waiting import RUN_END_S

MOVE = re.compile(r"move the specimen about .*?then press enter", re.DOTALL)
LOAD = re.compile(r"bring the load to ([\d.]+) N at .*?press enter when it is there", re.DOTALL)
PAGE = re.compile(r"live page: http://([\d.]+):(\d+)/#token=([\w-]+)")
LAST_QUESTION = re.compile(rb'"question": ?"(terminal\.\d+)", ?"text": ?"[^"]*load to 300 N')
"""The page may be seconds behind the terminal and show the question before it."""
COLOURS = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")
TUTORIAL = Path(__file__).parents[2] / "docs" / "tutorials" / "rehearsal.md"


class Person:
    """Reads a terminal and types."""

    def __init__(self, command: list[str]) -> None:
        self._terminal, other = pty.openpty()
        self.process = subprocess.Popen(command, stdin=other, stdout=other, stderr=other)
        os.close(other)
        self._text, self._read_to = "", 0
        self._question = ""
        self.page_replies: list[tuple[int, str]] = []

    def read(self) -> str | None:
        """What is new on the terminal, within 0.2 s; None at its end."""
        if not select.select([self._terminal], [], [], 0.2)[0]:
            return self._text[self._read_to :]
        try:
            self._text += os.read(self._terminal, 65536).decode(errors="replace")
        except OSError:
            return None
        return self._text[self._read_to :]

    def wait_for(self, pattern: str) -> None:
        """Read on until a text is on the terminal."""
        deadline = time.monotonic() + RUN_END_S
        while re.search(pattern, self.read() or "") is None:
            assert time.monotonic() < deadline, self._text[-2000:]
        self._read_to += len(self._text[self._read_to :])

    def answer(self, line: str) -> None:
        """Type a line."""
        self._read_to = len(self._text)
        os.write(self._terminal, line.encode() + b"\n")

    def answer_on_page(self, line: str) -> None:
        """Read the open question from the events of the page, and send an answer to it as the page does."""
        address = PAGE.search(COLOURS.sub("", self._text))
        assert address is not None, self._text
        host, port, token = address[1], int(address[2]), address[3]
        if not self._question:
            events = http.client.HTTPConnection(host, port, timeout=60)
            events.request("GET", "/events")
            stream, received = events.getresponse(), b""
            while (shown := LAST_QUESTION.search(received)) is None:
                received += stream.read1(65536)
            self._question = shown[1].decode()
            events.close()
        self._read_to = len(self._text)
        headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json", "Origin": f"http://{host}:{port}"}
        page = http.client.HTTPConnection(host, port, timeout=60)
        page.request("POST", "/say", json.dumps({"question": self._question, "answer": line}), headers)
        reply = page.getresponse()
        self.page_replies.append((reply.status, reply.read().decode()))
        assert reply.status in (200, 409), self.page_replies
        page.close()

    def rehearse(self) -> str:
        """Answer every question, loads first wrongly and the last load on the page; everything that was on the terminal."""
        deadline = time.monotonic() + RUN_END_S
        while (text := self.read()) is not None and time.monotonic() < deadline:
            if (prompt := LOAD.search(text)) is not None:
                answer = self.answer_on_page if prompt[1] == "300" else self.answer
                answer("abc")
                self.wait_for("is no load")
                answer(str(float(prompt[1]) - 30.0))
                self.wait_for("bring it nearer")
                answer(prompt[1])
                if self._question:
                    answer(prompt[1])
            elif MOVE.search(text) is not None:
                self.answer("")
        self.process.wait(RUN_END_S)
        os.close(self._terminal)
        return self._text


@dataclass(frozen=True)
class Rehearsal:
    folder: Path
    code: int
    printed: str
    page_replies: tuple[tuple[int, str], ...]

    def logged(self, topic: str) -> list[dict[str, Any]]:
        return [json.loads(message.payload) for message in messages(self.folder / "log" / "demo") if message.topic == topic]


@pytest.fixture(scope="module")
def rehearsal(tmp_path_factory: pytest.TempPathFactory) -> Rehearsal:
    folder = tmp_path_factory.mktemp("rehearsal") / "demo"
    command = [sys.executable, "-m", "semlive", "demo", "--operator", "--short", "--rate", "40", "--out", str(folder)]
    person = Person(command)
    printed = " ".join(COLOURS.sub("", person.rehearse()).split())
    return Rehearsal(folder, person.process.returncode, printed, tuple(person.page_replies))


def test_a_person_who_answers_comes_to_the_result(rehearsal: Rehearsal) -> None:
    assert rehearsal.code == 0, rehearsal.printed[-3000:]
    assert "only the simulated instrument moves" in rehearsal.printed
    assert "recovered and true values" in rehearsal.printed
    assert rehearsal.logged("/state")[-1]["after"] == "complete"
    assert len(rehearsal.logged("/pair")) == 4


@pytest.mark.checkout
def test_the_tutorial_shows_the_prompts(rehearsal: Rehearsal) -> None:
    page = [line.strip() for line in TUTORIAL.read_text(encoding="utf-8").splitlines() if line.startswith("    ")]
    shown = [line for line in page if line.startswith(("rehearsal:", "in the load frame's", "abc is", "that is"))]
    assert len(shown) == 4
    for line in shown:
        assert line in rehearsal.printed, line


def test_wrong_answers_end_no_question(rehearsal: Rehearsal) -> None:
    events = [(one["what"], one["args"]["text"]) for one in rehearsal.logged("/operator") if one["what"] in ("asked", "answered")]
    assert [what for what, _ in events] == ["asked", "answered"] * 4
    assert [text for what, text in events if what == "answered"] == ["", "", "100", "300"]
    assert "that is -30 N from 300 N" in rehearsal.printed


def test_the_last_load_is_answered_on_the_page(rehearsal: Rehearsal) -> None:
    """Wrong answers leave the question open there too; after the right one it is closed."""
    assert [status for status, _ in rehearsal.page_replies] == [200, 200, 200, 409]
    assert rehearsal.page_replies[-1][1] == '{"text":"this question is not open any more"}'


def test_the_simulator_did_what_was_answered(rehearsal: Rehearsal) -> None:
    truth = json.loads((rehearsal.folder / "instrument" / "truth.json").read_text(encoding="utf-8"))
    by_file = {frame["file"]: frame for frame in truth["frames"]}
    names = {one["export"]: one["name"] for one in rehearsal.logged("/sem/file") if one["decision"] == "arrived"}
    pairs = [[by_file[names[pair[which]["export"]]] for which in ("first", "second")] for pair in rehearsal.logged("/pair")]
    for frames, shift_px, load_n in zip(pairs, (0.0, 12.0, 0.0, 0.0), (0.0, 0.0, 100.0, 300.0), strict=True):
        for frame in frames:
            assert frame["moving"] is False
            assert frame["stage_px"][0] == pytest.approx(shift_px, abs=1.5)  # the simulated stage loses 0.8 um of backlash
            assert frame["load_mean_n"] == pytest.approx(load_n, abs=5.0)
