"""A stop is repeated while the device moves, and no longer."""

from __future__ import annotations

from semlive.data.loading import LoadSample, MotionState
from semlive.service.device_link.stop_pursuit import DISOBEYED_S, Motionless, StopPursuit, begin_pursuit

S = 1_000_000_000
STILL = Motionless(force_n=0.5, extension_mm=0.0, rate_n_s=30.0, ramp_sign=1.0)


def observed(pursuit: StopPursuit, forces_n: list[float], *, moving: bool = False, mm: float = 0.0, from_s: float = 0.0) -> StopPursuit:
    for number, force_n in enumerate(forces_n):
        now = round((from_s + 0.05 * (number + 1)) * S)
        motion = MotionState.MOVING if moving else MotionState.STOPPED
        pursuit = pursuit.with_sample(LoadSample(number, now, now, force_n, mm * number, motion, 0.0))
    return pursuit


def test_a_device_that_rests_is_not_stopped_again() -> None:
    pursuit = begin_pursuit(0)
    assert pursuit.due(0, STILL)
    pursuit = observed(pursuit.sent_again(0), [100.0, 100.1, 99.9, 100.0, 100.1])
    assert pursuit.rests(STILL)
    assert not pursuit.due(round(0.25 * S), STILL)


def test_a_link_that_gives_a_reading_in_a_second_shows_rest_with_the_third() -> None:
    pursuit = begin_pursuit(0).sent_again(0)
    for second in (1, 2, 3):
        assert not pursuit.rests(STILL)
        pursuit = pursuit.with_sample(LoadSample(0, second * S, second * S, 100.0, 0.0, MotionState.STOPPED, 0.0))
    assert pursuit.rests(STILL)


def test_a_held_load_that_relaxes_rests() -> None:
    assert observed(begin_pursuit(0).sent_again(0), [100.0 - 0.4 * n for n in range(10)]).rests(STILL)


def test_a_device_that_reports_motion_or_shows_it_is_stopped_again_and_again() -> None:
    for pursuit in (
        observed(begin_pursuit(0).sent_again(0), [100.0] * 10, moving=True),
        observed(begin_pursuit(0).sent_again(0), [100.0 + 1.5 * n for n in range(10)]),
        observed(begin_pursuit(0).sent_again(0), [100.0] * 10, mm=1e-4),
    ):
        assert not pursuit.rests(STILL)
        assert pursuit.due(round(0.5 * S), STILL)
    times, pursuit = [], begin_pursuit(0)
    for now in range(0, 10 * S, S // 20):
        pursuit = observed(pursuit, [100.0], moving=True, from_s=now / S - 0.05)
        if pursuit.due(now, STILL):
            pursuit, times = pursuit.sent_again(now), [*times, now / S]
    assert times[:5] == [0.0, 0.1, 0.3, 0.7, 1.5]
    assert len(times) == 13


def test_without_readings_the_stop_is_repeated_and_the_alarm_comes() -> None:
    pursuit = begin_pursuit(0).sent_again(0)
    assert not pursuit.rests(STILL)
    assert pursuit.due(round(0.4 * S), STILL)
    assert not pursuit.alarm_due(S // 2, moves=False)
    after_ns = round(DISOBEYED_S * S)
    assert pursuit.alarm_due(after_ns, moves=False)
    unknown = pursuit.with_alarm(moves=False)
    assert not unknown.alarm_due(after_ns, moves=False)
    assert unknown.alarm_due(after_ns, moves=True)
    assert not unknown.with_alarm(moves=True).alarm_due(after_ns, moves=True)
