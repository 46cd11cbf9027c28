"""A resumed run: what it asks the operator, which readings it accepts, and where the zero of the stage is."""

from __future__ import annotations

from dataclasses import replace

import pytest

from semlive.data.experiment import Recentre
from semlive.data.faults import FaultCode
from semlive.data.loading import LoadSample, MotionState, StageSample
from semlive.engine import (
    Device,
    DeviceStopped,
    FieldOfViewMeasured,
    FinishRun,
    InterruptedRun,
    LinksOpening,
    LinksReady,
    LoadReading,
    MoveStage,
    OperatorAction,
    OperatorCommand,
    RampTo,
    State,
    StopMotion,
    Transition,
    changed_since,
    start,
)
from semlive.errors import BadInput

from .bench_in_memory import IDENTITY, T0, Run, plan_of

HERE = (0.0, 0.0)
PLAN = plan_of((HERE, 100.0), ((6.0, 0.0), 200.0), (HERE, 400.0))


def interrupted(pairs: int, plan: object = PLAN, until: State = State.IMAGING) -> tuple[Run, InterruptedRun]:
    """A run in memory that died in a state after so many pairs, and the content of its log."""
    run = Run(plan)  # type: ignore[arg-type]
    run.begin()
    for _ in range(pairs):
        run.reach(State.IMAGING)
        run.scan()
        run.scan()
    if pairs < len(run.plan.steps):
        run.reach(until)
    done = tuple(item.decision for item in run.accepted)
    return run, InterruptedRun(
        done, (7.0, -3.0), run.state.devices.load, run.state.devices.position, None, 0.2, ramping=run.state.state is State.RAMPING
    )


def taken_up(run: Run, before: InterruptedRun) -> Run:
    """A new engine for the same machine, asked up to where it asks."""
    run.commands.clear()
    run.state = start(run.plan, run.now_ns, interrupted_run=before)
    run.send(LinksOpening(run.now_ns))
    run.readings()
    run.send(LinksReady(run.now_ns, IDENTITY if run.has_load else None, IDENTITY if run.has_stage else None))
    return run


@pytest.mark.parametrize("pairs", [0, 1, 2])
@pytest.mark.parametrize("state", [State.RAMPING, State.SETTLING, State.HOLDING, State.IMAGING])
def test_it_asks_first_and_then_enters_the_step_again_in_full(pairs: int, state: State) -> None:
    run, before = interrupted(pairs, until=state)
    if state is State.IMAGING:
        run.scan()
    assert before == replace(before, completed_pairs=tuple(item.decision for item in run.accepted))
    taken_up(run, before)
    run.wait(40.0)
    assert run.state.state is State.RESUMING
    assert run.of(MoveStage) == run.of(RampTo) == run.accepted == []
    assert changed_since(run.state) is None
    assert f"begins step {pairs + 1} again" in run.state.message
    run.send(OperatorAction(run.now_ns, OperatorCommand.RESUME))
    assert State.RAMPING in run.path
    for pair in range(pairs, len(PLAN.steps)):
        run.reach(State.IMAGING)
        x_um, y_um = PLAN.steps[pair].shift_um
        assert run.xy_um == (7.0 + x_um, -3.0 + y_um)
        run.scan()
        run.scan()
    assert run.state.state is State.COMPLETE
    assert [item.decision.pair for item in run.accepted] == list(range(pairs, len(PLAN.steps)))


def test_a_run_without_stage_needs_none() -> None:
    run = Run(plan_of((HERE, 100.0), (HERE, 200.0)), has_stage=False)
    run.begin()
    run.reach(State.HOLDING)
    taken_up(run, InterruptedRun((), None, run.state.devices.load, None))
    run.send(OperatorAction(run.now_ns, OperatorCommand.RESUME))
    run.reach(State.IMAGING)
    assert run.force_n == 100.0


def test_after_the_last_pair_no_device_is_queried() -> None:
    run, before = interrupted(3)
    taken_up(run, before)
    assert run.state.state is State.COMPLETE
    assert [type(item) for item in run.commands if isinstance(item, MoveStage | RampTo | StopMotion)] == []
    assert len(run.of(FinishRun)) == 1


def test_a_changed_load_or_stage_position_is_reported() -> None:
    run, before = interrupted(1)
    run.force_n -= 30.0
    assert "the load is 170.0 N now, and was 200.0 N" in taken_up(run, before).state.message
    assert fault_of(run) is FaultCode.MOVED_AT_REST
    run.send(OperatorAction(run.now_ns, OperatorCommand.RESUME))
    assert run.state.state is State.RESUMING
    assert "look first: the load is 170.0 N now, and was 200.0 N" in run.state.message
    run, before = interrupted(1)
    run.xy_um = (60.0, -3.0)
    assert "the stage is at (60.0, -3.0) um now" in taken_up(run, before).state.message
    assert fault_of(run) is FaultCode.MOVED_AT_REST


def fault_of(run: Run) -> FaultCode | None:
    """The code of the fault that the resumed run is in before anything was ordered."""
    assert run.state.state is State.FAULT
    assert run.of(RampTo) == run.of(MoveStage) == []
    return run.of(Transition)[-1].code


@pytest.mark.parametrize(("change_mm", "unchanged"), [(0.005, True), (-0.04, False), (0.04, False)])
def test_an_extension_that_is_elsewhere_at_the_same_load_is_a_fault(change_mm: float, unchanged: bool) -> None:
    run, before = interrupted(1)
    run.crosshead_mm += change_mm
    taken_up(run, before)
    if unchanged:
        assert run.state.state is State.RESUMING
    else:
        assert fault_of(run) is FaultCode.MOVED_AT_REST
        assert "the extension is" in run.state.message


@pytest.mark.parametrize(("change_mm", "unchanged"), [(0.005, True), (0.5, True), (-0.04, False)])
def test_a_crosshead_that_was_on_its_way_may_be_further_on_it_and_not_behind(change_mm: float, unchanged: bool) -> None:
    run, before = interrupted(1, until=State.RAMPING)
    before = replace(before, load=LoadSample(0, T0, 0, 120.0, 0.024, MotionState.MOVING, 200.0), position=None)
    run.load_goal_n = None
    run.force_n, run.crosshead_mm = 160.0, 0.024 + change_mm
    assert (changed_since(taken_up(run, before).state) is None) is unchanged


@pytest.mark.parametrize(("cleared", "code"), [(False, FaultCode.FOREIGN_ORDER), (True, FaultCode.DEVICE_RESTARTED)])
def test_a_device_that_does_not_hold_the_last_order_is_a_fault_before_the_first_order(cleared: bool, code: FaultCode) -> None:
    run, before = interrupted(1)
    run.commands.clear()
    run.state = start(run.plan, run.now_ns, interrupted_run=before)
    run.send(LinksOpening(run.now_ns))
    run.send(LoadReading(run.now_ns, replace(run.load_sample(), order_changed="its target holds 0 N", orders_cleared=cleared)))
    assert fault_of(run) is code
    assert len(run.of(StopMotion)) == 1
    run.readings()
    run.send(OperatorAction(run.now_ns, OperatorCommand.RESUME))  # before it is known which devices the run has
    assert run.state.state is State.FAULT
    assert "cannot resume: the devices and the analysis are not ready yet" in run.state.message
    run.send(LinksReady(run.now_ns, IDENTITY, IDENTITY))
    assert run.state.state is State.FAULT
    run.send(OperatorAction(run.now_ns, OperatorCommand.RESUME))
    assert run.state.state is State.RESUMING
    run.send(OperatorAction(run.now_ns, OperatorCommand.RESUME))
    assert State.RAMPING in run.path


def test_a_new_run_has_no_order_to_compare() -> None:
    run = Run(PLAN)
    run.send(LinksOpening(run.now_ns))
    run.send(LoadReading(run.now_ns, replace(run.load_sample(), order_changed="its target holds 0 N")))
    assert run.state.state is State.CONNECTING


@pytest.mark.parametrize(("device", "unchanged"), [(Device.LOAD_FRAME, False), (Device.STAGE, True)])
def test_a_load_frame_that_was_found_moving_does_not_match_the_log(device: Device, unchanged: bool) -> None:
    run, before = interrupted(1, until=State.RAMPING)
    run.commands.clear()
    run.load_goal_n = None
    run.state = start(run.plan, run.now_ns, interrupted_run=before)
    run.send(LinksOpening(run.now_ns))
    run.readings()
    run.send(DeviceStopped(run.now_ns, device, "it moved before it was commanded"))
    assert run.state.state is State.CONNECTING
    run.send(LinksReady(run.now_ns, IDENTITY, IDENTITY))
    assert run.state.state is State.RESUMING
    assert (changed_since(run.state) is None) is unchanged
    assert ("look first: the load frame was still moving" in run.state.message) is not unchanged


def test_a_new_run_does_not_begin_on_a_machine_that_was_found_moving() -> None:
    run = Run(PLAN)
    run.send(LinksOpening(run.now_ns))
    run.readings()
    run.send(DeviceStopped(run.now_ns, Device.LOAD_FRAME, "it moved before it was commanded"))
    run.send(LinksReady(run.now_ns, IDENTITY, IDENTITY))
    run.send(OperatorAction(run.now_ns, OperatorCommand.START))
    assert run.state.state is State.FAULT
    run.send(OperatorAction(run.now_ns, OperatorCommand.RESUME))
    run.send(OperatorAction(run.now_ns, OperatorCommand.RESUME))
    assert run.state.state is State.RAMPING


def test_a_load_that_was_on_its_way_may_be_anywhere_on_it() -> None:
    run, before = interrupted(1, until=State.RAMPING)
    before = replace(before, load=LoadSample(0, T0, 0, 120.0, 0.0, MotionState.MOVING, 200.0), position=None, ramping=False)
    run.load_goal_n = None
    for force_n, unchanged in ((120.0, True), (160.0, True), (205.0, True), (100.0, False), (220.0, False)):
        run.force_n = force_n
        assert (changed_since(taken_up(run, before).state) is None) is unchanged, force_n


def test_a_confirmed_difference_does_not_affect_a_later_fault() -> None:
    run, before = interrupted(1)
    run.force_n -= 30.0
    taken_up(run, before)
    run.send(OperatorAction(run.now_ns, OperatorCommand.RESUME))
    run.send(OperatorAction(run.now_ns, OperatorCommand.RESUME))
    assert State.RAMPING in run.path
    assert changed_since(run.state) is None


def test_a_watchdog_that_stopped_the_machine_is_acknowledged_once_and_a_fault_that_stays_is_one() -> None:
    run, before = interrupted(1)
    run.commands.clear()
    run.state = start(PLAN, run.now_ns, interrupted_run=before)
    run.send(LinksOpening(run.now_ns))
    for _ in range(3):
        sick = replace(run.load_sample(), motion=MotionState.FAULT)
        run.send(LoadReading(run.now_ns, sick))
    assert len(run.of(StopMotion)) == 1
    run.readings()
    run.send(LinksReady(run.now_ns, IDENTITY, IDENTITY))
    assert run.state.state is State.RESUMING
    run.send(LoadReading(run.now_ns + 1, replace(run.load_sample(), motion=MotionState.FAULT, time_ns=run.now_ns + 1)))
    assert run.state.state is State.FAULT


def test_the_field_is_recentred_from_its_position_in_the_last_pair() -> None:
    plan = replace(PLAN, recentring=Recentre(threshold_px=1.0, um_per_px=1.0))
    run, before = interrupted(1)
    done = replace(before.completed_pairs[0], step=replace(before.completed_pairs[0].step, shift_um=(2.0, 0.0)))
    run.plan = plan
    taken_up(run, replace(before, completed_pairs=(done,), field_of_view=FieldOfViewMeasured(T0, 0, (-5.0, 0.0))))
    run.send(OperatorAction(run.now_ns, OperatorCommand.RESUME))
    # The pair's own correction counts: 2 um then, and 5 px more are to be made good.
    assert run.of(MoveStage)[-1].x_um == pytest.approx(7.0 + 6.0 + 2.0 + 5.0)


def test_pairs_that_are_not_the_first_of_the_plan_are_refused() -> None:
    _, before = interrupted(2)
    with pytest.raises(BadInput, match=r"the log holds the pairs \[1\] of a plan of 3 steps"):
        start(PLAN, T0, interrupted_run=replace(before, completed_pairs=before.completed_pairs[1:]))
    with pytest.raises(BadInput, match="of a plan of 1 steps"):
        start(plan_of((HERE, 100.0)), T0, interrupted_run=before)


def test_a_stage_that_moved_when_the_run_died_is_where_it_happens_to_be() -> None:
    run, before = interrupted(1)
    moving = StageSample(0, T0, 0, 8.0, -3.0, MotionState.MOVING)
    run.xy_um = (90.0, -3.0)
    assert changed_since(taken_up(run, replace(before, position=moving)).state) is None
