"""Load frame and trigger of a hand, the console they share, and files that other programs write."""

from __future__ import annotations

import os
import queue
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from semlive.data.loading import ControlMode, MotionState, StopOnLinkLoss
from semlive.errors import BadConfig, LinkError, LinkRefused
from semlive.ports import LoadFrame, Trigger
from semlive_drivers.composite_config import open_load_frame as open_assembled
from semlive_drivers.operator.console import Console
from semlive_drivers.operator.load_frame import open_load_frame
from semlive_drivers.operator.trigger import open_trigger

from ...clocks import MonotonicClock
from ...waiting import wait_until


class Terminal:
    """A console that a test types into."""

    def __init__(self) -> None:
        self.shown: list[str] = []
        self._typed: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self.console = Console(lambda: iter(self._typed.get, None), self.shown.append)

    def types(self, line: str) -> None:
        self._typed.put(line)

    def leaves(self) -> None:
        self._typed.put(None)


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    made = Terminal()
    yield made
    made.leaves()


def test_an_answer_source_takes_lines_before_a_prompt(terminal: Terminal) -> None:
    taken: list[str] = []
    terminal.console.add_answer_source(lambda line: line == "stop" and not taken.append(line))
    terminal.types("stop")
    wait_until(lambda: taken == ["stop"])  # nobody has asked anything yet
    answered: list[str] = []
    terminal.console.ask("done?", lambda line: not answered.append(line))
    terminal.types("stop")
    terminal.types("yes")
    wait_until(lambda: answered)
    assert (taken, answered) == (["stop", "stop"], ["yes"])


def test_a_hand_brings_a_load_and_types_it(terminal: Terminal) -> None:
    frame = open_load_frame({"program": "MICROTEST", "arrived_n": 2.0}, MonotonicClock(), console=terminal.console)
    assert isinstance(frame, LoadFrame)
    assert frame.identity.stop_on_link_loss is StopOnLinkLoss.ASSUMED
    assert (frame.identity.control, frame.identity.measures_extension) == (ControlMode.MANUAL, False)
    assert frame.order_problem(100.0, 2.0) is None
    assert "a load that is no number cannot be requested" in str(frame.order_problem(float("nan"), 2.0))
    frame.ramp_to(100.0, 2.0)
    assert terminal.shown == [
        "in MICROTEST, bring the load to 100 N at 2 N/s, then hold; type the load in N and press enter when it is there"
    ]
    assert frame.read().motion is MotionState.MOVING
    terminal.types("ninety")
    terminal.types("90,5")
    wait_until(lambda: len(terminal.shown) == 3)
    assert terminal.shown[1] == "ninety is no load; type the load in N as MICROTEST shows it"
    assert terminal.shown[2] == "that is -9.5 N from 100 N; bring it nearer and type it again"
    assert (frame.read().force_n, frame.read().motion) == (90.5, MotionState.MOVING)
    terminal.types("99.2")
    wait_until(lambda: frame.read().motion is MotionState.STOPPED)
    sample = frame.read()
    assert (sample.force_n, sample.target_n) == (99.2, 100.0)
    frame.ramp_to(200.0, 2.0)
    assert frame.stop_blind()
    assert terminal.shown[-1] == "STOP the motion in MICROTEST and hold"
    assert frame.read().motion is MotionState.STOPPED
    frame.close()


def test_a_file_reports_the_load_and_when_it_is_there(terminal: Terminal, tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("Time (s);Force (kN);Extension (mm)\n0,0;0,010;0,00\n", encoding="latin-1")
    file = {"file": str(path), "decimal_comma": True, "encoding": "latin-1", "frozen_after_s": 100.0}
    file |= {"force": {"column": "Force (kN)", "unit": "kN"}, "extension": {"column": 3, "unit": "mm"}}
    frame = open_load_frame({"load_file": file}, MonotonicClock(), console=terminal.console)
    assert frame.read().force_n == pytest.approx(10.0)
    frame.ramp_to(50.0, 1.0)
    with path.open("a", encoding="latin-1") as grown:
        grown.write("1,0;0,040;0,01\n1,1;0,0")
        grown.flush()
        sample = frame.read()
        assert (sample.force_n, sample.extension_mm, sample.motion) == (pytest.approx(40.0), 0.01, MotionState.MOVING)
        grown.write("48;0,02\n")
    frame.read()
    assert frame.read().motion is MotionState.STOPPED
    assert terminal.shown[-1] == "the load is 50 N; hold it there"
    frame.close()


def test_a_file_that_does_not_grow_is_no_reading(tmp_path: Path) -> None:
    path = tmp_path / "gage.txt"
    path.write_text("1.5\t-20.0\n", encoding="utf-8")
    cell = {"protocol": "csv", "file": str(path), "force": {"column": 1}, "gage": {"column": 2, "unit": "ustrain"}, "frozen_after_s": 0.6}
    frame = open_assembled({"cell": cell}, MonotonicClock())
    sample = frame.read()
    assert (sample.force_n, sample.gage_strain) == (1.5, pytest.approx(-20e-6))
    time.sleep(0.65)
    with pytest.raises(LinkError, match=r"has not grown for \d+\.\d s; check that the program"):
        frame.read()
    with path.open("a", encoding="utf-8") as grown:
        grown.write("1.6\tOVER\n")
    sample = frame.read()
    assert (sample.force_n, sample.gage_strain) == (1.6, None)
    with path.open("a", encoding="utf-8") as grown:
        grown.write("-----\t1\n")
    with pytest.raises(LinkError, match="holds '-----' in column 1, which is no reading"):
        frame.read()
    with pytest.raises(LinkError, match="cannot be moved by semlive"):
        frame.ramp_to(1.0, 1.0)
    path.unlink()
    with pytest.raises(LinkError, match="no such file"):
        frame.read()
    frame.close()


def test_the_newest_of_several_files_is_read(tmp_path: Path) -> None:
    for number in (1, 2):
        path = tmp_path / f"log{number}.csv"
        path.write_text(f"t,N\n0,{number}\n", encoding="utf-8")
        os.utime(path, (number, number))
    cell = {"protocol": "csv", "file": str(tmp_path / "log*.csv"), "force": {"column": "N"}}
    frame = open_assembled({"cell": cell}, MonotonicClock())
    assert frame.read().force_n == 2.0
    (tmp_path / "log3.csv").write_text("N,t\n3,0\n", encoding="utf-8")
    assert frame.read().force_n == 3.0
    frame.close()


@pytest.mark.parametrize(
    ("file", "error", "sentence"),
    [
        ({"file": "none.csv", "force": {"column": 1}}, LinkRefused, "none.csv: there is no such file; start the recording"),
        ({"file": "none*.csv", "force": {"column": 1}}, LinkRefused, "no file has such a name"),
        ({"file": "none.csv"}, BadConfig, "name a column: force, extension or gage"),
        ({"file": "none.csv", "force": {"column": 1, "unit": "stone"}}, BadConfig, "unit 'stone' is not known"),
    ],
)
def test_what_is_wrong_with_a_file_is_reported(file: dict[str, object], error: type[Exception], sentence: str) -> None:
    with pytest.raises(error, match=sentence):
        open_assembled({"cell": {"protocol": "csv", **file}}, MonotonicClock())


def test_a_trigger_asks_the_operator(terminal: Terminal) -> None:
    trigger = open_trigger({}, MonotonicClock(), console=terminal.console)
    assert isinstance(trigger, Trigger)
    trigger.scan_once()
    trigger.close()
    assert terminal.shown == ["scan one frame now and save it into the export folder"]


def test_a_line_goes_to_the_latest_prompt(terminal: Terminal) -> None:
    received: list[str] = []
    terminal.console.ask("first?", lambda line: received.append(f"first {line}") is None)
    terminal.console.ask("second?", lambda line: received.append(f"second {line}") is None)
    for line in ("a", "b", "c"):
        terminal.types(line)
    wait_until(lambda: len(received) == 2)
    assert received == ["second a", "first b"]


def test_a_stop_is_displayed_as_long_as_the_load_of_the_file_changes_after_arrival(terminal: Terminal, tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("Force (N)\n0.0\n", encoding="utf-8")
    frame = open_load_frame({"load_file": {"file": str(path), "force": {"column": "Force"}}}, MonotonicClock(), console=terminal.console)
    frame.ramp_to(50.0, 30.0)
    with path.open("a", encoding="utf-8") as grown:
        for load_n in (48.0, 55.0, 70.0):
            grown.write(f"{load_n}\n")
            grown.flush()
            frame.read()
    assert frame.read().motion is MotionState.STOPPED  # the load had arrived, and nothing was requested since
    frame.stop()
    assert terminal.shown[-1] == "STOP the motion in the load frame's program and hold"
    assert frame.read().motion is MotionState.MOVING
    time.sleep(0.6)
    assert frame.read().motion is MotionState.STOPPED
    frame.close()
