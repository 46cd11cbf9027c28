"""An fsync that fails has lost what it was for: everything that the disk did not acknowledge is written again, and read back."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from io import BytesIO, FileIO
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from semlive.formats.log.messages import SEM_ORIGINAL, LogLineMessage, to_json
from semlive.formats.log.reader import LogMessage
from semlive.formats.log.writer import LogWriter
from semlive.service.log.files import messages
from semlive.service.log.recording import REWRITING
from semlive.service.log.repair import recover_log, repair_partial_segments
from semlive.service.log.tail import LogTail

ORIGINALS = 30

# Writes images one after the other and waits for each; the switches are set after the tenth.
WRITER = """
import json, sys, time
from pathlib import Path
from semlive.formats.log.messages import FileMessage, LogLineMessage, RunMessage
from semlive.service.log.recording import Recorder
from semlive.service.log.tail import LogTail
class Clock:
    def now_ns(self): return time.time_ns()
    def mono_ns(self): return time.monotonic_ns()
log, switches, failures, at = Path(sys.argv[1]), Path(sys.argv[2]), json.loads(sys.argv[3]), int(sys.argv[4])
warnings, behind, tail, followed = [], [], LogTail(log), []
def switch(names):
    for name, count in names.items():
        (switches / name).write_text(str(count))
if at < 0:
    switch(failures)
recorder = Recorder(log / "run.000.mcap", Clock(), warnings.append, retry_after_s=0.05)
recorder.write("/run", RunMessage(run="run", started_time_ns=1, host="here", versions={}, config={}))
for number in range(30):
    description = dict(size=100000, sha256="", mtime_ns=0, arrival_time_ns=0, decision="arrived", reason="")
    recorder.write("/log", LogLineMessage(time_ns=number, level="info", text="x"))
    recorder.write("/sem/file", FileMessage(export=number, name=f"image{number:03d}.tif", **description))
    if number == at:
        switch(failures)
    recorder.write("/sem/original", bytes([number]) * 100000, sequence=number)
    recorder.flush(0.3)
    behind.append(recorder.backlog_message)
    followed += [one.sequence for one in tail.poll() if one.topic == "/sem/original"]
began_s = time.monotonic()
complete = recorder.close(10.0, 1.0)
followed += [one.sequence for one in tail.poll() if one.topic == "/sem/original"]
print(json.dumps(dict(warnings=warnings, behind=[one for one in behind if one], complete=complete, ended_in_s=time.monotonic() - began_s,
                      unacknowledged=recorder.unacknowledged, followed=followed)))
"""


@pytest.fixture
def record(disk_peer: Path, tmp_path: Path) -> Callable[..., dict[str, Any]]:
    """Writes a log on a disk that fails as the switches set."""

    def run(switches: dict[str, int], at: int = 10) -> dict[str, Any]:
        for name in ("log", "switches"):
            (tmp_path / name).mkdir()
        environment = {
            **os.environ,
            "LD_PRELOAD": str(disk_peer),
            "SICK_DISK_ROOT": str(tmp_path / "log"),
            "SICK_DISK_SWITCHES": str(tmp_path / "switches"),
        }
        command = [sys.executable, "-c", WRITER, str(tmp_path / "log"), str(tmp_path / "switches"), json.dumps(switches), str(at)]
        done = subprocess.run(command, check=True, env=environment, capture_output=True, timeout=60)
        return json.loads(done.stdout)

    return run


def images(log: Path) -> list[int]:
    """Numbers of the images whose bytes are as they were written."""
    found = [item for item in messages(log, pytest.fail) if item.topic == SEM_ORIGINAL]
    return [item.sequence for item in found if item.payload == bytes([item.sequence]) * 100_000]


def names(log: Path) -> list[str]:
    return sorted(path.name for path in log.iterdir())


@pytest.mark.parametrize(("failures", "at"), [(1, 10), (2, 10), (3, 10), (1, -1), (1, 29)])
def test_what_a_failed_fsync_lost_is_written_again(record: Callable[..., dict[str, Any]], tmp_path: Path, failures: int, at: int) -> None:
    reported = record({"fsync": failures}, at)
    log = tmp_path / "log"
    assert reported["complete"]
    assert images(log) == list(range(ORIGINALS))
    assert sorted(reported["followed"]) == list(range(ORIGINALS))
    assert names(log) == ["run.000.mcap", "run.001.mcap"]
    times = [item.log_time_ns for item in messages(log)]
    assert times == sorted(set(times))
    first, second = reported["warnings"]
    assert "did not confirm what was written (Input/output error)" in first
    assert ("1 x /run" if at < 0 else f"image{at:03d}.tif") in first
    assert "read back from there; run.000.mcap ends where it was last confirmed" in second
    assert any("failed to confirm" in item or "cannot be written" in item for item in reported["behind"])
    for path in log.iterdir():
        with path.open("rb") as stream:
            summary = make_reader(stream).get_summary()
            assert summary is not None
            assert summary.statistics is not None


def test_an_image_whose_write_fails_is_written_again(record: Callable[..., dict[str, Any]], tmp_path: Path) -> None:
    reported = record({"write": 1})
    assert reported["complete"]
    assert images(tmp_path / "log") == list(range(ORIGINALS))
    assert "(Input/output error)" in reported["warnings"][0]


def test_a_folder_whose_fsync_fails_keeps_the_finished_segment(record: Callable[..., dict[str, Any]], tmp_path: Path) -> None:
    reported = record({"folder": 1})
    assert reported["complete"]
    assert images(tmp_path / "log") == list(range(ORIGINALS))
    assert names(tmp_path / "log") == ["run.000.mcap"]
    assert "check the disk" in reported["warnings"][0]


def test_a_full_disk_keeps_its_part_and_another_disk_takes_the_recovered_log(record: Callable[..., dict[str, Any]], tmp_path: Path) -> None:
    reported = record({"full": 100_000})
    log = tmp_path / "log"
    assert not reported["complete"]
    assert reported["ended_in_s"] < 5.0
    assert "image010.tif" in reported["unacknowledged"]
    assert "20 x /sem/original" in reported["unacknowledged"]
    assert names(log) == ["run.000.mcap.part"]
    recover_log(log, tmp_path / "elsewhere")
    assert images(tmp_path / "elsewhere") == list(range(10))
    assert names(log) == ["run.000.mcap.part"]


def test_recovery_on_a_full_disk_changes_nothing(disk_peer: Path, record: Callable[..., dict[str, Any]], tmp_path: Path) -> None:
    record({"full": 100_000})
    environment = {
        **os.environ,
        "LD_PRELOAD": str(disk_peer),
        "SICK_DISK_ROOT": str(tmp_path / "log"),
        "SICK_DISK_SWITCHES": str(tmp_path / "switches"),
    }
    command = [sys.executable, "-m", "semlive", "recover", str(tmp_path / "log")]
    done = subprocess.run(command, check=False, env=environment, capture_output=True, text=True, timeout=60)
    assert done.returncode != 0
    assert "make room on the disk" in " ".join(done.stderr.split())
    assert names(tmp_path / "log") == ["run.000.mcap.part"]
    done = subprocess.run([*command, "-o", str(tmp_path / "else")], check=False, env=environment, capture_output=True, timeout=60)
    assert done.returncode == 0
    assert images(tmp_path / "else") == list(range(10))


def line(number: int) -> LogMessage:
    payload = to_json(LogLineMessage(time_ns=number, level="info", text=f"line {number}"))
    return LogMessage("/log", number, number, number, payload)


def grown(path: Path, lines: range, after_ns: int | None = None, lost: int | None = None) -> None:
    """An unfinished segment of some lines, each in a chunk of its own, one of which the disk lost."""
    with path.open("wb") as stream:
        writer = LogWriter(stream)
        if after_ns is not None:
            writer.write_rewritten_metadata(after_ns)
        for number in lines:
            writer.write("/log", line(number).payload, number, number, number)
            begin = stream.tell()
            writer.flush()
            if number == lost:
                end = stream.tell()
                stream.seek(begin)
                stream.write(bytes(end - begin))


def test_messages_that_stand_in_two_segments_are_given_once(tmp_path: Path) -> None:
    """As after a kill between the end of the new segment and the cut of the old one."""
    live, first, second = LogTail(tmp_path), tmp_path / "run.000.mcap.part", tmp_path / "run.001.mcap.part"
    grown(first, range(1, 21), lost=15)
    followed = list(live.poll())
    grown(second, range(11, 31), after_ns=10)
    followed += live.poll()
    assert sorted(followed, key=lambda item: item.log_time_ns) == [line(number) for number in range(1, 31)]
    assert list(messages(tmp_path)) == [line(number) for number in range(1, 31)]
    recover_log(tmp_path)
    assert list(messages(tmp_path)) == [line(number) for number in range(1, 31)]


def test_a_segment_that_was_being_written_again_when_its_writer_was_killed_belongs_to_the_log(tmp_path: Path) -> None:
    first, second = tmp_path / "run.000.mcap.part", tmp_path / f"run.001.mcap{REWRITING}"
    grown(first, range(1, 21), lost=12)
    grown(second, range(11, 15), after_ns=10)
    assert [item.log_time_ns for item in messages(tmp_path)] == [*range(1, 12), *range(13, 21)]
    repair_partial_segments(tmp_path)
    assert list(messages(tmp_path)) == [line(number) for number in range(1, 21)]
    assert names(tmp_path) == ["run.000.mcap", "run.000.original", "run.001.mcap", "run.001.original"]


def test_a_writer_that_returns_to_a_mark_continues_as_if_nothing_had_been_written_since(tmp_path: Path) -> None:
    def written(stream: BytesIO, aside: FileIO, returns: bool) -> bytes:
        writer = LogWriter(stream, aside)
        for number in range(2000):
            writer.write("/log", line(number).payload, number, number, number)
            writer.flush()
        mark = writer.mark()
        for number in range(3000, 5000) if returns else ():
            writer.write("/log", line(number).payload, number, number, number)
            writer.write(SEM_ORIGINAL, b"x", number, number, number)
            writer.flush()
        stream.truncate(mark.position)
        stream.seek(mark.position)
        writer.rewind(mark)
        for number in range(2000, 2100):
            writer.write(SEM_ORIGINAL, b"y", number, number, number)
        writer.finish()
        return stream.getvalue()

    with (tmp_path / "a").open("w+b", buffering=0) as item, (tmp_path / "b").open("w+b", buffering=0) as other:
        assert written(BytesIO(), item, returns=True) == written(BytesIO(), other, returns=False)
