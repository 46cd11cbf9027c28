"""Progress messages of long jobs and the remaining time that they print."""

from __future__ import annotations

import io
import queue

import pytest
from rich.console import Console

from semlive.cli.during_run.run import _queue_command
from semlive.cli.during_run.run_status import ProgressView, RemainingTime, Repeat, disobeyed
from semlive.data.experiment import Phase
from semlive.engine import OperatorCommand, RunStatus, State
from semlive.service.control.run_monitor import RunSnapshot
from semlive.service.log.alarms import AcknowledgeAll, Alarm


def test_a_run_takes_as_long_for_each_step_as_before() -> None:
    pace = RemainingTime()
    assert pace.seconds(0, 5, 100.0) is None
    assert pace.seconds(0, 5, 105.0) is None
    assert pace.seconds(1, 5, 110.0) == pytest.approx(40.0)
    assert pace.seconds(1, 5, 116.0) == pytest.approx(34.0)
    assert pace.seconds(2, 5, 130.0) == pytest.approx(45.0)
    assert pace.seconds(2, 5, 300.0) == 0.0


def test_a_resumed_run_counts_only_its_own_steps() -> None:
    pace = RemainingTime()
    assert pace.seconds(7, 10, 0.0) is None
    assert pace.seconds(8, 10, 20.0) == pytest.approx(40.0)


DISOBEYED = Alarm(5, "stop_not_obeyed", "it moves on after 12 stops", "load frame", "orders the stop again")
NAME = "a\x1b[2J\nb.tif"


def snapshot(*alarms: Alarm, warnings: tuple[str, ...] = ()) -> RunSnapshot:
    at = RunStatus(State.FAULT, 0, 3, Phase.TENSION, None, 10.0, 100.0, (0.0, 0.0), 0, f"{NAME} is truncated")
    return RunSnapshot(5, at, None, None, 0, warnings, alarms)


def shown(*snapshots: RunSnapshot, terminal: bool) -> str:
    """What a view of these snapshots writes."""
    console = Console(file=io.StringIO(), force_terminal=terminal, width=200, color_system="standard" if terminal else None)
    with ProgressView(console) as view:
        for item in snapshots:
            view.show(item)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


@pytest.mark.parametrize("terminal", [False, True])
def test_a_machine_that_does_not_obey_is_reported_at_once_and_prominently(terminal: bool) -> None:
    printed = shown(snapshot(), snapshot(DISOBEYED), snapshot(DISOBEYED), terminal=terminal)
    (line,) = [line for line in printed.splitlines() if "own emergency stop" in line and "!!!" in line]
    assert "it moves on after 12 stops" in line
    assert ("\x1b[1;37;41m" in line) == terminal


def test_an_alarm_is_repeated_every_few_seconds_until_it_is_acknowledged() -> None:
    repeat = Repeat(5.0)
    assert [repeat.due(True, 100.0 + second) for second in range(12)] == [second in (0, 5, 10) for second in range(12)]
    assert not repeat.due(False, 112.0)
    assert repeat.due(True, 112.5)
    assert disobeyed((DISOBEYED,)) is DISOBEYED
    assert disobeyed((Alarm(5, "stop_not_obeyed", "", "", "", acknowledged_ns=6), Alarm(7, "limit", "", "", ""))) is None


@pytest.mark.parametrize("terminal", [False, True])
def test_names_from_outside_reach_no_terminal_raw(terminal: bool) -> None:
    printed = shown(snapshot(warnings=(f"{NAME} is truncated",)), terminal=terminal)
    assert "a\\x1b[2J\\nb.tif is truncated" in printed
    assert NAME not in printed
    assert "\x1b[2J" not in printed


def test_what_is_typed_is_a_verb_or_acknowledges_every_alarm() -> None:
    typed = queue.SimpleQueue[OperatorCommand | AcknowledgeAll]()
    assert [_queue_command(typed, line) for line in (" Stop \n", "acknowledge\n", "acknowledged\n", "\n")] == [True, True, False, False]
    assert [typed.get(), typed.get()] == [OperatorCommand.STOP, AcknowledgeAll("terminal")]
    assert typed.empty()
