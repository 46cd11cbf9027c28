"""Experiment time in the shell: carried by the monotonic clock, stretched together, never going back."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import pytest

from semlive.data.clock import Clock
from semlive.errors import BadConfig
from semlive.formats.tables.clock_file import encode_clock
from semlive.service.runtime.clock import SimulatedClock, SystemClock, open_clock
from semlive_simulators.bench_clock import BenchClock


def publish(path: Path, clock: Clock) -> None:
    working = path.with_suffix(".new")
    working.write_bytes(encode_clock(clock))
    working.replace(path)


def test_at_an_instrument_experiment_time_is_utc() -> None:
    clock = open_clock(None)
    assert isinstance(clock, SystemClock)
    before_ns = time.time_ns()
    reported_ns = clock.now_ns()
    assert before_ns - 50_000_000 < reported_ns < time.time_ns() + 50_000_000


def test_a_published_rate_is_followed(tmp_path: Path) -> None:
    path = tmp_path / "clock.json"
    publish(path, Clock(10**18, time.monotonic_ns(), 100.0))
    clock = SimulatedClock(path)
    early_ns = time.monotonic_ns()
    first = clock.now_ns()
    late_ns = time.monotonic_ns()
    time.sleep(0.05)
    again_early_ns = time.monotonic_ns()
    again = clock.now_ns()
    assert 100 * (again_early_ns - late_ns) - 1000 <= again - first <= 100 * (time.monotonic_ns() - early_ns) + 1000


def test_a_stretched_clock_is_continued_and_never_goes_back(tmp_path: Path) -> None:
    path = tmp_path / "clock.json"
    published = Clock(10**18, time.monotonic_ns(), 100.0)
    publish(path, published)
    clock = SimulatedClock(path)
    stretched_at_ns = time.monotonic_ns()
    stretched = published.stretched(2000 * 10**9, stretched_at_ns)  # 20 s by the wall
    publish(path, stretched)
    before = published.time_ns(stretched_at_ns)
    assert clock.now_ns() == before
    assert clock.current().revision == 1
    stretched = published.stretched(20 * 10**9, stretched_at_ns)
    stretched = replace(stretched, revision=2)
    publish(path, stretched)
    end_s = time.monotonic() + 100.0
    while clock.now_ns() == before:
        assert time.monotonic() < end_s
        time.sleep(0.01)
    early_ns = stretched.time_ns(time.monotonic_ns())
    after = clock.now_ns()
    assert early_ns <= after <= stretched.time_ns(time.monotonic_ns())
    assert after > before


def test_after_late_work_the_devices_and_the_stamps_of_their_readings_have_the_same_time(tmp_path: Path) -> None:
    """At rate 40 a demo stopped itself: the load frame was 1.4 s (72.6 N at 50 N/s) ahead of the stamps after a stretch."""
    path = tmp_path / "clock.json"
    devices = BenchClock(40.0, lambda clock: publish(path, clock))
    devices.begin()
    stamps = SimulatedClock(path)
    stamps.now_ns()
    for _ in range(3):
        devices.register_work("strip", devices.now_ns())
        time.sleep(0.1)  # 4 s of experiment time without a stamp, as when both processors are busy
        moved_to_ns = devices.now_ns()
        devices.done("strip")
        for _ in range(50):
            earliest, device_ns, latest = stamps.now_ns(), devices.now_ns(), stamps.now_ns()
            assert moved_to_ns <= earliest <= device_ns <= latest
            time.sleep(0.004)
    assert devices.stretches == 3


def test_a_clock_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadConfig, match="start the simulator"):
        open_clock(tmp_path / "clock.json")
