"""The recorder against threads, kills and disks."""

from __future__ import annotations

import errno
import io
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from io import FileIO, RawIOBase
from pathlib import Path

import pytest
from mcap.reader import make_reader

from semlive.errors import BadConfig, BadLog, SemliveError
from semlive.formats.log.messages import SEM_ORIGINAL, FaultMessage, LogLineMessage, RunMessage, from_json
from semlive.formats.log.reader import LogMessage
from semlive.formats.log.records import RUN_METADATA
from semlive.formats.log.writer import LogWriter
from semlive.service.log.files import messages, segment_path, segments
from semlive.service.log.recording import Recorder, open_new
from semlive.service.log.tail import LogTail


@dataclass
class StuckClock:
    """A clock that does not advance, like experiment time while a simulation catches up."""

    ns: int = 10**18

    def now_ns(self) -> int:
        return self.ns

    def mono_ns(self) -> int:
        return time.monotonic_ns()


def line(text: str) -> LogLineMessage:
    return LogLineMessage(time_ns=1, level="info", text=text)


def unfaulted(text: str) -> None:
    raise AssertionError(text)


class SmallDisk(FileIO):
    """A file on a disk with room for some bytes; it writes part of a chunk before it refuses, as disks do."""

    room = 0

    def write(self, data: bytes) -> int:  # type: ignore[override]
        if len(data) == 0 or self.room > 0:
            written = super().write(data[: self.room])
            self.room -= written
            return written
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def small_disk(room: int) -> tuple[Callable[[Path], RawIOBase], list[SmallDisk]]:
    opened: list[SmallDisk] = []

    def open_raw(path: Path) -> RawIOBase:
        disk = SmallDisk(path, "xb")
        disk.room = room
        opened.append(disk)
        return disk

    return open_raw, opened


def test_messages_of_many_threads_stand_in_the_order_of_their_log_times(tmp_path: Path) -> None:
    path = segment_path(tmp_path, "run", 0)
    recorder = Recorder(path, StuckClock(), unfaulted)
    written: list = []

    def work(name: str) -> None:
        written.extend(recorder.write("/log", line(f"{name}{n}"), publish_time_ns=n) for n in range(200))

    threads = [threading.Thread(target=work, args=(name,)) for name in "abc"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    recorder.write(SEM_ORIGINAL, b"pixels", sequence=17)
    assert recorder.close()
    assert recorder.close()
    assert not recorder.part.exists()
    read = list(messages(path))
    assert read[:-1] == sorted(written, key=lambda message: message.log_time_ns)
    times = [message.log_time_ns for message in read]
    assert times == list(range(10**18, 10**18 + 601))
    assert [message.sequence for message in read] == [*range(600), 17]
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == 601


def test_a_log_grows_as_a_part_that_can_be_read_after_flush_wait(tmp_path: Path) -> None:
    recorder = Recorder(segment_path(tmp_path, "run", 0), StuckClock(), unfaulted)
    recorder.write("/log", line("one"))
    assert recorder.flush()
    assert [path.name for path in segments(tmp_path)] == ["run.000.mcap.part"]
    damage: list[str] = []
    [message] = messages(tmp_path, damage.append)
    assert from_json("/log", message.payload) == line("one")
    assert damage == ["run.000.mcap.part: truncated: EndOfFile."]
    assert recorder.close()


def test_nothing_is_lost_when_the_disk_is_full_for_a_while(tmp_path: Path) -> None:
    printed: list[str] = []
    open_raw, opened = small_disk(6000)
    recorder = Recorder(tmp_path / "run.000.mcap", StuckClock(), printed.append, open_raw=open_raw, retry_after_s=0.01)
    for number in range(200):
        recorder.write("/fault", FaultMessage(time_ns=number, what="x" * 50, where="", action=""))
        assert number or recorder.flush()
    assert not recorder.flush(0.2)
    assert len(printed) == 1
    assert "No space left" in printed[0]
    opened[0].room = 10**9
    assert recorder.flush()
    assert "are written now" in printed[1]
    assert recorder.close()
    assert [message.publish_time_ns - 10**18 for message in messages(tmp_path)] == list(range(200))


def test_a_disk_that_stays_full_is_reported_and_a_full_queue_refuses(tmp_path: Path) -> None:
    printed: list[str] = []
    open_raw, opened = small_disk(0)
    recorder = Recorder(tmp_path / "r.000.mcap", StuckClock(), printed.append, open_raw=open_raw, max_messages=20, retry_after_s=0.05)

    def overrun() -> None:
        for _ in range(100):
            recorder.write("/log", line("x"))

    recorder.write("/state", b"{}")
    with pytest.raises(SemliveError, match="20 messages wait"):
        overrun()
    assert not recorder.close(timeout_s=0.2)
    assert len(printed) == 1
    assert not recorder.path.exists()
    with pytest.raises(SemliveError, match="closed"):
        recorder.write("/log", line("late"))
    opened[0].room = 10**9  # closing continues in the background, and ends completely
    assert recorder.close()


def test_wrong_messages_are_refused_where_they_are_written(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "r.000.mcap", StuckClock(), unfaulted)
    with pytest.raises(ValueError, match="not a topic"):
        recorder.write("/nothing", b"{}")
    with pytest.raises(ValueError, match="does not belong"):
        recorder.write("/fault", line("x"))
    assert recorder.close()


def test_a_segment_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "r.000.mcap").write_bytes(b"precious")
    with pytest.raises(BadConfig, match="name another run"):
        Recorder(tmp_path / "r.000.mcap", StuckClock(), unfaulted)
    with pytest.raises(BadConfig, match="cannot be created"):
        Recorder(tmp_path / "missing" / "r.000.mcap", StuckClock(), unfaulted)


def test_files_that_are_no_logs_give_one_error_line(tmp_path: Path) -> None:
    with pytest.raises(BadLog, match="no such log"):
        segments(tmp_path / "no.mcap")
    with pytest.raises(BadLog, match=r"holds no \.mcap"):
        segments(tmp_path)
    (tmp_path / "a.000.mcap").write_bytes(b"hello, world")
    with pytest.raises(BadLog, match=r"a\.000\.mcap: not an MCAP file"):
        list(messages(tmp_path))
    (tmp_path / "b.000.mcap").write_bytes(b"")
    with pytest.raises(BadLog, match="several logs"):
        segments(tmp_path)


def test_segments_of_a_run_are_read_in_order(tmp_path: Path) -> None:
    for number in (1, 0, 10):
        recorder = Recorder(segment_path(tmp_path, "run.a", number), StuckClock(), unfaulted)
        recorder.write("/log", line(str(number)))
        assert recorder.close()
    texts = [from_json("/log", message.payload) for message in messages(tmp_path)]
    assert texts == [line("0"), line("1"), line("10")]


KILLED = """
import os, signal, sys, time
from pathlib import Path
from semlive.formats.log.messages import FaultMessage, LogLineMessage
from semlive.service.log.recording import Recorder
class Clock:
    def now_ns(self): return time.time_ns()
    def mono_ns(self): return time.monotonic_ns()
recorder = Recorder(Path(sys.argv[1]), Clock(), print)
for number in range(50):
    recorder.write("/log", LogLineMessage(time_ns=number, level="info", text="x"))
recorder.write("/fault", FaultMessage(time_ns=50, what="x", where="", action=""))
recorder.write("/sem/original", bytes(300_000), sequence=3)
recorder.flush()
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_the_index_of_a_long_log_lies_aside_as_far_as_there_is_room(tmp_path: Path) -> None:
    whole: list[bytes] = []
    for room in (None, 10**9, 100_001):
        aside = None if room is None else SmallDisk(tmp_path / f"aside{room}", "w+b")
        if aside is not None and room is not None:
            aside.room = room
        stream = io.BytesIO()
        writer = LogWriter(stream, aside)
        for number in range(3000):
            writer.write("/log", line(str(number)), number, number)
            writer.flush()
        writer.finish()
        whole.append(stream.getvalue())
        if aside is not None and room is not None:
            assert os.path.getsize(aside.name) >= min(room, 190_000)
            aside.close()
    assert whole[0] == whole[1] == whole[2]
    summary = make_reader(io.BytesIO(whole[0])).get_summary()
    assert summary is not None
    assert len(summary.chunk_indexes) == 3000


def test_flushed_messages_survive_a_killed_recorder(tmp_path: Path) -> None:
    path = tmp_path / "run.000.mcap"
    done = subprocess.run([sys.executable, "-c", KILLED, str(path)], check=False, timeout=60)
    assert done.returncode == -9
    read = list(messages(tmp_path))
    assert [message.topic for message in read] == ["/log"] * 50 + ["/fault", "/sem/original"]
    assert len(read[-1].payload) == 300_000


def test_a_log_that_is_moved_or_cut_while_it_is_written_is_behind(tmp_path: Path, wait_until: Callable[..., None]) -> None:
    path = segment_path(tmp_path, "run", 0)
    recorder = Recorder(path, StuckClock(), unfaulted)
    away = recorder.part.with_name("rotated.1")
    recorder.write("/fault", FaultMessage(time_ns=1, what="x", where="", action=""))
    assert recorder.flush()
    recorder.part.rename(away)
    wait_until(lambda: "moved or removed" in (recorder.backlog_message or ""))
    assert recorder.write_failed
    away.rename(recorder.part)
    wait_until(lambda: recorder.backlog_message is None)
    os.truncate(recorder.part, 10)
    wait_until(lambda: "cut short" in (recorder.backlog_message or ""))
    recorder.write("/fault", FaultMessage(time_ns=2, what="x" * 1000, where="", action=""))
    assert recorder.flush()
    time.sleep(1.1)
    assert "cut short" in (recorder.backlog_message or "")
    assert recorder.close()


def test_a_large_segment_is_followed_by_another_and_readers_return_one_log(tmp_path: Path) -> None:
    recorder = Recorder(segment_path(tmp_path, "run", 0), StuckClock(), unfaulted, segment_bytes=20_000)
    tail, followed = LogTail(tmp_path), list[LogMessage]()
    recorder.write("/run", RunMessage(run="run", started_time_ns=1, host="here", versions={}, config={}))
    for number in range(40):
        recorder.write(SEM_ORIGINAL, bytes(2_000), sequence=number)
        recorder.write("/log", LogLineMessage(time_ns=number, level="info", text="x"))
        assert number % 10 or recorder.flush()
        followed += tail.poll()
        assert not tail.finished
    assert recorder.close()
    followed += tail.poll()
    assert tail.finished
    assert followed == list(messages(tmp_path))
    assert [item.sequence for item in followed if item.topic == SEM_ORIGINAL] == list(range(40))
    assert len(segments(tmp_path)) > 2
    for path in segments(tmp_path):
        with path.open("rb") as stream:
            assert RUN_METADATA in [item.name for item in make_reader(stream).iter_metadata()]


def test_the_next_segment_is_started_when_the_disk_takes_it_again(tmp_path: Path, wait_until: Callable[..., None]) -> None:
    refuse, printed = threading.Event(), list[str]()

    def open_raw(path: Path) -> RawIOBase:
        if refuse.is_set():
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return open_new(path)

    recorder = Recorder(
        segment_path(tmp_path, "run", 0), StuckClock(), printed.append, open_raw=open_raw, segment_bytes=5_000, retry_after_s=0.05
    )
    refuse.set()
    recorder.write(SEM_ORIGINAL, bytes(10_000), sequence=0)
    wait_until(lambda: "No space left" in (recorder.backlog_message or ""))
    recorder.write(SEM_ORIGINAL, bytes(10), sequence=1)
    refuse.clear()
    assert recorder.flush()
    assert recorder.backlog_message is None
    assert recorder.close()
    assert [item.sequence for item in messages(tmp_path)] == [0, 1]
    assert ["next segment cannot be created" in printed[0], "are written now" in printed[1]] == [True, True]
