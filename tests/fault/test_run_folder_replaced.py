"""The folder of a run is deleted or replaced while it is written: no second run begins there, and no other run's log is analysed."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from semlive.errors import BadConfig, BadLog
from semlive.formats.log.messages import LogLineMessage, RunMessage
from semlive.formats.log.writer import LogWriter
from semlive.service.analysis.pipe import LOG_REPLACED, AnalysisOutput
from semlive.service.analysis.process import AnalysisProcess
from semlive.service.config.configuration import parse_config
from semlive.service.log.files import messages, segments
from semlive.service.log.lock import only_one_at, run_lock
from semlive.service.log.recording import Recorder
from semlive.service.log.run_log import RunLog
from semlive.service.log.tail import LogReplaced, LogTail

CONFIG = {
    "sem": {"folder": "export", "pixel_size_um": 1.25},
    "stage": {"driver": "null"},
    "protocol": {"calibration_shifts_px": [[0, 0]]},
}


class Now:
    """Experiment time that begins at a moment of the test's choice."""

    def __init__(self, first_ns: int) -> None:
        self._ns = first_ns

    def now_ns(self) -> int:
        self._ns += 1
        return self._ns

    def mono_ns(self) -> int:
        return self._ns


def write(path: Path, first_ns: int, count: int, part: bool = True) -> Path:
    """A segment of so many lines."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path = path.with_name(path.name + ".part") if part else path
    with path.open("wb") as stream:
        writer = LogWriter(stream)
        for number in range(count):
            writer.write("/log", LogLineMessage(time_ns=first_ns + number, level="info", text="x"), first_ns + number, first_ns + number)
        writer.flush() if part else writer.finish()
    return path


@pytest.mark.parametrize("replaced", [False, True])
def test_no_second_daemon_begins_where_a_run_was_deleted(patient: Any, wait_until: Callable[..., None], replaced: bool) -> None:
    first = patient.start().reach("ramping").daemon
    assert next(iter(messages(patient.log))).topic == "/run"
    os.kill(first.pid, signal.SIGSTOP)  # it would notice, stop and end: a busy computer gives it no time to
    os.waitid(os.P_PID, first.pid, os.WSTOPPED | os.WNOWAIT)  # on a busy computer it runs on for a moment
    shutil.rmtree(patient.log)
    if replaced:
        patient.log.mkdir()
    before = patient.calls()
    patient.start()
    code, printed = patient.end()
    after = patient.calls()  # read before the first daemon runs on: it then notices at once and stops the frame
    os.kill(first.pid, signal.SIGCONT)
    assert code == 2
    assert "another semlive is at work on this run" in printed
    if sys.platform == "linux":
        assert f"process {first.pid} (user " in printed
    assert after == before
    assert list(patient.log.iterdir()) == [] if replaced else not patient.log.exists()
    wait_until(lambda: "stop" in patient.calls()[len(before) :])
    first.send_signal(signal.SIGKILL)
    first.communicate()
    shutil.rmtree(patient.log, ignore_errors=True)
    patient.start().reach("ramping")


def test_a_place_is_held_by_whatever_path_it_is_reached(tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "runs")
    run = tmp_path / "runs" / "one"
    with only_one_at(run):
        for path in (run, tmp_path / "link" / "one", tmp_path / "runs" / ".." / "runs" / "one"):
            with pytest.raises(BadConfig, match="another semlive is at work"), only_one_at(path):
                pass
        with only_one_at(tmp_path / "runs" / "two"):
            pass
    run.mkdir()
    with run_lock(run):
        run.rmdir()
        run.mkdir()
        with pytest.raises(BadConfig, match="another semlive is at work"), run_lock(run):
            pass
    with run_lock(run):
        pass


def test_a_reader_does_not_continue_in_another_runs_segment(tmp_path: Path) -> None:
    write(tmp_path / "run.000.mcap", 100, 5)
    tail = LogTail(tmp_path)
    assert [item.log_time_ns for item in tail.poll()] == [100, 101, 102, 103, 104]
    (tmp_path / "run.000.mcap.part").unlink()
    assert list(tail.poll()) == []
    write(tmp_path / "run.000.mcap", 900, 0)
    assert list(tail.poll()) == []
    (tmp_path / "run.000.mcap.part").unlink()
    write(tmp_path / "run.000.mcap", 900, 9)
    with pytest.raises(LogReplaced, match=r"run\.000\.mcap\.part: was replaced by the log of another run"):
        list(tail.poll())


def test_a_reader_of_a_later_segment_does_not_go_back_to_another_runs_first(tmp_path: Path) -> None:
    write(tmp_path / "run.000.mcap", 100, 2, part=False)
    write(tmp_path / "run.001.mcap", 200, 2)
    tail = LogTail(tmp_path)
    assert [item.log_time_ns for item in tail.poll()] == [100, 101, 200, 201]
    shutil.rmtree(tmp_path)
    write(tmp_path / "run.000.mcap", 900, 9)
    assert list(tail.poll()) == []


def test_an_analysis_that_is_started_again_refuses_another_runs_log(tmp_path: Path) -> None:
    write(tmp_path / "run.000.mcap", 900, 9)
    command = [sys.executable, "-m", "semlive.service.analysis.worker", "--log", str(tmp_path), "--inputs", "1", "--began-ns", "100"]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=120)
    assert done.returncode == LOG_REPLACED
    assert done.stderr == f"{tmp_path}: is not the log of this run any more; look at what became of the folder.\n"
    assert done.stdout == ""


def test_analysis_of_a_replaced_folder_is_given_up_at_once(tmp_path: Path, wait_until: Callable[..., None]) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    recorder, printed, troubles = (
        Recorder(folder / "run.000.mcap", Now(1000), lambda _: None),
        list[AnalysisOutput](),
        list[tuple[str, bool]](),
    )
    link = AnalysisProcess(folder, lambda: recorder.write_failed, printed.append, lambda what, lost: troubles.append((what, lost)))
    journal = RunLog(recorder)
    journal.subscribe(link.notify_input)
    config = parse_config(CONFIG, "here").model_dump(mode="json")
    journal.write_message(RunMessage(run="run", started_time_ns=1, host="here", versions={}, config=config))
    wait_until(lambda: bool(printed))
    shutil.rmtree(folder)
    folder.mkdir()
    other = Recorder(folder / "run.000.mcap", Now(9_000_000), pytest.fail)
    other.write("/run", RunMessage(run="run", started_time_ns=9, host="here", versions={}, config=config))
    assert other.flush()
    journal.write_message(RunMessage(run="run", started_time_ns=2, host="here", versions={}, config=config))
    wait_until(lambda: bool(troubles))
    assert troubles == [(f"the analysis process ended: {folder} was replaced by the log of another run; it is given up", True)]
    assert not link.drain(10.0)
    assert other.close()
    recorder.close(0.0)


class Replaced(type(Path())):  # type: ignore[misc]
    """A folder that another run removes after it was found, and before it is listed."""

    def is_dir(self) -> bool:
        return True


def test_a_folder_that_is_removed_before_it_is_listed_holds_no_log(tmp_path: Path) -> None:
    folder = Replaced(tmp_path / "run")
    with pytest.raises(BadLog, match="no such log"):
        segments(folder)
    assert list(LogTail(folder).poll()) == []


class CreatedWhileRead(type(Path())):  # type: ignore[misc]
    """A folder that a run creates while a reader looks for it."""

    def is_dir(self) -> bool:
        found = super().is_dir()
        if not self.exists():
            os.mkdir(self)
        return found


def test_a_run_folder_that_appears_while_it_is_looked_for_is_read(tmp_path: Path) -> None:
    folder = CreatedWhileRead(tmp_path / "run")
    tail = LogTail(folder)
    assert list(tail.poll()) == []
    write(tmp_path / "run" / "run.000.mcap", 100, 3)
    assert [item.log_time_ns for item in tail.poll()] == [100, 101, 102]
