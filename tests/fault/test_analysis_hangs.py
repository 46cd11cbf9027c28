"""Analysis hangs: control keeps nothing for it, starts another in its place, and that one catches up from the log."""

from __future__ import annotations

import os
import signal
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import pytest

from semlive.formats.log.messages import SEM_SIDECAR, RunMessage
from semlive.formats.log.reader import LogMessage
from semlive.service.analysis import process
from semlive.service.analysis.messages import READY_TEXT
from semlive.service.analysis.pipe import AnalysisOutput, AnalysisReady
from semlive.service.analysis.process import AnalysisProcess
from semlive.service.config.configuration import parse_config
from semlive.service.log.recording import Recorder
from semlive.service.log.run_log import RunLog

from ..clocks import WallClock

CONFIG = {
    "sem": {"folder": "export", "pixel_size_um": 1.25},
    "stage": {"driver": "null"},
    "protocol": {"calibration_shifts_px": [[0, 0]]},
}
WAITING, BYTES = 200, 100_000


def children() -> set[int]:
    return {int(item) for path in Path("/proc/self/task").iterdir() for item in (path / "children").read_text().split()}


def test_a_hung_analysis_is_started_again_and_what_waits_for_it_takes_no_memory(
    tmp_path: Path, wait_until: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder, printed, troubles, before = (
        Recorder(tmp_path / "run.000.mcap", WallClock(), pytest.fail),
        list[AnalysisOutput](),
        list[str](),
        children(),
    )

    def in_trouble(what: str, _lost: bool) -> None:
        monkeypatch.undo()
        troubles.append(what)

    link = AnalysisProcess(tmp_path, lambda: recorder.write_failed, printed.append, in_trouble)
    journal = RunLog(recorder)
    journal.subscribe(link.notify_input)
    config = parse_config(CONFIG, "here").model_dump(mode="json")
    journal.write_message(RunMessage(run="run", started_time_ns=1, host="here", versions={}, config=config))
    wait_until(lambda: bool(printed))
    (child,) = children() - before
    os.kill(child, signal.SIGSTOP)
    monkeypatch.setattr(process, "_MAX_SILENT_S", 2.0)
    tracemalloc.start()
    for number in range(WAITING):
        link.notify_input(recorder.write(SEM_SIDECAR, bytes(BYTES), sequence=number))
    assert recorder.flush()
    assert recorder.flush()  # it lets go of what it wrote with the next
    stored, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert stored < WAITING * BYTES / 10
    wait_until(lambda: bool(troubles))
    assert "hung: it was silent for" in troubles[0]
    assert link.drain(120.0)
    assert [isinstance(item, AnalysisReady) and READY_TEXT in item.line.payload.decode() for item in printed] == [True]
    assert len(troubles) == 1
    assert recorder.close()


def test_what_is_not_in_the_log_is_not_waited_for(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.000.mcap", WallClock(), pytest.fail)
    link = AnalysisProcess(tmp_path, lambda: recorder.write_failed, lambda _: None, lambda _what, _lost: None)
    link.notify_input(LogMessage(SEM_SIDECAR, 1, 1, 0, b""))
    began_s = time.monotonic()
    assert not link.close(0.2)
    assert time.monotonic() - began_s < 10.0
    assert recorder.close()


def test_steps_of_the_wall_clock_do_not_end_analysis(
    tmp_path: Path, clock_peer: Path, wait_until: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder, printed, troubles = Recorder(tmp_path / "run.000.mcap", WallClock(), pytest.fail), list[AnalysisOutput](), list[str]()
    offset = tmp_path / "offset"
    offset.write_text("0")
    with monkeypatch.context() as environment:
        environment.setenv("LD_PRELOAD", str(clock_peer))
        environment.setenv("SICK_CLOCK", str(offset))
        link = AnalysisProcess(tmp_path, lambda: recorder.write_failed, printed.append, lambda what, _lost: troubles.append(what))
    journal = RunLog(recorder)
    journal.subscribe(link.notify_input)
    config = parse_config(CONFIG, "here").model_dump(mode="json")
    # It sleeps between two looks at the log for as long as what it was promised is not there.
    link.notify_input(LogMessage("/run", 1, 1, 0, b""))
    for seconds in (3600, -7200, 86400, 0):
        time.sleep(4.0 if seconds == 3600 else 0.3)
        offset.write_text(str(seconds))
    time.sleep(0.5)
    journal.write_message(RunMessage(run="run", started_time_ns=1, host="here", versions={}, config=config))
    wait_until(lambda: bool(printed))
    assert troubles == []
    link.kill()
    link.close(0.0)
    assert recorder.close()
