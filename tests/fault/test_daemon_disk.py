"""A disk that is full, or slow, for a while: the run pauses, nothing is lost, and the operator takes it up again."""

from __future__ import annotations

import os
import pty
import resource
import signal
import threading
import time
from collections.abc import Callable
from io import FileIO, RawIOBase
from pathlib import Path
from typing import Any, cast

from bench_record import measured

from semlive.formats.log.messages import SEM_ORIGINAL, FaultMessage
from semlive.service.log.files import messages
from semlive.service.log.recording import Recorder

from ..clocks import HandClock

UNLIMITED = (resource.RLIM_INFINITY, resource.RLIM_INFINITY)


def fill_disk(patient: Any) -> None:
    """No file of the daemon may grow by more than 2 kB: the system refuses as a full disk does."""
    size = (patient.log / "run.000.mcap.part").stat().st_size
    resource.prlimit(patient.daemon.pid, resource.RLIMIT_FSIZE, (size + 2000, resource.RLIM_INFINITY))


def none_is_missing(patient: Any) -> bool:
    numbers = [item["sequence"] for item in patient.logged("/load_frame/sample")]
    return numbers == list(range(numbers[0], numbers[0] + len(numbers)))


def test_a_full_disk_pauses_the_run_until_there_is_room_and_the_operator_resumes(patient: Any, wait_until: Callable[..., None]) -> None:
    terminal, operator = pty.openpty()
    patient.start(operator=operator).reach("ramping")
    fill_disk(patient)
    wait_until(lambda: patient.calls()[-1:] == ["stop"])
    before = patient.calls()
    os.write(terminal, b"resume\n")
    time.sleep(1.0)
    assert patient.calls() == before
    resource.prlimit(patient.daemon.pid, resource.RLIMIT_FSIZE, UNLIMITED)
    wait_until(lambda: any("keeps up again" in item["text"] for item in patient.logged("/log")))
    assert patient.logged("/state")[-1]["after"] == "paused"
    assert patient.calls() == before
    os.write(terminal, b"resume\n")
    wait_until(lambda: patient.calls().count("ramp_to") == before.count("ramp_to") + 1)
    patient.daemon.send_signal(signal.SIGINT)
    code, _ = patient.end()
    assert code == 1
    patient.is_in_order()
    assert none_is_missing(patient)
    assert [item["after"] for item in patient.logged("/state")][-4:] == ["paused", "ramping", "stopping", "aborted"]
    assert any("the log cannot be written" in item["what"] and "paused" in item["action"] for item in patient.logged("/fault"))
    os.close(terminal)
    os.close(operator)


def test_a_full_disk_ends_a_run_that_nobody_attends(patient: Any, wait_until: Callable[..., None]) -> None:
    patient.start().reach("ramping")
    fill_disk(patient)
    wait_until(lambda: "stop" in patient.calls())
    resource.prlimit(patient.daemon.pid, resource.RLIMIT_FSIZE, UNLIMITED)
    code, _ = patient.end()
    assert code == 1
    patient.is_in_order()
    assert none_is_missing(patient)
    assert [item["after"] for item in patient.logged("/state")][-3:] == ["paused", "stopping", "aborted"]


class SlowDisk(FileIO):
    """A file on a disk that takes its time."""

    go_on = threading.Event()

    def write(self, data: bytes) -> int:  # type: ignore[override]
        self.go_on.wait()
        return super().write(data)


def test_a_slow_disk_is_reported_and_nothing_is_lost(tmp_path: Path, wait_until: Callable[..., None]) -> None:
    def open_raw(path: Path) -> RawIOBase:
        return cast(RawIOBase, SlowDisk(path, "xb"))

    printed: list[str] = []
    recorder = Recorder(tmp_path / "run.000.mcap", HandClock(1), printed.append, open_raw=open_raw, slow_after_s=2.0)
    assert recorder.backlog_message is None
    for number in range(50):
        recorder.write("/fault", FaultMessage(time_ns=number, what="x", where="", action=""))
        recorder.write(SEM_ORIGINAL, bytes(1000), sequence=number)
    assert recorder.backlog_message is None
    wait_until(lambda: recorder.backlog_message is not None)
    assert "the disk is too slow" in (recorder.backlog_message or "")
    SlowDisk.go_on.set()
    assert recorder.flush()
    assert recorder.backlog_message is None
    assert recorder.close()
    assert printed == []
    assert len(list(messages(tmp_path))) == 100


def test_the_writers_speed_next_to_the_disks_own_can_be_measured(tmp_path: Path) -> None:
    """The bar of 0.6 is the benchmark's: on a busy computer the checksum waits for a processor while the disk does not."""
    _, ratios = measured(tmp_path, count=5, size=10**6, rounds=3)
    assert all(item > 0.0 for name in ("writer", "recorder") for item in ratios[name])
