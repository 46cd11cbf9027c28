"""The clock file and the bench's clock."""

from __future__ import annotations

import threading
import time

import pytest

from semlive.data.clock import Clock
from semlive.errors import BadInput
from semlive.formats.tables.clock_file import decode_clock, encode_clock
from semlive_simulators.bench_clock import BenchClock


def test_a_clock_comes_back_to_the_nanosecond() -> None:
    clock = Clock(1_795_262_981_144_238_361, 2_137_099_630_832, 40.0, 3)
    assert decode_clock(encode_clock(clock)) == clock


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "not JSON"),
        (b"\xff\xfe", "not JSON"),
        (b"[]", "version"),
        (b'{"version": 2}', "version"),
        (b'{"version": 1, "utc0_ns": 1, "mono0_ns": 2, "rate": 1.0}', "revision"),
        (b'{"version": 1, "utc0_ns": 1.5, "mono0_ns": 2, "rate": 1.0, "revision": 0}', "utc0_ns"),
        (b'{"version": 1, "utc0_ns": true, "mono0_ns": 2, "rate": 1.0, "revision": 0}', "utc0_ns"),
        (b'{"version": 1, "utc0_ns": 1, "mono0_ns": 2, "rate": 0, "revision": 0}', "rate"),
        (b'{"version": 1, "utc0_ns": 1, "mono0_ns": 2, "rate": NaN, "revision": 0}', "rate"),
    ],
)
def test_a_bad_clock_file_is_refused(data: bytes, says: str) -> None:
    with pytest.raises(BadInput, match=says):
        decode_clock(data)


def test_late_work_stretches_the_clock_for_everybody(capsys: pytest.CaptureFixture[str]) -> None:
    published: list[Clock] = []
    clock = BenchClock(100.0, published.append)
    assert clock.now_ns() == clock.start_ns
    assert published == []
    clock.begin()
    clock.register_work("strip", clock.start_ns + 10**13)  # 100 s by the wall
    assert clock.lag_s() == 0.0
    due_ns = clock.start_ns + 1_000_000_000
    clock.register_work("strip", due_ns)
    time.sleep(0.05)  # 5 s of experiment time
    before = clock.now_ns()
    assert clock.lag_s() >= 3.9
    early_ns = time.monotonic_ns()
    clock.done("strip")
    assert clock.stretches == 1
    assert clock.lag_s() == 0.0
    assert clock.now_ns() >= before
    assert len(published) == 2
    assert published[1].revision == 1
    late_s = (published[0].utc0_ns - published[1].utc0_ns) * 1e-9
    assert late_s >= 3.9
    # What was late is due at the instant at which it was done.
    assert published[1].time_ns(early_ns) <= due_ns <= published[1].time_ns(time.monotonic_ns())
    assert f"strip was {late_s:.2f} s late" in capsys.readouterr().err


def test_work_in_time_does_not_change_the_clock() -> None:
    published: list[Clock] = []
    clock = BenchClock(1.0, published.append)
    clock.begin()
    clock.register_work("strip", clock.now_ns() + 60_000_000_000)
    clock.done("strip")
    assert clock.stretches == 0
    assert len(published) == 1
    assert 0 <= clock.worst_lag_s < 1.0


def test_waiting_ends_at_the_instant_or_on_request() -> None:
    clock = BenchClock(10.0, lambda _: None)
    clock.begin()
    stop = threading.Event()
    assert clock.wait_until(clock.start_ns + 200_000_000, stop)
    assert clock.now_ns() >= clock.start_ns + 200_000_000
    stop.set()
    assert not clock.wait_until(clock.start_ns + 10**15, stop)
