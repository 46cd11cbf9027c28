"""Experiment time in the shell: carried by the monotonic clock, stretched together, never going back."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from semlive.data.clock import Clock
from semlive.errors import BadConfig
from semlive.formats.clock_file import encode_clock
from semlive.service.clock import FileClock, SystemClock, open_clock


def publish(path: Path, clock: Clock) -> None:
    working = path.with_suffix(".new")
    working.write_bytes(encode_clock(clock))
    working.replace(path)


def test_at_an_instrument_experiment_time_is_utc() -> None:
    clock = open_clock(None)
    assert isinstance(clock, SystemClock)
    assert abs(clock.now_ns() - time.time_ns()) < 50_000_000


def test_a_published_rate_is_followed(tmp_path: Path) -> None:
    path = tmp_path / "clock.json"
    publish(path, Clock(10**18, time.monotonic_ns(), 100.0))
    clock = FileClock(path)
    first = clock.now_ns()
    time.sleep(0.05)
    assert 4e9 < clock.now_ns() - first < 60e9


def test_a_stretched_clock_is_taken_up_and_never_goes_back(tmp_path: Path) -> None:
    path = tmp_path / "clock.json"
    published = Clock(10**18, time.monotonic_ns(), 100.0)
    publish(path, published)
    clock = FileClock(path)
    before = clock.now_ns()
    publish(path, published.stretched(20 * 10**9))
    assert clock.now_ns() == before
    assert clock.current().revision == 1
    time.sleep(0.3)
    after = clock.now_ns()
    assert after > before
    assert abs(after - published.stretched(20 * 10**9).time_ns(time.monotonic_ns())) < 10**9


def test_a_clock_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadConfig, match="start the simulator"):
        open_clock(tmp_path / "clock.json")
