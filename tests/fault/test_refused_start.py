"""A start that is refused after a device was opened: its log has the `/fault`, and the same name can be run again."""

from __future__ import annotations

import re
import shutil
import socket
import subprocess
import sys
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from semlive.errors import LinkRefused
from semlive.formats.log.messages import CommandMessage, FaultMessage, Payload, StateMessage, topic_of
from semlive.formats.log.writer import LogWriter
from semlive.service.daemon.refused_start import REFUSED_START, named_in, refused_start
from semlive.service.log.files import segments

REFUSED = FaultMessage(time_ns=5, what="no answer", where=REFUSED_START, action="refused the start", code="link_lost")
CONNECTING = StateMessage(time_ns=2, before="idle", after="connecting", cause="opening", step=0, guards={})


def written(folder: Path, *payloads: Payload, name: str = "run.000.mcap") -> Path:
    folder.mkdir(exist_ok=True)
    with (folder / name).open("wb") as stream:
        writer = LogWriter(stream)
        for number, payload in enumerate(payloads, start=1):
            writer.write(topic_of(payload), payload, number, number)
        writer.finish()
    return folder


def test_a_log_with_nothing_but_a_refused_start_is_recognised(tmp_path: Path) -> None:
    assert refused_start(written(tmp_path / "run", CONNECTING, REFUSED)) == "no answer"


@pytest.mark.parametrize(
    "payloads",
    [
        (CONNECTING,),
        (CONNECTING, REFUSED.model_copy(update={"where": "load frame"})),
        (CONNECTING, CONNECTING.model_copy(update={"before": "connecting", "after": "ready"}), REFUSED),
        (CONNECTING, CommandMessage(time_ns=3, what="ramp_to", args={}, result="sent"), REFUSED),
    ],
)
def test_a_log_with_anything_else_is_not_replaced(tmp_path: Path, payloads: tuple[Payload, ...]) -> None:
    assert refused_start(written(tmp_path / "run", *payloads)) is None


def test_a_log_that_is_damaged_or_has_more_files_is_not_replaced(tmp_path: Path) -> None:
    folder = written(tmp_path / "run", CONNECTING, REFUSED)
    (folder / "notes.txt").write_text("mine", encoding="utf-8")
    assert refused_start(folder) is None
    (folder / "notes.txt").unlink()
    whole = (folder / "run.000.mcap").read_bytes()
    (folder / "run.000.mcap").write_bytes(whole[: len(whole) // 2])
    assert refused_start(folder) is None
    (folder / "run.000.mcap").unlink()
    assert refused_start(folder) is None
    assert refused_start(written(folder, CONNECTING, REFUSED, name="run.000.mcap.part")) is None


def test_the_error_names_the_log_and_keeps_its_kind(tmp_path: Path) -> None:
    named = named_in(LinkRefused("no answer"), tmp_path)
    assert type(named) is LinkRefused
    assert str(tmp_path) in str(named)


def first_event_of_the_page(log: Path) -> str:
    """The state that `semlive serve` sends to a browser at first."""
    command = [sys.executable, "-m", "semlive", "serve", str(log), "--page-port", "0"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as served:
        try:
            assert served.stderr is not None
            (address,) = re.findall(r"http://\S+", served.stderr.readline())
            with urllib.request.urlopen(address + "events", timeout=30) as events:
                return next(line.decode() for line in events if line.startswith(b"data:"))
        finally:
            served.terminate()


def test_a_refused_start_records_its_fault_and_its_name_can_be_reused(
    patient: Any, semlive: Callable[..., tuple[int, str, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    patient.falls_ill("load frame is refused open")
    for _ in range(2):  # the second replaces the log of the first
        patient.start()
        code, text = patient.end()
        assert (code, "open is refused; recorded in" in text) == (1, True), text
        (fault,) = patient.logged("/fault")
        assert (fault["code"], fault["where"], fault["what"]) == ("link_lost", REFUSED_START, "open is refused")
        assert [path.name for path in segments(patient.log)] == ["run.000.mcap"]
    monkeypatch.chdir(patient.folder)
    _, _, err = semlive("report", patient.log)
    assert "its alarms and rejected frames are in" in " ".join(err.split()), err
    assert any("open is refused" in page.read_text(encoding="utf-8") for page in patient.folder.rglob("*.html"))
    assert "open is refused" in first_event_of_the_page(patient.log)
    assert "ramp_to" not in patient.calls()
    patient.gets_well("load frame is refused open")
    patient.start().reach("ramping")
    assert any("was replaced by this run: open is refused" in one["text"] for one in patient.logged("/log"))


def test_a_closed_port_is_bad_input_and_its_fault_is_recorded(patient: Any) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    patient.config["load_frame"] = {"driver": "modbus", "settings": {"map": "bench", "host": "127.0.0.1", "port": port}}
    patient.start()
    code, text = patient.end()
    assert (code, "recorded in" in text) == (2, True), text
    assert [one["code"] for one in patient.logged("/fault")] == ["link_lost"]


def test_a_log_with_more_than_a_refused_start_is_retained(patient: Any) -> None:
    patient.start().reach("ramping").daemon.terminate()
    assert patient.end()[0] == 1
    before = [path.read_bytes() for path in segments(patient.log)]
    patient.start()
    code, text = patient.end()
    assert (code, "this run exists already" in text) == (2, True), text
    assert [path.read_bytes() for path in segments(patient.log)] == before
    shutil.rmtree(patient.log)
