"""Remaining time of a run: planned durations, scaled by measured ones; it stops with the protocol."""

from __future__ import annotations

from typing import Any

import pytest

from semlive.engine.schedule import TimingAssumptions, schedule
from semlive.service.config.configuration import parse_config
from semlive.web.run_progress import RunProgress, with_pair, with_plan, with_state

CONFIG: dict[str, Any] = {
    "sem": {"folder": ".", "pixel_size_um": 1.0},
    "load_frame": {"driver": "null"},
    "limits": dict(force_min_n=-50.0, force_max_n=900.0, extension_min_mm=-1.0, extension_max_mm=1.0, force_rate_max_n_s=50.0)
    | dict(force_step_max_n=900.0, stage_travel_um=100.0),
    "protocol": {"loads_n": [100.0, 200.0, 300.0, 400.0], "hold_s": 30.0},
}
SCAN_S = 50.0


def planned() -> tuple[RunProgress, tuple[float, ...]]:
    plan = parse_config(CONFIG, "test").plan()
    expected_s = tuple(step.ends_s - step.begins_s for step in schedule(plan, TimingAssumptions(SCAN_S)).steps)
    return with_plan(RunProgress(scan_s=SCAN_S), plan, 0.0), expected_s


def test_no_remaining_time_before_the_first_scan() -> None:
    progress, _ = planned()
    assert RunProgress().shown()["remaining_s"] is None
    assert with_plan(RunProgress(), progress.plan, 0.0).shown()["remaining_s"] is None


def test_at_the_start_the_plan_counts() -> None:
    progress, expected_s = planned()
    shown = progress.shown()
    assert (shown["remaining_s"], shown["working"]) == (pytest.approx(sum(expected_s), abs=0.1), False)
    assert shown["floor_s"] == pytest.approx(sum(expected_s[1:]), abs=0.1)


def test_measured_steps_scale_the_others() -> None:
    progress, expected_s = planned()
    progress = with_pair(with_state(progress, "ramping", 0.0), 1, 2.0 * expected_s[0])
    assert progress.shown()["remaining_s"] == pytest.approx(2.0 * sum(expected_s[1:]), abs=0.1)


def test_a_pause_stops_it_and_the_step_begins_again() -> None:
    progress, expected_s = planned()
    progress = with_state(with_state(progress, "ramping", 0.0), "holding", 20.0)
    assert progress.shown()["remaining_s"] == pytest.approx(sum(expected_s) - 20.0, abs=0.1)
    paused = with_state(progress, "paused", 30.0)
    assert (paused.shown()["remaining_s"], paused.shown()["working"]) == (pytest.approx(sum(expected_s), abs=0.1), False)
    again = with_pair(with_state(paused, "ramping", 5000.0), 1, 5000.0 + expected_s[0])
    assert again.measured_s == pytest.approx(expected_s[0])
    assert again.shown()["remaining_s"] == pytest.approx(sum(expected_s[1:]), abs=0.1)


def test_a_slow_step_does_not_shorten_later_ones() -> None:
    progress, expected_s = planned()
    progress = with_state(with_state(progress, "ramping", 0.0), "imaging", 10.0 * sum(expected_s))
    assert progress.shown()["remaining_s"] == progress.shown()["floor_s"] == pytest.approx(sum(expected_s[1:]), abs=0.1)


def test_an_additional_pair_and_a_resumed_run_are_no_measured_steps() -> None:
    progress, expected_s = planned()
    progress = with_pair(with_state(progress, "ramping", 0.0), 0, 77.0)
    assert progress.measured_steps == ()
    progress = with_plan(with_state(progress, "ramping", 80.0), progress.plan, 90.0)
    progress = with_pair(with_state(progress, "recover", 9000.0), 1, 9001.0)
    assert (progress.done, progress.measured_steps) == (1, ())
    assert progress.shown()["remaining_s"] == pytest.approx(sum(expected_s[1:]), abs=0.1)
