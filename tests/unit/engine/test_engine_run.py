"""Complete runs through the engine: order of actions, holds, frames."""

from __future__ import annotations

from dataclasses import replace

import pytest

from semlive.data.loading import MotionState, StageSample
from semlive.engine import (
    CommandAcknowledged,
    Device,
    FinishRun,
    FrameScanned,
    FrameUnreadable,
    MoveStage,
    Notify,
    RampTo,
    StageReading,
    State,
    TriggerFrame,
    progress,
)

from .bench_in_memory import HOLD, T0, Run, S, frame, plan_of

HERE = (0.0, 0.0)


def test_a_run_goes_step_by_step_to_complete() -> None:
    run = Run(plan_of((HERE, 0.0), ((10.0, 0.0), 0.0), (HERE, 400.0)))
    run.begin()
    for _ in range(3):
        run.reach(State.IMAGING)
        run.scan()
        run.scan()
    assert run.state.state is State.COMPLETE
    assert [a.decision.pair for a in run.accepted] == [0, 1, 2]
    assert run.refusals == []
    assert run.of(RampTo) == [RampTo(0.0, 50.0), RampTo(400.0, 50.0)]
    assert run.of(MoveStage) == [MoveStage(17.0, -3.0), MoveStage(7.0, -3.0)]
    assert run.of(FinishRun) == [FinishRun(State.COMPLETE, "all 3 steps are done; load and position are held")]
    assert run.force_n == 400.0


def test_the_stage_moves_before_the_load_and_never_next_to_it() -> None:
    run = Run(plan_of((HERE, 0.0), ((10.0, 5.0), 400.0)))
    run.begin()
    run.reach(State.IMAGING)
    run.scan()
    done = len(run.commands)
    run.send(_second_frame(run))
    motions = [c for c in run.commands[done:] if isinstance(c, MoveStage | RampTo)]
    assert motions == [MoveStage(17.0, 2.0)]
    run.stage_goal_um = None
    run.send(StageReading(run.now_ns, StageSample(0, run.now_ns, 0, 12.0, 2.0, MotionState.MOVING)))
    assert run.of(RampTo) == [RampTo(0.0, 50.0)]
    # A reading of the instant of the acknowledgement may be from before the motion: it does not show an arrival.
    run.send(StageReading(run.now_ns, StageSample(0, run.now_ns, 0, 17.0, 2.0, MotionState.STOPPED)))
    assert run.of(RampTo) == [RampTo(0.0, 50.0)]
    run.now_ns += 1
    run.send(StageReading(run.now_ns, StageSample(0, run.now_ns, 0, 17.0, 2.0, MotionState.STOPPED)))
    assert run.of(RampTo)[-1] == RampTo(400.0, 50.0)


def _second_frame(run: Run) -> FrameScanned:
    info = frame(77, run.now_ns)
    run.wait(92.0)
    return FrameScanned(run.now_ns, info)


def test_the_hold_is_exactly_thirty_seconds_from_settled() -> None:
    run = Run(plan_of((HERE, 200.0)), poll_s=0.1)
    run.begin()
    run.reach(State.HOLDING)
    settled_ns = run.now_ns
    assert progress(run.state).hold_remaining_s == pytest.approx(30.0)
    run.reach(State.IMAGING)
    assert run.now_ns - settled_ns == pytest.approx(30 * S, abs=0.1 * S)
    assert run.state.hold.end_ns == settled_ns + 30 * S
    assert progress(run.state).hold_remaining_s is None


def test_a_load_out_of_tolerance_restarts_settling_and_hold() -> None:
    run = Run(plan_of((HERE, 200.0)))
    run.begin()
    run.reach(State.HOLDING)
    run.wait(20.0)
    run.force_n = 189.0
    run.wait(0.5)
    assert run.state.state is State.SETTLING
    run.force_n = 199.0
    run.reach(State.HOLDING, 6.0)
    again_ns = run.now_ns
    run.reach(State.IMAGING)
    assert run.now_ns - again_ns == 30 * S


def test_a_load_that_relaxed_out_of_tolerance_is_approached_again_three_times_then_it_is_a_fault() -> None:
    run = Run(plan_of((HERE, 200.0)))
    run.begin()
    for _ in range(3):
        run.reach(State.SETTLING)
        run.force_n = 180.0
        run.reach(State.RAMPING, 12.0)
    assert len(run.of(RampTo)) == 4
    run.reach(State.SETTLING)
    run.force_n = 180.0
    run.reach(State.FAULT, 12.0)
    assert "not reached after 3 approaches" in run.state.message


def test_a_device_that_never_takes_the_command_times_out() -> None:
    run = Run(plan_of((HERE, 200.0)), unresponsive=True)
    run.begin()
    run.wait(299.0)
    assert run.state.state is State.RAMPING
    run.reach(State.FAULT, 10.0)
    assert run.state.message == "step 1 has not settled for 300 s"


def test_a_run_without_load_frame_and_stage_only_takes_pairs() -> None:
    run = Run(plan_of((HERE, None), (HERE, None)), has_load=False, has_stage=False)
    run.begin()
    for _ in range(2):
        run.reach(State.IMAGING)
        run.scan()
        run.scan()
    assert run.state.state is State.COMPLETE
    assert [a.decision.loads for a in run.accepted] == [None, None]
    assert run.of(RampTo) == run.of(MoveStage) == []


def test_a_step_without_load_orders_no_load_but_requires_a_steady_one() -> None:
    run = Run(plan_of((HERE, None)), force_n=123.0)
    run.begin()
    run.reach(State.HOLDING)
    run.reach(State.IMAGING)
    run.scan()
    run.scan()
    assert run.of(RampTo) == []
    loads = run.accepted[0].decision.loads
    assert loads is not None
    assert loads[0].mean_n == 123.0


def test_a_shift_needs_a_stage_and_a_load_a_load_frame() -> None:
    run = Run(plan_of(((10.0, 0.0), None)), has_stage=False)
    run.begin()
    assert run.state.state is State.FAULT
    assert run.state.message == "step 1 needs the stage, but the run has none"


def test_loads_of_a_pair_are_those_during_its_scans() -> None:
    run = Run(plan_of((HERE, 400.0)), poll_s=0.1)
    run.begin()
    run.reach(State.IMAGING)
    run.scan()
    run.force_n = 398.0
    run.scan()
    loads = run.accepted[0].decision.loads
    assert loads is not None
    first, second = loads
    assert (first.before_n, first.after_n, first.mean_n, first.sd_n) == pytest.approx((400.0, 400.0, 400.0, 0.0))
    assert second.mean_n == pytest.approx(398.0, abs=0.01)


def test_a_triggered_run_asks_for_each_frame() -> None:
    run = Run(plan_of((HERE, None), triggered=True))
    run.begin()
    run.reach(State.IMAGING)
    assert run.of(TriggerFrame) == []
    run.wait(1.0)
    assert len(run.of(TriggerFrame)) == 1
    run.send(FrameUnreadable(run.now_ns, 5, "frame0005.tif is cut off"))
    assert len(run.of(TriggerFrame)) == 2
    assert run.refusals == ["frame0005.tif is cut off"]
    run.scan()
    assert len(run.of(TriggerFrame)) == 3
    run.scan()
    assert len(run.of(TriggerFrame)) == 3
    assert run.state.state is State.COMPLETE


def test_a_sem_that_does_not_export_is_a_fault_after_a_while() -> None:
    run = Run(plan_of((HERE, None), hold=replace(HOLD, frame_timeout_s=100.0)))
    run.begin()
    run.reach(State.IMAGING)
    run.wait(99.0)
    run.reach(State.FAULT, 3.0)
    assert "is the SEM scanning" in run.state.message


def test_the_operator_reads_what_a_step_is() -> None:
    run = Run(plan_of(((10.0, 0.0), 200.0)))
    run.begin()
    assert Notify("step 1 of 1: tension, shift (10, 0) um, 200 N") in run.commands
    assert run.state.step_index == 0
    assert run.now_ns == T0


def test_a_load_counts_as_reached_only_after_its_own_command_was_taken() -> None:
    run = Run(plan_of(((10.0, 0.0), 5.0)))
    run.begin()
    run.unresponsive = True
    run.wait(1.0)
    assert run.of(RampTo) == [RampTo(5.0, 50.0)]
    run.wait(20.0)
    assert run.state.state is State.RAMPING
    run.send(CommandAcknowledged(run.now_ns, Device.LOAD_FRAME))
    run.wait(0.5)
    assert run.state.state is State.SETTLING


def test_a_stage_that_creeps_away_while_settling_is_sent_again() -> None:
    run = Run(plan_of(((10.0, 0.0), 200.0)))
    run.begin()
    run.reach(State.SETTLING)
    run.xy_um = (27.0, -3.0)
    run.reach(State.RAMPING, 12.0)
    assert run.of(MoveStage) == [MoveStage(17.0, -3.0)] * 2
    assert run.of(RampTo) == [RampTo(200.0, 50.0)]
    run.reach(State.IMAGING)
