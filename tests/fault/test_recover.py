"""Truncated and damaged logs are made valid again, with a report of the losses."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from bench_recover import campaign, standing
from mcap.reader import make_reader

from semlive.errors import BadLog, SemliveError
from semlive.formats.log.messages import DIC_MAP, SEM_ORIGINAL, LogLineMessage, OperatorMessage, StateMessage, to_json
from semlive.formats.log.writer import LogWriter
from semlive.service.log.files import messages
from semlive.service.log.repair import ORIGINAL, recover_log, recover_segment, repair_partial_segments

RECOVER = [sys.executable, "-m", "semlive", "recover"]


def written(path: Path, seconds: int = 30, finish: bool = True) -> bytes:
    """A run's log in small: telemetry flushed each second, transitions, images, maps."""
    rng = np.random.default_rng(3)
    with path.open("wb") as stream:
        writer, now_ns = LogWriter(stream), 10**18
        for second in range(seconds):
            for _ in range(10):
                now_ns += 10**8
                writer.write("/log", LogLineMessage(time_ns=now_ns, level="info", text=f"second {second}"), now_ns, now_ns)
            writer.flush()
            if second % 3 == 0:
                printed = StateMessage(
                    time_ns=now_ns, before="HOLDING", after="IMAGING_1", cause="time", step=second, guards={"force_n": 1.5}
                )
                writer.write("/state", printed, now_ns + 1, now_ns)
                writer.flush()
                writer.write(SEM_ORIGINAL, rng.integers(0, 256, 30_000, dtype=np.uint8).tobytes(), now_ns + 2, now_ns, second)
                writer.write(DIC_MAP, rng.integers(0, 256, 9_000, dtype=np.uint8).tobytes(), now_ns + 3, now_ns, second)
                writer.flush()
        if finish:
            writer.finish()
    return path.read_bytes()


def test_it_reports_how_much_is_read(tmp_path: Path) -> None:
    sizes = [len(written(tmp_path / f"run.{number:03d}.mcap")) for number in (0, 1)]
    reported: list[tuple[int, int]] = []
    recover_log(tmp_path, progress=lambda done, count: reported.append((done, count)))
    assert [done for done, _ in reported] == sorted(done for done, _ in reported)
    assert {count for _, count in reported} == {sum(sizes)}
    assert reported[-1][0] > 0.95 * sum(sizes)


def test_thirty_random_damages_cost_only_themselves(tmp_path: Path) -> None:
    lines = campaign(written(tmp_path / "whole.mcap"), 30, tmp_path)
    assert "30 cases, none lost what it must keep" in lines[-1]


def test_everything_before_every_truncation_of_the_last_chunk_is_recovered(tmp_path: Path) -> None:
    data = written(tmp_path / "whole.mcap", 4)
    complete = standing(data)
    path = tmp_path / "cut.mcap.part"
    for cut in range(complete[0].chunk[0], complete[5].end, 97):
        path.write_bytes(data[:cut])
        recovered = recover_segment(path)
        assert sum(recovered.recovered.values()) == sum(item.end <= cut for item in complete)
        recovered.path.unlink()
        (tmp_path / f"cut{ORIGINAL}").unlink()


def test_rubbish_behind_a_tear_takes_nothing_with_it(tmp_path: Path) -> None:
    """The truncated chunk's length lies within the file again, but its rest is empty."""
    data = written(tmp_path / "whole.mcap", 4)
    complete = standing(data)
    path = tmp_path / "cut.mcap.part"
    for cut in range(complete[10].start, complete[15].end, 53):
        for rubbish in (bytes(4096), bytes(range(256)) * 16):
            path.write_bytes(data[:cut] + rubbish)
            stored = [item.payload for item in messages(path)]
            assert stored == [item.key[4] for item in complete if item.end <= cut]


def test_a_damaged_log_is_recovered_in_place_and_the_original_is_retained(tmp_path: Path) -> None:
    path = tmp_path / "run.000.mcap"
    data = bytearray(written(path))
    image = next(item for item in standing(bytes(data)) if item.key[0] == SEM_ORIGINAL and item.key[1] == 6)
    data[image.start + 5000] ^= 1
    path.write_bytes(data)
    done = subprocess.run([*RECOVER, str(tmp_path), "--json"], capture_output=True, text=True, check=True, timeout=60)
    reported = json.loads(done.stdout)
    [segment] = reported["segments"]
    assert (reported["lost"], reported["lost_is_complete"], segment["lost"], segment["whole"]) == (1, True, {SEM_ORIGINAL: 1}, False)
    [damage] = segment["damage"]
    assert damage["lost"] == {SEM_ORIGINAL: 1}
    assert (damage["start_byte"], damage["end_byte"]) == image.chunk
    assert damage["before_ns"] - damage["after_ns"] == 2
    assert Path(segment["kept_as"]).read_bytes() == bytes(data)
    assert [message.sequence for message in messages(tmp_path) if message.topic == SEM_ORIGINAL] == [0, 3, 9, 12, 15, 18, 21, 24, 27]
    [again] = recover_log(tmp_path)
    assert again.was_intact
    assert sum(again.recovered.values()) == 329
    assert sorted(item.name for item in tmp_path.iterdir()) == ["run.000.mcap", f"run.000{ORIGINAL}"]


def test_every_length_and_kind_of_a_chunk_may_be_wrong_by_a_bit(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    whole = written(path, 8)
    chunk = next(item.chunk for item in standing(whole) if item.key[0] == DIC_MAP)
    total = len(standing(whole))
    # Kind, length, uncompressed size, and size: each repeats what another states, and the checksum decides.
    for byte in (0, 1, 2, 8, 25, 27, 41, 44):
        data = bytearray(whole)
        data[chunk[0] + byte] ^= 4
        path.write_bytes(data)
        assert sum(recover_segment(path, tmp_path / f"{byte}.mcap").recovered.values()) == total


def test_where_it_goes_and_what_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    written(folder / "run.000.mcap", 3)
    (folder / "run.001.mcap.part").write_bytes(written(folder / "x", 3, finish=False)[:-200])
    (folder / "x").unlink()
    recovered = recover_log(folder, tmp_path / "out")
    assert [item.was_intact for item in recovered] == [True, False]
    assert sorted(item.name for item in (tmp_path / "out").iterdir()) == ["run.000.mcap", "run.001.mcap"]
    assert sorted(item.name for item in folder.iterdir()) == ["run.000.mcap", "run.001.mcap.part"]
    with pytest.raises(BadLog, match="exists already"):
        recover_log(folder, tmp_path / "out")
    [repaired] = repair_partial_segments(folder)
    assert repaired.path.name == "run.001.mcap"
    assert repaired.original == folder / f"run.001{ORIGINAL}"
    assert repair_partial_segments(folder) == ()
    (tmp_path / "image.mcap").write_bytes(b"\x89PNG\r\n\x1a\n" * 100)
    with pytest.raises(BadLog, match=r"image\.mcap: not an MCAP file"):
        recover_segment(tmp_path / "image.mcap")
    with pytest.raises(SemliveError, match="cannot be recovered"):
        recover_segment(tmp_path / "image.mcap", tmp_path / "missing" / "out.mcap")
    assert not list(tmp_path.glob("*.recovering"))


KILLED = """
import os, sys, time
from pathlib import Path
from semlive.formats.log.messages import LogLineMessage
from semlive.service.log.recording import Recorder
class Clock:
    def now_ns(self): return time.time_ns()
    def mono_ns(self): return time.monotonic_ns()
recorder = Recorder(Path(sys.argv[1]), Clock(), print)
for number in range(100):
    recorder.write("/log", LogLineMessage(time_ns=number, level="info", text="x"))
recorder.flush()
print("flushed", flush=True)
time.sleep(60)
"""


def test_a_log_being_written_is_not_changed_and_a_killed_one_is_finished(tmp_path: Path) -> None:
    command = [sys.executable, "-c", KILLED, str(tmp_path / "run.000.mcap")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout is not None
        assert writer.stdout.readline() == "flushed\n"
        with pytest.raises(BadLog, match="is being written by a running semlive"):
            repair_partial_segments(tmp_path)
        os.kill(writer.pid, signal.SIGKILL)
    [recovered] = repair_partial_segments(tmp_path)
    assert recovered.recovered == {"/log": 100}
    with (tmp_path / "run.000.mcap").open("rb") as stream:
        summary = make_reader(stream, validate_crcs=True).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 100


def test_what_an_older_log_reports_only_once_is_found_elsewhere(tmp_path: Path) -> None:
    """Logs of earlier versions name a topic in its first chunk alone; the index at the end names it again."""
    from mcap.writer import CompressionType, Writer  # noqa: PLC0415

    path = tmp_path / "old.mcap"
    with path.open("wb") as stream:
        old = Writer(stream, compression=CompressionType.NONE)
        old.start()
        channel = old.register_channel("/operator", "json", old.register_schema("semlive.OperatorMessage", "jsonschema", b"{}"))
        for number in range(3):
            old.add_message(channel, number, to_json(OperatorMessage(time_ns=number, what="start", args={})), number, number)
            old.flush()
        old.finish()
    data = bytearray(path.read_bytes())
    data[data.index(b"start")] ^= 1
    path.write_bytes(data)
    assert [message.sequence for message in messages(path)] == [1, 2]
    recovered = recover_segment(path)
    assert (recovered.recovered, recovered.lost, recovered.lost_is_complete) == ({"/operator": 2}, {"/operator": 1}, True)
