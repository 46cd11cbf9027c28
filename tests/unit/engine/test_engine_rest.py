"""What changes while nothing is ordered is a fault with a name; semlive unloads only by plan, and takes unloaded pairs without load."""

from __future__ import annotations

from dataclasses import replace

import pytest

from semlive.data.experiment import Phase
from semlive.data.faults import FaultCode
from semlive.data.loading import LoadSample, MotionState
from semlive.engine import CommandAcknowledged, Device, LoadReading, OperatorAction, OperatorCommand, RampTo, State, StopMotion, Transition

from .bench_in_memory import LIMITS, Run, S, plan_of

HERE = (0.0, 0.0)


class FrameByHand(Run):
    """A run whose load frame is also moved by somebody else."""

    moving = False
    order_changed: str | None = None

    def load_sample(self) -> LoadSample:
        sample = super().load_sample()
        motion = MotionState.MOVING if self.moving else sample.motion
        return replace(sample, motion=motion, order_changed=self.order_changed)


def held(*loads_n: float) -> FrameByHand:
    """In the hold of the last of some loads."""
    run = FrameByHand(plan_of(*((HERE, load) for load in loads_n), (HERE, None)))
    run.begin()
    for number in range(len(loads_n)):
        run.reach(State.HOLDING)
        if number + 1 < len(loads_n):
            run.reach(State.IMAGING)
            run.scan()
            run.scan()
    run.wait(3.0)
    return run


def codes(run: Run) -> list[FaultCode]:
    return [item.code for item in run.of(Transition) if item.code is not None]


def test_a_load_that_somebody_raised_in_the_hold_is_a_fault_and_is_not_driven_back() -> None:
    run = held(300.0)
    ramps = len(run.of(RampTo))
    run.force_n = 395.0
    run.wait(1.0)
    assert run.state.state is State.FAULT
    assert codes(run) == [FaultCode.MOVED_AT_REST]
    assert run.of(StopMotion)
    for _ in range(2):
        run.send(OperatorAction(run.now_ns, OperatorCommand.RESUME))
    assert len(run.of(RampTo)) == ramps
    assert "the plan does not unload here" in run.state.message


def test_a_load_that_somebody_lowered_by_the_crosshead_is_a_fault() -> None:
    run = held(300.0)
    run.force_n, run.crosshead_mm = 250.0, 250.0 / 5000
    run.wait(1.0)
    assert codes(run) == [FaultCode.MOVED_AT_REST]


def test_a_load_that_relaxes_at_a_resting_crosshead_is_approached_again() -> None:
    run = held(300.0)
    run.force_n = 285.0
    run.wait(1.0)
    assert run.state.state is State.SETTLING
    run.reach(State.HOLDING)
    assert run.force_n == 300.0
    assert codes(run) == []


@pytest.mark.parametrize("loads_n", [(300.0,), (100.0, 300.0)])
def test_a_constant_force_while_the_crosshead_moves_is_a_fault(loads_n: tuple[float, ...]) -> None:
    run = held(*loads_n)
    run.crosshead_mm = 395.0 / 5000
    run.wait(2.0)
    assert codes(run) == [FaultCode.FROZEN_READING]


@pytest.mark.parametrize("force_n", [300.0, 301.0])
def test_motion_that_nobody_ordered_is_a_fault(force_n: float) -> None:
    run = held(300.0)
    run.moving, run.force_n = True, force_n
    run.wait(6.0)
    assert codes(run) == [FaultCode.UNORDERED_MOTION]


def test_a_device_that_corrects_itself_for_a_moment_only_begins_the_hold_again() -> None:
    run = held(300.0)
    run.moving = True
    run.wait(1.0)
    run.moving = False
    run.reach(State.HOLDING)
    assert codes(run) == []


def test_an_order_that_is_not_ours_is_a_fault() -> None:
    run = held(300.0)
    run.order_changed = "its target register holds 20 N, 300 N was written"
    run.wait(1.0)
    assert codes(run) == [FaultCode.FOREIGN_ORDER]
    assert "20 N" in run.state.message


def test_a_stage_that_moved_by_itself_is_a_fault() -> None:
    run = held(300.0)
    run.xy_um = (run.xy_um[0] + 8.0, run.xy_um[1])
    run.wait(1.0)
    assert codes(run) == [FaultCode.MOVED_AT_REST]


def test_an_overshoot_is_never_driven_back() -> None:
    run = FrameByHand(plan_of((HERE, 300.0)))
    run.begin()
    run.wait(1.0)
    run.force_n, run.load_goal_n = 380.0, None
    run.wait(20.0)
    assert run.state.state is State.FAULT
    assert codes(run) == [FaultCode.WOULD_UNLOAD]
    assert len(run.of(RampTo)) == 1


def test_a_plan_that_unloads_does_so() -> None:
    run = held(300.0, 100.0)
    assert run.force_n == 100.0
    assert codes(run) == []


def test_a_ramp_that_ended_far_from_its_target_is_a_fault() -> None:
    run = FrameByHand(plan_of((HERE, 300.0)))
    run.begin()
    run.wait(2.0)
    run.load_goal_n = None
    run.wait(20.0)
    assert codes(run) == [FaultCode.STOPPED_EARLY]


def test_a_ramp_that_the_reading_does_not_show_at_all_is_not_ordered_again() -> None:
    run = FrameByHand(plan_of((HERE, 20.0)))
    run.unresponsive = True
    run.begin()
    run.send(CommandAcknowledged(run.now_ns, Device.LOAD_FRAME))
    run.wait(20.0)
    assert codes(run) == [FaultCode.NO_RESPONSE]
    assert len(run.of(RampTo)) == 1


def test_a_calibration_under_load_is_refused_before_it_begins() -> None:
    plan = plan_of((HERE, None), (HERE, 300.0))
    calibration = replace(plan.steps[0], phase=Phase.CALIBRATION)
    run = FrameByHand(replace(plan, steps=(calibration, plan.steps[1])), force_n=350.0)
    run.begin()
    assert run.state.state is State.FAULT
    assert codes(run) == [FaultCode.LOADED_AT_START]
    run.force_n = 5.0
    run.wait(1.0)
    for _ in range(2):
        run.send(OperatorAction(run.now_ns, OperatorCommand.RESUME))
    run.reach(State.HOLDING)


def test_an_intended_preload_is_reported_in_the_limits() -> None:
    plan = plan_of((HERE, None))
    step = replace(plan.steps[0], phase=Phase.CALIBRATION)
    run = FrameByHand(replace(plan, steps=(step,), limits=replace(LIMITS, unloaded_max_n=360.0)), force_n=350.0)
    run.begin()
    run.reach(State.HOLDING)


def test_a_device_that_moves_on_after_the_stop_is_waited_for() -> None:
    run = held(300.0)
    run.send(OperatorAction(run.now_ns, OperatorCommand.STOP))
    run.moving = True
    run.wait(60.0)
    assert run.state.state is State.STOPPING
    assert "press its emergency stop" in run.state.message
    run.moving = False
    run.send(LoadReading(run.now_ns + S, replace(run.load_sample(), time_ns=run.now_ns + S)))
    assert run.state.state is State.ABORTED
