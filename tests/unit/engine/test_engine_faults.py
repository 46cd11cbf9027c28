"""Doubtful pairs, limits, and the commands of the operator."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from semlive.data.experiment import HoldRule
from semlive.engine import (
    DeviceFault,
    DeviceStopped,
    FinishRun,
    LinkLost,
    LinkRestored,
    LinksOpening,
    LinksReady,
    LoadReading,
    MoveStage,
    Notify,
    OperatorAction,
    OperatorCommand,
    RampTo,
    State,
    StopMotion,
    start,
    step,
)
from semlive.engine.events import Device
from semlive.errors import BadInput

from .bench_in_memory import IDENTITY, LIMITS, T0, Run, plan_of

HERE = (0.0, 0.0)


def run_in(state: State, load_n: float = 200.0) -> Run:
    run = Run(plan_of((HERE, load_n), (HERE, load_n)))
    run.begin()
    run.reach(state)
    return run


STATES = [State.RAMPING, State.SETTLING, State.HOLDING, State.IMAGING]


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"force_n": 2301.0}, "the load is 2301.0 N, outside the limits -50 to 2300 N"),
        ({"extension_mm": 2.5}, "the extension is 2.5000 mm, outside the limits -0.5 to 2 mm"),
        ({"force_n": math.nan}, "the load is nan N, outside the limits -50 to 2300 N"),
    ],
)
def test_a_sample_beyond_a_limit_stops_first_and_then_is_a_fault(state: State, changes: dict[str, float], sentence: str) -> None:
    run = run_in(state)
    given = run.send(LoadReading(run.now_ns, replace(run.load_sample(), **changes)))
    assert given[0] == StopMotion(sentence)
    assert run.state.state is State.FAULT
    assert Notify(sentence) in given
    again = run.send(LoadReading(run.now_ns, replace(run.load_sample(), **changes)))
    assert again == ()


@pytest.mark.parametrize("state", STATES)
def test_a_lost_link_stops_everything(state: State) -> None:
    run = run_in(state)
    given = run.send(LinkLost(run.now_ns, Device.STAGE, "no answer"))
    assert given[0] == StopMotion("the link to the stage is lost: no answer")
    assert run.state.state is State.FAULT


@pytest.mark.parametrize("state", STATES)
def test_a_device_fault_stops_everything(state: State) -> None:
    run = run_in(state)
    run.send(DeviceFault(run.now_ns, Device.SEM, "the trigger was refused"))
    assert run.state.state is State.FAULT
    assert run.state.message == "SEM: the trigger was refused"


@pytest.mark.parametrize(("state", "after"), [*((s, State.FAULT) for s in STATES[:2]), *((s, s) for s in STATES[2:])])
def test_a_device_that_was_stopped_by_its_link_is_a_fault_only_on_the_way(state: State, after: State) -> None:
    run = run_in(state)
    run.send(DeviceStopped(run.now_ns, Device.LOAD_FRAME, "control sent no signal for 2.1 s"))
    assert run.state.state is after
    assert "control sent no signal" in run.state.message


def test_an_emergency_stop_has_a_state_of_its_own() -> None:
    run = run_in(State.HOLDING)
    run.send(DeviceFault(run.now_ns, Device.LOAD_FRAME, "emergency stop", emergency=True))
    assert run.state.state is State.EMERGENCY_STOP


def test_only_a_confirmed_command_of_the_operator_ends_a_fault() -> None:
    run = run_in(State.HOLDING)
    run.send(LinkLost(run.now_ns, Device.LOAD_FRAME, "no answer"))
    run.send(LinkRestored(run.now_ns, Device.LOAD_FRAME))
    run.wait(100.0)
    assert run.state.state is State.FAULT
    motions = len(run.of(RampTo)) + len(run.of(MoveStage))
    run.send(OperatorAction(run.now_ns, OperatorCommand.RESUME))
    assert run.state.state is State.RESUMING
    assert len(run.of(RampTo)) + len(run.of(MoveStage)) == motions
    assert "resume sets the stage to (0, 0) um and the load to 200 N" in run.state.message
    run.send(OperatorAction(run.now_ns, OperatorCommand.RESUME))
    assert run.of(RampTo)[-1] == RampTo(200.0, 50.0)
    run.reach(State.HOLDING)
    run.wait(29.0)
    assert run.state.state is State.HOLDING
    run.reach(State.IMAGING, 2.0)


def test_no_resume_without_a_fresh_reading() -> None:
    run = run_in(State.HOLDING)
    run.send(LinkLost(run.now_ns, Device.LOAD_FRAME, "no answer"))
    run.send(OperatorAction(run.now_ns, OperatorCommand.RESUME))
    assert run.state.state is State.FAULT
    assert run.state.message == "cannot resume: the load frame gives no fresh reading"


def test_no_resume_beyond_a_limit() -> None:
    run = run_in(State.HOLDING)
    run.force_n = 2400.0
    run.wait(1.0)
    run.send(OperatorAction(run.now_ns, OperatorCommand.RESUME))
    assert run.state.message == "cannot resume: the load is 2400.0 N, outside the limits -50 to 2300 N"


@pytest.mark.parametrize("state", STATES)
def test_pause_stops_and_resume_does_the_step_again_with_its_full_hold(state: State) -> None:
    run = run_in(state)
    given = run.send(OperatorAction(run.now_ns, OperatorCommand.PAUSE))
    assert isinstance(given[0], StopMotion)
    assert run.state.state is State.PAUSED
    run.wait(1000.0)
    assert run.state.state is State.PAUSED
    ramps = len(run.of(RampTo))
    run.send(OperatorAction(run.now_ns, OperatorCommand.RESUME))
    assert len(run.of(RampTo)) == ramps + 1
    run.reach(State.HOLDING)
    run.wait(29.5)
    assert run.state.state is State.HOLDING
    run.reach(State.IMAGING, 1.0)


@pytest.mark.parametrize("state", STATES)
def test_stop_waits_for_the_devices_reply(state: State) -> None:
    run = run_in(state)
    run.send(OperatorAction(run.now_ns, OperatorCommand.STOP))
    assert run.state.state is State.STOPPING
    run.reach(State.ABORTED, 2.0)
    assert run.of(FinishRun) == [FinishRun(State.ABORTED, "the run was stopped; load and position are held")]


def test_a_stop_that_is_never_confirmed_reports_so() -> None:
    run = run_in(State.RAMPING)
    run.send(OperatorAction(run.now_ns, OperatorCommand.STOP))
    run.has_load = run.has_stage = False
    run.wait(62.0)
    assert run.state.state is State.ABORTED
    assert "not every device confirmed" in run.of(FinishRun)[0].text


@pytest.mark.parametrize("state", STATES)
def test_abort_ends_at_once(state: State) -> None:
    run = run_in(state)
    given = run.send(OperatorAction(run.now_ns, OperatorCommand.ABORT))
    assert isinstance(given[0], StopMotion)
    assert isinstance(given[-1], FinishRun)
    assert run.state.state is State.ABORTED
    assert run.send(OperatorAction(run.now_ns, OperatorCommand.START)) == ()


def test_an_operator_command_that_is_not_allowed_gets_an_answer() -> None:
    run = run_in(State.HOLDING)
    assert run.send(OperatorAction(run.now_ns, OperatorCommand.RESUME)) == (Notify("cannot resume while holding"),)


def test_a_plan_beyond_its_limits_does_not_start() -> None:
    for stop, words in (
        ((HERE, 2400.0), "a load of 2400 N is outside the limits"),
        (((101.0, 0.0), None), "beyond the limit of 100 um"),
    ):
        with pytest.raises(BadInput, match=words):
            start(plan_of(stop), T0)
    with pytest.raises(BadInput, match=r"a change of load from .* to 501 N"):
        start(plan_of((HERE, 0.0), (HERE, 501.0)), T0)
    with pytest.raises(BadInput, match="a ramp of 500 N/s"):
        start(replace(plan_of((HERE, 0.0)), ramp_rate_n_s=500.0), T0)
    with pytest.raises(BadInput, match="none of index 1"):
        start(plan_of((HERE, 0.0)), T0, next_step=1)


def test_the_first_change_of_load_is_measured_from_where_the_load_is() -> None:
    run = Run(plan_of((HERE, 600.0)))
    run.begin()
    assert run.state.state is State.FAULT
    assert run.of(RampTo) == []
    assert "a change of load from 0.0 to 600 N is more than the limit of 500 N" in run.state.message


def test_the_devices_own_limit_wins_where_it_is_tighter() -> None:
    run = Run(plan_of((HERE, 200.0), (HERE, 400.0)))
    run.send(LinksOpening(run.now_ns))
    run.send(LinksReady(run.now_ns, replace(IDENTITY, force_max_n=300.0), None))
    assert run.state.state is State.FAULT
    assert "the plan breaks the load frame's own limit in step 2" in run.state.message
    assert run.state.limits == replace(LIMITS, force_max_n=300.0)


def test_a_continued_run_asks_before_anything_moves() -> None:
    plan = plan_of((HERE, 200.0), (HERE, 400.0))
    run = Run(plan, force_n=200.0)
    run.state = start(plan, T0, next_step=1)
    run.send(LinksOpening(T0))
    run.readings()
    run.send(LinksReady(T0, IDENTITY, IDENTITY))
    assert run.state.state is State.RESUMING
    run.wait(50.0)
    assert run.of(RampTo) == run.of(MoveStage) == []
    run.send(OperatorAction(run.now_ns, OperatorCommand.RESUME))
    run.reach(State.IMAGING)
    run.scan()
    run.scan()
    assert [a.decision.pair for a in run.accepted] == [1]


def test_stepping_changes_nothing_in_the_state_it_was_given() -> None:
    state = start(plan_of((HERE, 0.0)), T0)
    step(state, LinksOpening(T0))
    assert state.state is State.IDLE
    assert HoldRule().hold_s == 30.0
