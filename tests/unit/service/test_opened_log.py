"""A log is read once; what a command needs first does not cost another reading."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from semlive.errors import BadLog
from semlive.formats.log.messages import RunMessage
from semlive.formats.log.reader import LogMessage
from semlive.formats.log.writer import LogWriter
from semlive.service.log import opened_log
from semlive.service.log.files import messages
from semlive.service.log.opened_log import OpenedLog

RUN = RunMessage(run="run", started_time_ns=1, host="here", versions={}, config={"sem": {}})


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "log.mcap"
    with path.open("wb") as stream:
        writer = LogWriter(stream)
        writer.write("/dic/map", bytes(100), 1, 1)
        writer.write("/run", RUN, 2, 2)
        writer.write("/dic/map", bytes(200), 3, 3)
        writer.finish()
    return path


@pytest.fixture
def readings(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Logs in the order in which their reading began."""
    started: list[Path] = []

    def counted(path: Path) -> Iterator[LogMessage]:
        started.append(path)
        yield from messages(path)

    monkeypatch.setattr(opened_log, "messages", counted)
    return started


def test_all_messages_follow_a_search_in_one_reading(log: Path, readings: list[Path]) -> None:
    opened = OpenedLog(log)

    assert opened.run == RUN
    assert opened.first("/result") is None
    assert list(opened.messages()) == list(messages(log))
    assert readings == [log]
    assert opened.run == RUN


def test_a_search_past_the_stored_amount_reads_the_log_again(log: Path, readings: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opened_log, "MAX_STORED_BYTES", 50)
    opened = OpenedLog(log)

    assert opened.run == RUN
    assert list(opened.messages()) == list(messages(log))
    assert readings == [log, log]


def test_a_log_is_not_read_a_second_time(log: Path) -> None:
    opened = OpenedLog(log)
    list(opened.messages())

    with pytest.raises(BadLog, match="were read already"):
        list(opened.messages())
    with pytest.raises(BadLog, match="were read already"):
        opened.first("/run")


def test_a_log_without_a_run_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    with path.open("wb") as stream:
        LogWriter(stream).finish()

    with pytest.raises(BadLog, match="holds no run's configuration"):
        _ = OpenedLog(path).run
