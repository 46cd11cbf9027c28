"""Supervision of two successive readings: slip, fracture, runaway load, a crosshead without load; and the emergency that follows."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from semlive.data.loading import DeviceFault, LoadSample, MotionState
from semlive.engine import LinksOpening, LinksReady, LoadReading, Notify, OperatorAction, OperatorCommand, RampTo, State, StopMotion, start
from semlive.engine.supervision.load_watch import INITIAL

from .bench_in_memory import IDENTITY, LIMITS, T0, Run, S, plan_of

HERE = (0.0, 0.0)
WATCHED = replace(LIMITS, force_drop_max_n=50.0, force_slope_max_n_s=250.0, slack_max_mm=0.1)


def problems(
    forces: list[float], *, every_s: float = 0.05, extensions: list[float] | None = None, target_n: float | None = None
) -> list[str]:
    """Findings for successive readings; the crosshead moves if they have extensions."""
    watch, printed = INITIAL, []
    for number, force_n in enumerate(forces):
        extension_mm = 0.0 if extensions is None else extensions[number]
        motion = MotionState.STOPPED if extensions is None else MotionState.MOVING
        to_n = forces[0] if target_n is None else target_n
        sample = LoadSample(number, T0 + round(number * every_s * S), 0, force_n, extension_mm, motion, to_n)
        watch, problem = watch.with_sample(WATCHED, sample)
        printed += [] if problem is None else [problem]
    return printed


@pytest.mark.parametrize("every_s", [0.05, 1.0])
def test_a_sudden_fall_of_the_load_is_reported_once(every_s: float) -> None:
    (printed,) = problems([500.0] * 20 + [430.0] * 20, every_s=every_s)
    assert "the load fell by 70 N to 430 N within" in printed
    assert problems([500.0] * 20 + [460.0] * 20, every_s=every_s) == []
    assert len(problems([-500.0] * 20 + [0.0] * 20, every_s=every_s)) == 1


def test_a_fall_in_steps_within_half_a_second_is_a_fall() -> None:
    assert len(problems([500.0] * 20 + [490.0, 480.0, 470.0, 460.0, 449.0])) == 1
    assert problems([500.0 - 2.0 * n for n in range(200)]) == []


def test_a_load_that_is_taken_off_on_purpose_is_no_fall() -> None:
    down = [500.0 - 100.0 * n for n in range(5)]
    assert problems(down, every_s=1.0, target_n=0.0) == []
    assert len(problems(down, every_s=1.0, target_n=500.0)) == 4


def test_a_runaway_load_is_reported() -> None:
    assert "the load changes by +400 N/s, more than the limit of 250 N/s" in problems([0.0] * 10 + [400.0], every_s=1.0)[0]
    # Half a second apart at least: noise of some newtons from one reading to the next is no slope.
    assert problems([100.0, 112.0] * 40) == []


def test_a_crosshead_that_moves_without_load_is_reported() -> None:
    ran = [0.002 * n for n in range(60)]
    (printed,) = problems([3.0] * 60, extensions=ran)
    assert "the crosshead ran 0.102 mm while the load stayed at 3 N" in printed
    assert problems([2.0 * n for n in range(60)], extensions=ran) == []


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    every_s=st.floats(0.02, 1.5),
    noise=st.lists(st.floats(-8.0, 8.0), min_size=60, max_size=60),
    rate=st.floats(1.0, 100.0),
    targets=st.lists(st.floats(-40.0, 2000.0), min_size=1, max_size=3),
)
def test_ramps_that_follow_their_order_are_never_reported(every_s: float, noise: list[float], rate: float, targets: list[float]) -> None:
    watch, force_n = INITIAL, 0.0
    for number, wobble in enumerate(noise):
        target_n = targets[number * len(targets) // len(noise)]
        force_n += max(-rate * every_s, min(rate * every_s, target_n - force_n))
        sample = LoadSample(number, T0 + round(number * every_s * S), 0, force_n + wobble, force_n / 5000, MotionState.MOVING, target_n)
        watch, problem = watch.with_sample(replace(WATCHED, slack_max_mm=0.4), sample)
        assert problem is None


@pytest.mark.parametrize("state", [State.RAMPING, State.HOLDING, State.IMAGING])
def test_the_engine_stops_and_holds_after_a_fall(state: State) -> None:
    run = Run(replace(plan_of((HERE, 200.0)), limits=WATCHED))
    run.begin()
    run.reach(state)
    run.wait(2.0)
    run.force_n -= 100.0
    commands = len(run.commands)
    run.wait(0.5)
    given = run.commands[commands:]
    assert isinstance(given[0], StopMotion)
    assert run.state.state is State.FAULT
    assert "the load fell by" in run.state.message
    run.wait(100.0)
    assert [item for item in run.commands[commands:] if isinstance(item, RampTo)] == []


@pytest.mark.parametrize("trouble", list(DeviceFault))
@pytest.mark.parametrize("state", [State.CONNECTING, State.READY, State.RAMPING, State.SETTLING, State.HOLDING, State.IMAGING])
def test_an_emergency_stop_or_a_limit_switch_is_an_emergency_anywhere(state: State, trouble: DeviceFault) -> None:
    run = Run(plan_of((HERE, 200.0)))
    if state is State.CONNECTING:
        run.send(LinksOpening(run.now_ns))
    elif state is State.READY:
        run.send(LinksOpening(run.now_ns))
        run.readings()
        run.send(LinksReady(run.now_ns, IDENTITY, IDENTITY))
    else:
        run.begin()
        run.reach(state)
    given = run.send(LoadReading(run.now_ns, replace(run.load_sample(), motion=MotionState.FAULT, trouble=trouble)))
    assert isinstance(given[0], StopMotion)
    assert run.state.state is (State.EMERGENCY_STOP if trouble.is_emergency else State.FAULT)
    assert str(trouble) in run.state.message


def test_an_emergency_that_lasts_does_not_keep_a_run_from_ending() -> None:
    run = Run(plan_of((HERE, 200.0)))
    run.begin()
    run.reach(State.RAMPING)

    def pressed() -> LoadReading:
        run.now_ns += 10**8
        return LoadReading(run.now_ns, replace(run.load_sample(), motion=MotionState.FAULT, trouble=DeviceFault.LIMIT_SWITCH))

    run.send(pressed())
    assert run.state.state is State.EMERGENCY_STOP
    run.send(OperatorAction(run.now_ns, OperatorCommand.STOP))
    for _ in range(3):
        run.send(pressed())
        assert run.state.state is not State.EMERGENCY_STOP


def test_from_an_emergency_while_connecting_the_operator_leads_back() -> None:
    run = Run(plan_of((HERE, 200.0)))
    run.send(LinksOpening(run.now_ns))
    run.send(LoadReading(run.now_ns, replace(run.load_sample(), motion=MotionState.FAULT, trouble=DeviceFault.EMERGENCY_STOP)))
    run.send(LinksReady(run.now_ns, IDENTITY, IDENTITY))
    assert run.state.state is State.EMERGENCY_STOP
    run.wait(1.0)
    for _ in range(2):
        run.send(OperatorAction(run.now_ns, OperatorCommand.RESUME))
    run.reach(State.IMAGING)
    assert run.force_n == 200.0


def test_a_stop_waits_as_long_as_is_configured_and_reports_for_whom() -> None:
    run = Run(replace(plan_of((HERE, 200.0)), limits=replace(LIMITS, stop_timeout_s=6.0)))
    run.begin()
    run.send(OperatorAction(run.now_ns, OperatorCommand.STOP))
    run.has_load = False
    run.wait(4.0)
    assert run.state.state is State.STOPPING
    reported = [item.text for item in run.of(Notify) if item.text.startswith("waiting for")]
    assert reported == ["waiting for confirmation of the stop by the load frame, at most 6 s; abort ends without it"]
    run.wait(3.0)
    assert run.state.state is State.ABORTED
    assert "the load frame did not" in run.state.message


def test_limits_of_a_resumed_run_watch_from_its_first_reading() -> None:
    state = start(replace(plan_of((HERE, 200.0)), limits=WATCHED), T0)
    assert state.devices.supervisor == INITIAL
