"""A clock file that is damaged during a run: time continues from the last valid line."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from semlive.data.clock import Clock
from semlive.errors import BadConfig
from semlive.formats.tables.clock_file import encode_clock
from semlive.service.runtime.clock import SimulatedClock


def test_time_continues_with_a_damaged_clock_file(tmp_path: Path) -> None:
    path = tmp_path / "clock.json"
    path.write_bytes(encode_clock(Clock(10**18, time.monotonic_ns(), 20.0)))
    clock = SimulatedClock(path)
    before_ns = clock.now_ns()
    for spoilt in (b"", b"not a clock"):
        path.write_bytes(spoilt)
        assert before_ns < clock.now_ns() < before_ns + 20 * 10**9
    assert clock.current().rate == 20.0


def test_a_clock_file_that_is_none_from_the_beginning_is_named(tmp_path: Path) -> None:
    path = tmp_path / "clock.json"
    path.write_bytes(b"not a clock")
    with pytest.raises(BadConfig, match=r"clock\.json"):
        SimulatedClock(path)
