"""Alerts: which messages of a log are reported, and that real servers receive them."""

from __future__ import annotations

import json
import socketserver
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from semlive.cli.app import app
from semlive.errors import BadConfig
from semlive.formats.log.messages import FaultMessage, OperatorMessage, Payload, StateMessage, to_json, topic_of
from semlive.formats.log.reader import LogMessage
from semlive.service.alerts.events import alert_of
from semlive.service.alerts.sender import AlertSender
from semlive.service.alerts.targets import read_targets
from semlive.service.config.sections import AlertEvent

ALL = frozenset(AlertEvent)


def fault(text: str = "the load cell froze", kind: str = "device") -> FaultMessage:
    return FaultMessage(time_ns=1, what=text, where="load frame", action="stopped", code="no_response", kind=kind)


def state(after: str, cause: str) -> StateMessage:
    return StateMessage(time_ns=1, before="imaging", after=after, cause=cause, step=1, guards={})


def prompt(what: str = "asked") -> OperatorMessage:
    return OperatorMessage(time_ns=1, what=what, args={"text": "Bring the load to 300 N."})


@pytest.mark.parametrize(
    ("message", "event"),
    [
        (fault(), AlertEvent.FAULT),
        (prompt(), AlertEvent.QUESTION),
        (state("paused", "poor_calibration"), AlertEvent.QUESTION),
        (state("paused", "warm_up_timeout"), AlertEvent.QUESTION),
        (state("ramping", "warm"), AlertEvent.WARM_UP),
        (state("complete", "last_step"), AlertEvent.END),
        (state("aborted", "abort"), AlertEvent.END),
        (fault(kind="model_warning"), None),
        (fault(kind="pair_unusable"), None),
        (prompt("answered"), None),
        (prompt("pause"), None),
        (state("imaging", "hold_over"), None),
    ],
)
def test_events_that_need_a_person_are_reported(message: Payload, event: AlertEvent | None) -> None:
    alert = alert_of(message, "al-1")
    assert (None if alert is None else alert.event) == event
    assert alert is None or alert.title.startswith("al-1: ")


class Mailbox(socketserver.StreamRequestHandler):
    """A mail server that accepts everything (RFC 5321)."""

    def handle(self) -> None:
        self.wfile.write(b"220 local\r\n")
        for line in self.rfile:
            verb = line[:4].upper()
            if verb == b"DATA":
                self.wfile.write(b"354 end with a dot\r\n")
                mail = b""
                while not mail.endswith(b"\r\n.\r\n"):
                    mail += self.rfile.readline()
                self.server.received.append(mail.decode())  # type: ignore[attr-defined]
            self.wfile.write(b"221 bye\r\n" if verb == b"QUIT" else b"250 ok\r\n")
            if verb == b"QUIT":
                return


class Webhook(BaseHTTPRequestHandler):
    """A web server that keeps what is posted, after it refused as often as it should."""

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        server: Any = self.server
        refuse = server.refusals > 0
        server.refusals -= refuse
        if not refuse:
            server.received.append({"path": self.path, **json.loads(body)})
        self.send_response(503 if refuse else 200)
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None:
        del format, args


@contextmanager
def serving(kind: type[socketserver.BaseRequestHandler], refusals: int = 0) -> Iterator[tuple[int, list[Any]]]:
    server: Any = (ThreadingHTTPServer if kind is Webhook else socketserver.ThreadingTCPServer)(("127.0.0.1", 0), kind)
    server.received, server.refusals = [], refusals
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield server.server_address[1], server.received
    finally:
        server.shutdown()
        server.server_close()


def message_of(payload: Payload) -> LogMessage:
    return LogMessage(topic_of(payload), 1, 1, 0, to_json(payload))


def addresses(folder: Path, *lines: str) -> Path:
    path = folder / "alerts.txt"
    path.write_text("# where alerts go\n\n" + "\n".join(lines) + "\n", encoding="utf-8")
    return path


def sent(folder: Path, *lines: str, messages: tuple[Payload, ...], events: frozenset[AlertEvent] = ALL) -> list[str]:
    troubles: list[str] = []
    sender = AlertSender(read_targets(addresses(folder, *lines)), events, "al-1", troubles.append, (0.0, 0.05, 0.05))
    for message in messages:
        sender.on_message(message_of(message))
    deadline_s = time.monotonic() + 20.0
    while not sender.idle and time.monotonic() < deadline_s:
        time.sleep(0.01)
    sender.close()
    return troubles


def test_a_webhook_and_a_mailbox_receive_each_alert_once(tmp_path: Path) -> None:
    with serving(Webhook) as (port, posts), serving(Mailbox) as (mail_port, mails):
        lines = (f"json://127.0.0.1:{port}/hook", f"mailto://127.0.0.1:{mail_port}?from=lab@local.test&to=me@local.test&mode=insecure")
        assert sent(tmp_path, *lines, messages=(fault(), prompt("answered"), state("complete", "last_step"))) == []
    assert [post["title"] for post in posts] == ["al-1: fault", "al-1: complete"]
    assert posts[0]["message"] == "the load cell froze (load frame). Reaction: stopped."
    assert len(mails) == 2
    assert "al-1: fault" in mails[0]


@pytest.mark.parametrize(
    ("address", "path", "title"),
    [
        ("ntfy://127.0.0.1:{port}/sem", "/", "title"),
        ("gotify://127.0.0.1:{port}/abcdef123", "/message", "title"),
        ("mmost://127.0.0.1:{port}/abcdefghijklmnop", "/hooks/abcdefghijklmnop", "text"),
    ],
)
def test_messengers_receive_fault_question_warm_up_and_end(tmp_path: Path, address: str, path: str, title: str) -> None:
    messages = (fault(), prompt(), state("ramping", "warm"), state("aborted", "abort"))
    with serving(Webhook) as (port, posts):
        assert sent(tmp_path, address.format(port=port), messages=messages) == []
    assert [post["path"].partition("?")[0] for post in posts] == [path] * 4
    titles = [post[title].splitlines()[0] for post in posts]
    assert titles == ["al-1: fault", "al-1: question", "al-1: warm-up complete", "al-1: aborted"]


def test_a_fault_and_a_question_have_levels_of_their_own(tmp_path: Path) -> None:
    with serving(Webhook) as (port, posts):
        messages = (fault(), prompt(), state("complete", "last_step"))
        assert sent(tmp_path, f"json://127.0.0.1:{port}", messages=messages) == []
    assert [post["type"] for post in posts] == ["failure", "warning", "info"]


def test_only_the_chosen_events_are_sent(tmp_path: Path) -> None:
    with serving(Webhook) as (port, posts):
        chosen = frozenset((AlertEvent.END,))
        assert sent(tmp_path, f"json://127.0.0.1:{port}", messages=(fault(), state("complete", "last_step")), events=chosen) == []
    assert [post["title"] for post in posts] == ["al-1: complete"]


def test_an_alert_that_is_refused_is_sent_again(tmp_path: Path) -> None:
    with serving(Webhook, refusals=2) as (port, posts):
        assert sent(tmp_path, f"json://127.0.0.1:{port}", messages=(fault(),)) == []
    assert len(posts) == 1


def test_an_address_that_never_answers_is_named_without_its_password(tmp_path: Path) -> None:
    with serving(Webhook) as (port, posts):
        lines = ("json://user:secret@127.0.0.1:9/dead", f"json://127.0.0.1:{port}")
        troubles = sent(tmp_path, *lines, messages=(fault(),))
    assert len(posts) == 1
    assert troubles == ["the alert 'al-1: fault' was not accepted by line 3 (json) of alerts.file; check address and network"]


def test_a_fault_that_repeats_does_not_fill_a_mailbox_but_the_end_is_sent(tmp_path: Path) -> None:
    with serving(Webhook) as (port, posts):
        faults = tuple(fault(f"fault {number}") for number in range(60))
        assert sent(tmp_path, f"json://127.0.0.1:{port}", messages=(*faults, state("aborted", "abort"))) == []
    assert len(posts) == 21
    assert "held back for 10 min" in posts[19]["message"]
    assert posts[20]["title"] == "al-1: aborted"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "holds 0 addresses"),
        ("json://host\n" * 17, "holds 17 addresses"),
        ("pigeon://user:secret@roof", "line 1: is no address"),
        ("json://host\nme@example.org", "line 2: is no address"),
    ],
)
def test_a_wrong_file_of_addresses_is_refused_without_showing_them(tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "alerts.txt"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(BadConfig, match=reason) as refused:
        read_targets(path)
    assert "secret" not in str(refused.value)


def test_doctor_sends_a_test_alert(tmp_path: Path) -> None:
    (tmp_path / "export").mkdir()
    config = tmp_path / "run.yaml"
    sections = (
        "sem: {folder: export, pixel_size_um: 1}",
        'stage: {driver: "null"}',
        "alerts: {file: alerts.txt}",
        "protocol: {calibration_shifts_px: [[0, 0], [8, 0]]}",
    )
    config.write_text("\n".join(sections), encoding="utf-8")
    with serving(Webhook) as (port, posts):
        addresses(tmp_path, f"json://127.0.0.1:{port}")
        done = CliRunner().invoke(app, ["doctor", str(config), "--send-alert", "--json"])
    findings = {finding["what"]: finding for finding in json.loads(done.stdout)["findings"]}
    assert findings["alerts"]["verdict"] == "good"
    assert findings["test alert"]["verdict"] == "good"
    assert [post["title"] for post in posts] == ["run: test"]
