"""A growing log is read message by message as its chunks become complete, whatever happens to its files."""

from __future__ import annotations

import socket
import threading
import time
from pathlib import Path

import pytest

from semlive.errors import BadLog
from semlive.formats.log.messages import SEM_ORIGINAL, LogLineMessage, RunMessage
from semlive.formats.log.reader import LogMessage
from semlive.formats.log.writer import LogWriter
from semlive.service.log.files import messages
from semlive.service.log.lock import held_itself
from semlive.service.log.recording import Recorder
from semlive.service.log.repair import recover_segment
from semlive.service.log.tail import LogAbandoned, LogTail, follow

from ..clocks import HandClock


def write(path: Path, first: int, count: int, finish: bool = True) -> bytes:
    with path.open("wb") as stream:
        writer = LogWriter(stream)
        for number in range(first, first + count):
            writer.write("/log", LogLineMessage(time_ns=number, level="info", text="x" * (number % 7)), number, number)
            if number % 3 == 0:
                writer.write(SEM_ORIGINAL, bytes(number % 5), number, number, number)
            if number % 2 == 0:
                writer.flush()
        writer.finish() if finish else writer.flush()
    return path.read_bytes()


def test_a_file_cut_at_every_byte_gives_each_message_once_when_its_chunk_is_complete(tmp_path: Path) -> None:
    data = write(tmp_path / "whole.mcap", 0, 12)
    whole = list(messages(tmp_path / "whole.mcap"))
    ends = [end for end in range(len(data)) if data[end : end + 1] == b"\x07" and int.from_bytes(data[end + 1 : end + 9], "little") < 100]
    path = tmp_path / "run.000.mcap.part"
    tail, read = LogTail(path), list[LogMessage]()
    with path.open("wb") as growing:
        for at in range(len(data)):
            growing.write(data[at : at + 1])
            growing.flush()
            read += tail.poll()
            assert read == whole[: len(read)]
            assert not tail.finished or at + 1 >= len(data) - 8
            if at + 1 in ends[:3]:
                # A message index begins: the chunk before it is complete, and all of it has been given.
                assert read
                assert read == list(messages(path))
    assert read == whole
    assert tail.finished
    assert list(tail.poll()) == []


def test_a_cut_read_again_gives_what_a_following_reader_was_given(tmp_path: Path) -> None:
    data = write(tmp_path / "whole.mcap", 0, 6)
    path = tmp_path / "cut.mcap.part"
    follower, followed = LogTail(path), 0
    for at in range(0, len(data) + 1, 13):
        path.write_bytes(data[:at])
        followed += len(list(follower.poll()))
        assert len(list(LogTail(path).poll())) == followed


def test_renames_and_new_segments_are_followed(tmp_path: Path) -> None:
    tail = LogTail(tmp_path)
    assert list(tail.poll()) == []
    part, finished = tmp_path / "run.000.mcap.part", tmp_path / "run.000.mcap"
    data = write(part, 0, 6)
    part.write_bytes(data[:-300])
    first = list(tail.poll())
    assert not tail.finished
    part.write_bytes(data)
    part.rename(finished)
    assert [item.payload for item in first + list(tail.poll())] == [item.payload for item in messages(finished)]
    assert tail.finished
    write(tmp_path / "run.001.mcap.part", 100, 4, finish=False)
    later = list(tail.poll())
    assert [item.log_time_ns for item in later if item.topic == "/log"] == [100, 101, 102, 103]
    assert not tail.finished


def test_a_truncated_segment_is_abandoned_when_the_next_one_exists(tmp_path: Path) -> None:
    reported: list[str] = []
    tail = LogTail(tmp_path, reported.append)
    data = write(tmp_path / "run.000.mcap.part", 0, 6, finish=False)
    (tmp_path / "run.000.mcap.part").write_bytes(data[:-120])
    first = list(tail.poll())
    assert reported == []
    write(tmp_path / "run.001.mcap", 100, 4)
    rest = list(tail.poll())
    assert len(reported) == 1
    assert first + rest == list(messages(tmp_path))
    assert tail.finished


def test_a_segment_recovered_under_the_reader_gives_nothing_twice(tmp_path: Path) -> None:
    part = tmp_path / "run.000.mcap.part"
    data = bytearray(write(part, 0, 20, finish=False))
    part.write_bytes(data[: len(data) // 2])
    tail = LogTail(tmp_path)
    read = list(tail.poll())
    part.write_bytes(data)
    recover_segment(part)
    read += tail.poll()
    assert read == list(messages(tmp_path))
    assert tail.finished


def test_what_was_not_taken_comes_again(tmp_path: Path) -> None:
    write(tmp_path / "run.000.mcap", 0, 12)
    tail, read = LogTail(tmp_path), list[LogMessage]()
    while item := next(tail.poll(), None):
        read.append(item)
    assert read == list(messages(tmp_path))


def test_damage_in_the_middle_is_skipped_and_reported(tmp_path: Path) -> None:
    path = tmp_path / "run.000.mcap"
    data = bytearray(write(path, 0, 12))
    data[data.index(b"xxxxx")] ^= 1
    path.write_bytes(data)
    reported: list[str] = []
    assert list(follow(tmp_path, on_damage=reported.append)) == list(messages(tmp_path))
    assert reported == ["run.000.mcap: a chunk is damaged: its checksum is wrong."]
    (tmp_path / "run.001.mcap").write_bytes(b"no log at all")
    with pytest.raises(BadLog, match=r"run\.001\.mcap: not an MCAP file"):
        list(LogTail(tmp_path).poll())


def test_a_recorder_is_followed_to_its_end(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.000.mcap", HandClock(1), lambda _: None)
    read: list[LogMessage] = []
    reader = threading.Thread(target=lambda: read.extend(follow(tmp_path, 0.005)))
    reader.start()
    for number in range(300):
        recorder.write("/log", LogLineMessage(time_ns=number, level="info", text="x"))
        if number % 50 == 0:
            recorder.write(SEM_ORIGINAL, bytes(100_000), sequence=number)
            assert recorder.flush()
    assert recorder.close()
    reader.join(10)
    assert read == list(messages(tmp_path))
    assert len(read) == 306


def test_the_log_of_a_killed_process_is_followed_while_its_folder_is_locked(tmp_path: Path) -> None:
    with (tmp_path / "run.000.mcap.part").open("wb") as stream:
        writer = LogWriter(stream)
        writer.write("/run", RunMessage(run="a", started_time_ns=1, host=socket.gethostname(), versions={}, config={}), 1, 1)
        writer.flush()
    followed = follow(tmp_path, 0.005, silent_s=0.02)
    assert next(followed).topic == "/run"
    ended: list[str] = []

    def read_on() -> None:
        try:
            next(followed)
        except LogAbandoned as error:
            ended.append(str(error))

    reader = threading.Thread(target=read_on)
    with held_itself(tmp_path):
        reader.start()
        reader.join(0.3)
        assert (reader.is_alive(), ended) == (True, [])
    reader.join(10)
    assert "has ended before the run did" in ended[0]


@pytest.mark.parametrize(("host", "reason"), [("another", "from the run on another for 0.0"), ("", "it has no message of a run")])
def test_a_log_that_another_computer_writes_or_that_does_not_begin_is_given_up(tmp_path: Path, host: str, reason: str) -> None:
    if host:
        with (tmp_path / "run.000.mcap.part").open("wb") as stream:
            writer = LogWriter(stream)
            writer.write("/run", RunMessage(run="a", started_time_ns=1, host=host, versions={}, config={}), 1, 1)
            writer.flush()
    followed = follow(tmp_path, 0.005, silent_s=0.02, lost_s=0.3)
    assert [message.topic for _, message in zip(range(bool(host)), followed, strict=False)] == ["/run"] * bool(host)
    first_s = time.monotonic()
    with pytest.raises(LogAbandoned, match=reason):
        next(followed)
    assert time.monotonic() - first_s > 0.25
