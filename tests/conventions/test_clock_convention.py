"""Experiment time: a line over the monotonic clock that may only be set back."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from semlive.data.clock import Clock

SECOND_NS = 1_000_000_000
UTC0_NS = 1_767_225_600 * SECOND_NS
MONO0_NS = 4_321 * SECOND_NS
rates = st.floats(0.1, 100.0)
half_days_ns = st.integers(0, 43_200 * SECOND_NS)


def test_rate_is_experiment_seconds_per_wall_second() -> None:
    clock = Clock(UTC0_NS, MONO0_NS, rate=20.0)
    assert clock.time_ns(MONO0_NS) == UTC0_NS
    assert clock.time_ns(MONO0_NS + SECOND_NS) == UTC0_NS + 20 * SECOND_NS
    assert clock.mono_ns(UTC0_NS + 30 * SECOND_NS) == MONO0_NS + 1_500_000_000


def test_at_an_instrument_no_nanosecond_is_lost() -> None:
    clock = Clock(UTC0_NS, MONO0_NS)
    span_ns = 86_400 * SECOND_NS + 1
    assert clock.time_ns(MONO0_NS + span_ns) == UTC0_NS + span_ns
    assert clock.mono_ns(UTC0_NS + span_ns) == MONO0_NS + span_ns


@given(rates, half_days_ns)
def test_back_and_forth_is_exact_to_the_rounding(rate: float, span_ns: int) -> None:
    clock = Clock(UTC0_NS, MONO0_NS, rate)
    mono_ns = MONO0_NS + span_ns
    assert abs(clock.mono_ns(clock.time_ns(mono_ns)) - mono_ns) <= 1 + 0.5 / rate


@given(rates, half_days_ns, st.integers(0, SECOND_NS))
def test_time_never_runs_backwards_along_one_line(rate: float, span_ns: int, more_ns: int) -> None:
    clock = Clock(UTC0_NS, MONO0_NS, rate)
    assert clock.time_ns(MONO0_NS + span_ns + more_ns) >= clock.time_ns(MONO0_NS + span_ns)


@given(rates, half_days_ns, st.integers(SECOND_NS, 600 * SECOND_NS))
def test_stretching_moves_every_deadline_later(rate: float, span_ns: int, by_ns: int) -> None:
    clock = Clock(UTC0_NS, MONO0_NS, rate, revision=3)
    later = clock.stretched(by_ns, MONO0_NS)
    assert later.time_ns(MONO0_NS + span_ns) == clock.time_ns(MONO0_NS + span_ns) - by_ns
    deadline_ns = UTC0_NS + span_ns
    assert later.mono_ns(deadline_ns) > clock.mono_ns(deadline_ns)
    assert later.mono_ns(deadline_ns) - clock.mono_ns(deadline_ns) == pytest.approx(by_ns / rate, abs=2)
    assert (later.rate, later.revision) == (clock.rate, 4)


@given(rates, half_days_ns, st.integers(SECOND_NS, 600 * SECOND_NS), st.integers(0, 600 * SECOND_NS))
def test_time_is_constant_after_a_stretch_and_never_goes_back(rate: float, span_ns: int, by_ns: int, more_ns: int) -> None:
    mono_ns = MONO0_NS + span_ns
    clock = Clock(UTC0_NS, MONO0_NS, rate)
    later = clock.stretched(by_ns, mono_ns)
    assert later.now_ns(mono_ns) == clock.now_ns(mono_ns)
    assert later.now_ns(mono_ns + more_ns) == max(clock.now_ns(mono_ns), later.time_ns(mono_ns + more_ns))


@pytest.mark.parametrize("rate", [0.0, -1.0, math.nan])
def test_a_clock_that_stops_or_runs_backwards_is_refused(rate: float) -> None:
    with pytest.raises(ValueError, match="rate"):
        Clock(UTC0_NS, MONO0_NS, rate)
