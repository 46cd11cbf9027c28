"""The campaign's own judgement (tests/benchmarks/peer_frame): figures from a device's log, verdicts, and what is kept."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from peer_frame.kept import keep, read_stored
from peer_frame.page import line
from peer_frame.scenario import Ending, Expected, Fault, Group, Observed, Scenario
from peer_frame.truth import (
    Reading,
    longest_silence,
    motion_orders,
    read_log,
    stop_requests,
    unloadings,
    when_force_passes,
    without_foreign,
)
from peer_frame.verdict import figures, judge

LOG = """10.000000 F=0.000 E=0.00000 mv=0 START
11.000000 F=0.000 E=0.00000 mv=0 REQ c0 fc=16 ad=0 0000 4396 0000 41f0 0001
11.000100 F=0.000 E=0.00000 mv=1 RAMP to 300.000 at 30.000
13.000000 F=60.000 E=0.00300 mv=1 CTL runaway 1
14.000000 F=90.000 E=0.00450 mv=1 REQ c0 fc=16 ad=0 0000 4396 0000 41f0 0002 <STOP>
14.000100 F=90.000 E=0.00450 mv=1 STOP ignored
16.000000 F=150.000 E=0.00750 mv=1 REQ c0 fc=16 ad=0 0000 4396 0000 41f0 0002 <STOP>
16.000100 F=150.000 E=0.00750 mv=0 STOPPED
17.000000 F=150.000 E=0.00750 mv=0 RAMP to 100.000 at 30.000
18.000000 F=150.000 E=0.00750 mv=1 MOVE dir=2 travel=0.00100 speed=0.00100
19.000000 F=1"""
FROZEN = Fault(1, "no_response", "the load does not change", "stop")
OBSERVED = Observed(
    fault_s=13.0,
    ended_s=30.0,
    by_itself=False,
    exit_code=1,
    said="the run was stopped",
    faults=(FROZEN,),
    states=("ramping", "fault"),
    loaded_pairs=0,
    peak_n=150.0,
    final_n=150.0,
    instant_s=13.0,
    stops_s=(14.0, 16.0),
    silence_s=1.0,
    rested=True,
    unloadings=(),
    orders=0,
    moved=True,
    registers={"r11": "777"},
    second="",
    asked=False,
    wall_s=20.0,
    start_s=5.0,
)
TRIAL = Scenario("freeze", "the reading is frozen", "stop", Expected(stop_within_s=2.0, timed=True, registers={"r11": "777"}))


@pytest.fixture
def entries(tmp_path: Path) -> list:
    path = tmp_path / "device.log"
    path.write_text(LOG, encoding="utf-8")
    return read_log(path)


def test_complete_lines_of_the_log_are_read(entries: list) -> None:
    assert len(entries) == 10
    assert stop_requests(entries, 13.0, 20.0) == [14.0, 16.0]
    assert [item.at_s for item in motion_orders(entries, 13.0)] == [17.0, 18.0]


def test_orders_below_the_true_load_are_unloading(entries: list) -> None:
    assert [(item.from_n, item.to_n) for item in unloadings(entries, 20_000.0, 3.0)] == [(150.0, 100.0), (150.0, 130.0)]
    assert len(unloadings(entries, 20_000.0, 30.0)) == 1
    assert unloadings(without_foreign(entries, [(16.5, 1)]), 20_000.0, 30.0) == []


def test_another_masters_stop_does_not_count(entries: list) -> None:
    assert stop_requests(without_foreign(entries, [(13.5, 2)]), 13.0, 20.0) == [16.0]


def test_silence_counts_only_while_it_moves() -> None:
    readings = [Reading(0.1 * k, 10.0 * k, 0.0, k < 50) for k in range(100)]
    assert longest_silence(readings, [1.0, 2.0], 9.9) == pytest.approx(2.9)
    assert longest_silence(readings, [6.0], 9.9) == 0.0
    assert longest_silence(readings, [], 9.9) == 0.0
    assert when_force_passes(readings, 300.0, 1.0) == pytest.approx(3.0)
    assert when_force_passes(readings, 3000.0) is None


def test_the_pursuit_of_a_stop_ends_with_the_next_motion_order_and_the_next_stop_begins_another() -> None:
    # Moves until 2.0 s, rests until the order at 5.0 s, moves until 8.0 s; the entry of the order already reports motion.
    readings = [Reading(0.1 * k, 0.0, 0.0, k < 20 or 50 <= k < 80) for k in range(100)]
    assert longest_silence(readings, [1.5], 9.9, [5.0]) == pytest.approx(0.4)
    assert longest_silence(readings, [1.5], 9.9) == pytest.approx(6.4)  # without the order it is disobedience
    assert longest_silence(readings, [1.5, 5.8], 9.9, [5.0]) == pytest.approx(2.1)  # a second stop that is not obeyed counts
    assert longest_silence(readings, [1.5, 5.75, 6.75, 7.75], 9.9, [5.0]) == pytest.approx(0.95)


def test_what_is_as_it_must_be_passes() -> None:
    assert judge(TRIAL, OBSERVED).failings == ()


@pytest.mark.parametrize(
    ("change", "failing"),
    [
        ({"faults": ()}, "no /fault"),
        ({"faults": (replace(FROZEN, code=""),)}, "without a code"),
        ({"exit_code": 0}, "exit status 0"),
        ({"exit_code": None}, "had to be killed"),
        ({"stops_s": ()}, "no stop order"),
        ({"stops_s": (15.5,)}, "stop order after 2.50 s"),
        ({"silence_s": 4.0}, "without a further stop order"),
        ({"orders": 1}, "1 motions ordered"),
        ({"peak_n": 421.0}, "peak 421 N"),
        ({"unloadings": ("from 150 to 100 N",)}, "ordered to unload"),
        ({"loaded_pairs": 1}, "1 pairs under load"),
        ({"registers": {"r11": "0"}}, "registers of the maker"),
        ({"said": "Traceback (most recent call last)"}, "traceback"),
        ({"said": "semlive itself failed (ValueError)"}, "internal error"),
    ],
)
def test_each_deviation_fails(change: dict, failing: str) -> None:
    verdict = judge(TRIAL, replace(OBSERVED, **change))
    assert any(failing in item for item in verdict.failings), verdict.failings
    assert line(verdict).startswith("FAIL freeze")


@pytest.mark.parametrize(
    ("ending", "change", "passes"),
    [
        (Ending.REFUSED, {"exit_code": 2, "moved": False}, True),
        (Ending.REFUSED, {"exit_code": 2, "moved": True}, False),
        (Ending.REFUSED, {"exit_code": 0, "moved": False}, False),
        (Ending.PROMPTED, {"faults": (), "asked": True}, True),
        (Ending.PROMPTED, {"faults": (), "asked": False}, False),
        (Ending.RECOVERED, {"exit_code": 0}, True),
        (Ending.RECOVERED, {"exit_code": 1}, False),
        (Ending.COMPLETE, {"exit_code": 0, "faults": ()}, True),
        (Ending.COMPLETE, {"exit_code": 0}, False),
    ],
)
def test_verdict_requires_the_expected_ending(ending: Ending, change: dict, passes: bool) -> None:
    scenario = replace(TRIAL, expected=replace(TRIAL.expected, ending=ending))
    assert judge(scenario, replace(OBSERVED, **change)).passed is passes


def test_safety_bars_are_counted_as_documented() -> None:
    healthy = replace(TRIAL, name="healthy", group=Group.HEALTHY, expected=Expected(Ending.COMPLETE, stop_within_s=None))
    wild = replace(TRIAL, name="wild", expected=replace(TRIAL.expected, peak_n=None))
    good = figures([judge(TRIAL, replace(OBSERVED, stops_s=(13.2,))), judge(healthy, replace(OBSERVED, exit_code=0, faults=()))])
    assert good.hold
    assert (good.trials, good.passed, good.healthy, good.stops) == (1, 1, 1, 1)
    assert good.p99_s == pytest.approx(0.2)
    bad = figures(
        [
            judge(TRIAL, replace(OBSERVED, peak_n=500.0, faults=(), stops_s=())),
            judge(wild, replace(OBSERVED, peak_n=900.0)),
            judge(healthy, OBSERVED),
        ]
    )
    assert not bad.hold
    assert (bad.over_peak, bad.silent, bad.missed, bad.false_stops) == (("freeze",), ("freeze",), ("freeze",), ("healthy",))
    assert bad.worst_peak_n == 500.0


def test_stored_verdicts_are_read_back(tmp_path: Path) -> None:
    path = tmp_path / "found.jsonl"
    assert read_stored(path) == {}
    keep(path, "freeze", OBSERVED)
    keep(path, "freeze", replace(OBSERVED, peak_n=1.0))
    assert read_stored(path) == {"freeze": replace(OBSERVED, peak_n=1.0)}
