"""Getting to a step's load and position, and resting there.

Motion commands are given in one place, `_order`, which refuses to work in any state but RAMPING.
"""

from __future__ import annotations

import math
from dataclasses import replace

from semlive.data.faults import FaultCode
from semlive.data.loading import ControlMode, MotionState
from semlive.engine.adaptive_hold import hold_extension_reason
from semlive.engine.commands import MoveStage, RampTo
from semlive.engine.events import Device
from semlive.engine.limits import move_problem, ramp_problem
from semlive.engine.recentring import recentre
from semlive.engine.state import EngineState, MotionProgress, StepContext
from semlive.engine.states import Cause, State
from semlive.engine.supervision.unloading import loaded_problem, ramp_sign, unloading_problem

MAX_APPROACHES = 3
"""How often a target is approached again in one step: relaxation needs one or two, a slipping grip never ends."""


_UNMOVED_FRACTION = 0.1
"""A motion that ended with less than this part of its way seen in the load reading was not seen at all."""
_EARLY_FRACTION = 0.25
"""A motion that ended by itself with more than this part of its way left was ended by somebody else, or the device was restarted."""


def _stage_target_um(state: EngineState) -> tuple[float, float]:
    """Where the stage has to be, in its own coordinates."""
    x0, y0 = state.origin_um or (0.0, 0.0)
    dx, dy = state.step.shift_um
    return x0 + dx, y0 + dy


def _load_target_n(state: EngineState) -> float | None:
    """The load to be kept: the step's, or what it was when settling began."""
    return state.hold_load_n if state.step.load_n is None else state.step.load_n


def load_error_n(state: EngineState) -> float:
    """Distance of the load from its target, N; 0 without a load frame, NaN before the first sample."""
    target = _load_target_n(state)
    if state.load_frame is None:
        return 0.0
    if state.load is None or target is None:
        return math.nan
    return state.load.force_n - target


def stage_error_um(state: EngineState) -> float:
    """Distance of the stage from its target along the worse axis, um; 0 without a stage, NaN before the first sample."""
    if state.stage is None:
        return 0.0
    if state.position is None:
        return math.nan
    x, y = _stage_target_um(state)
    dx_um, dy_um = state.position.x_um - x, state.position.y_um - y
    return math.nan if math.isnan(dx_um + dy_um) else max(abs(dx_um), abs(dy_um))


def _load_within(state: EngineState) -> bool:
    """Whether the load is within tolerance of its target; False for NaN."""
    return abs(load_error_n(state)) <= state.plan.hold.load_tolerance(_load_target_n(state) or 0.0)


def _stage_within(state: EngineState) -> bool:
    """Whether the stage is within tolerance of its target; False for NaN."""
    return stage_error_um(state) <= state.plan.hold.stage_tolerance_um


def _at_rest(state: EngineState) -> bool:
    """Whether every device says that it does not move."""
    return all(sample is not None and sample.motion is MotionState.STOPPED for sample in map(state.sample, state.devices))


def not_at_rest_reason(state: EngineState) -> str | None:
    """Why this is no rest, as words that follow "because", or None."""
    for device in state.devices:
        sample = state.sample(device)
        if sample is None or sample.motion is not MotionState.STOPPED:
            return f"the {device.words} moves"
    if not _stage_within(state):
        return f"the stage is {stage_error_um(state):.1f} um from its target"
    if not _load_within(state):
        return f"the load is {load_error_n(state):+.1f} N from its target"
    return None


def start_motion(turn: StepContext) -> None:
    """Begin a step's motion: check it against the limits, then order the first device to move."""
    state = turn.state
    step, plan = state.step, state.plan
    todo: list[Device] = []
    if step.shift_um != state.reached_shift_um or not _stage_within(state):
        todo.append(Device.STAGE)
    if step.load_n is not None and (step.load_n != state.reached_load_n or not _load_within(state)):
        todo.append(Device.LOAD_FRAME)
    missing = [d for d in todo if d not in state.devices]
    if missing:
        turn.fault(Cause.LIMIT, f"step {step.number} needs the {missing[0].words}, but the run has none")
        return
    unloads = unloading_problem(state) if Device.LOAD_FRAME in todo else None
    if unloads is not None:
        turn.fault(Cause.LIMIT, unloads, ("load_error_n", load_error_n(state)), code=FaultCode.WOULD_UNLOAD)
        return
    problem = move_problem(state.limits, step.shift_um)
    if problem is None and step.load_n is not None and state.load is not None:
        known = state.reached_load_n
        from_n = state.load.force_n if known is None else known
        slack_n = plan.hold.load_tolerance(from_n) if known is None else 0.0
        problem = ramp_problem(state.limits, step.load_n, plan.ramp_rate_n_s, from_n, slack_n)
    if problem is not None:
        turn.fault(Cause.LIMIT, f"step {step.number} is not commanded: {problem}")
        return
    turn.update(
        motion=replace(state.motion, pending_devices=tuple(todo), acknowledged_ns=None, out_of_tolerance_since_ns=None), hold_load_n=None
    )
    _order(turn)


def start_step(turn: StepContext) -> None:
    """Begin a step with its own time allowance."""
    plan = recentre(turn.state.plan, turn.state.limits, turn.state.step_index, turn.state.field_of_view)
    turn.update(plan=plan, motion=MotionProgress(began_ns=turn.state.time_ns), hold_end_ns=turn.state.time_ns, in_tolerance_since_ns=None)
    step = turn.state.step
    load = "load as it is" if step.load_n is None else f"{step.load_n:g} N"
    x, y = step.shift_um
    loaded = loaded_problem(turn.state)
    if loaded is not None:
        turn.fault(Cause.LIMIT, loaded, code=FaultCode.LOADED_AT_START)
        return
    turn.announce(f"step {step.number} of {len(turn.state.plan.steps)}: {step.phase}, shift ({x:g}, {y:g}) um, {load}")
    start_motion(turn)


def _order(turn: StepContext) -> None:
    """Order the next device to move, or arrive if none is left."""
    state = turn.state
    if state.state is not State.RAMPING:
        raise RuntimeError(f"a motion was to be ordered in state {state.state}")
    if not state.motion.pending_devices:
        turn.transition(Cause.ARRIVED, ("load_error_n", load_error_n(state)), ("stage_error_um", stage_error_um(state)))
        return
    if state.motion.pending_devices[0] is Device.STAGE:
        turn.update(reached_shift_um=None)
        turn.commands.append(MoveStage(*_stage_target_um(state)))
    elif state.step.load_n is not None:
        from_n = None if state.load is None else state.load.force_n
        turn.update(reached_load_n=None, motion=replace(state.motion, from_n=from_n))
        tolerance_n = state.plan.hold.load_tolerance(state.step.load_n)
        turn.commands.append(RampTo(state.step.load_n, state.plan.ramp_rate_n_s, tolerance_n))


def continue_motion(turn: StepContext) -> None:
    """In RAMPING: go on when the device under way has taken its command, and says that it rests, in tolerance."""
    state = turn.state
    motion = state.motion
    if state.stale or not motion.pending_devices or motion.acknowledged_ns is None:
        return
    device = motion.pending_devices[0]
    sample = state.sample(device)
    if sample is None or sample.time_ns <= motion.acknowledged_ns or sample.motion is not MotionState.STOPPED:
        turn.update(motion=replace(motion, out_of_tolerance_since_ns=None))
        return
    step = state.step
    if not (_stage_within(state) if device is Device.STAGE else _load_within(state)):
        _astray(turn)
        return
    turn.update(motion=replace(motion, pending_devices=motion.pending_devices[1:], acknowledged_ns=None, out_of_tolerance_since_ns=None))
    if device is Device.STAGE:
        turn.update(reached_shift_um=step.shift_um)
        if turn.state.motion.pending_devices:
            turn.transition(Cause.STAGE_ARRIVED, ("stage_error_um", stage_error_um(turn.state)))
    else:
        turn.update(reached_load_n=step.load_n)
    _order(turn)


def _astray(turn: StepContext) -> None:
    """Everything rests, but out of tolerance: approach again after a while, a few times."""
    state = turn.state
    motion = state.motion
    if motion.out_of_tolerance_since_ns is None:
        turn.update(motion=replace(motion, out_of_tolerance_since_ns=state.time_ns))
        return
    if state.seconds_since(motion.out_of_tolerance_since_ns) < state.plan.hold.settle_s:
        return
    guards = (("load_error_n", load_error_n(state)), ("stage_error_um", stage_error_um(state)), ("approaches", motion.approaches))
    if state.state is State.RAMPING and _unmoved(state):
        what = f"the motion to step {state.step.number} has ended, but the load reading does not show it ({load_error_n(state):+.1f} N off)"
        turn.fault(Cause.NOT_REACHED, f"{what}: check the drive, the load cell and the grips", *guards, code=FaultCode.NO_RESPONSE)
        return
    early = _stopped_early(state)
    if early is not None:
        turn.fault(Cause.NOT_REACHED, early, *guards, code=FaultCode.STOPPED_EARLY)
        return
    if motion.approaches >= MAX_APPROACHES:
        reason = f"step {state.step.number} is not reached after {MAX_APPROACHES} approaches: {not_at_rest_reason(state)}"
        turn.fault(Cause.NOT_REACHED, reason, *guards)
        return
    turn.transition(Cause.APPROACH_AGAIN, *guards)
    turn.update(motion=replace(motion, approaches=motion.approaches + 1))
    start_motion(turn)


def _unmoved(state: EngineState) -> bool:
    """Whether the reading shows next to nothing of what was ordered: if it stands still, the same order again would go on unseen."""
    frame, load, target_n, from_n = state.load_frame, state.load, state.step.load_n, state.motion.from_n
    if frame is None or load is None or target_n is None or from_n is None or frame.control is ControlMode.MANUAL:
        return False
    return (load.force_n - from_n) * math.copysign(1.0, target_n - from_n) < _UNMOVED_FRACTION * abs(target_n - from_n)


def _stopped_early(state: EngineState) -> str | None:
    """Why the ramp that ended by itself was not ended by the device's own control, as a sentence, or None."""
    frame, load, target_n, from_n = state.load_frame, state.load, state.step.load_n, state.motion.from_n
    if frame is None or load is None or target_n is None or from_n is None or frame.control is ControlMode.MANUAL:
        return None
    left_n = math.copysign(1.0, target_n - from_n) * (target_n - load.force_n)
    tolerance_n = state.plan.hold.load_tolerance(target_n)
    if left_n <= max(3.0 * tolerance_n, _EARLY_FRACTION * abs(target_n - from_n)):
        return None
    what = f"the load frame ended its motion at {load.force_n:.1f} N, far from the ordered {target_n:g} N"
    return f"{what}: was it stopped at the machine, or restarted? Check its zero, position and settings"


def rest_fault(turn: StepContext) -> bool:
    """Where no motion is ordered: FAULT if a device is not at rest as it was left; True if so.

    A load frame that a person moves is not judged: a load that left its tolerance is asked for again, never downwards.
    """
    found = _load_frame_moved(turn.state) or _stage_moved(turn.state)
    if found is None:
        return False
    code, reason = found
    guards = (("load_error_n", load_error_n(turn.state)), ("stage_error_um", stage_error_um(turn.state)))
    turn.fault(Cause.DEVICE_FAULT, reason, *guards, code=code)
    return True


def _load_frame_moved(state: EngineState) -> tuple[FaultCode, str] | None:
    if state.load is None or state.load_frame is None or state.load_frame.control is ControlMode.MANUAL:
        return None
    held = state.state in (State.HOLDING, State.IMAGING)
    kept_n = _load_target_n(state) if held else state.reached_load_n if state.state in (State.CALIBRATION_GATE, State.WARM_UP) else None
    tolerance_n = state.plan.hold.load_tolerance(kept_n or 0.0)
    return state.rest.problem(state.load, kept_n, tolerance_n, ramp_sign(state) if held else 0.0)


def _stage_moved(state: EngineState) -> tuple[FaultCode, str] | None:
    if state.stage is None or state.state not in (State.HOLDING, State.IMAGING) or _stage_within(state):
        return None
    what = f"the stage is {stage_error_um(state):.1f} um from its target while nothing was ordered"
    return FaultCode.MOVED_AT_REST, f"{what}: check who moved it, or whether it slipped"


def settle(turn: StepContext) -> None:
    """In SETTLING: go on when everything has been within tolerance, at rest and fresh, for the settle time."""
    state = turn.state
    if state.stale:
        turn.update(in_tolerance_since_ns=None)
        return
    if rest_fault(turn):
        return
    if state.hold_load_n is None and state.load is not None:
        turn.update(hold_load_n=state.load.force_n)
        state = turn.state
    if not_at_rest_reason(state) is not None:
        turn.update(in_tolerance_since_ns=None)
        if state.step.load_n is None:
            turn.update(hold_load_n=None)
        if _at_rest(state) and (state.step.load_n is not None or not _stage_within(state)):
            _astray(turn)
        return
    since = state.time_ns if state.in_tolerance_since_ns is None else state.in_tolerance_since_ns
    turn.update(in_tolerance_since_ns=since, motion=replace(state.motion, out_of_tolerance_since_ns=None))
    steady_s = state.seconds_since(since)
    if steady_s >= state.plan.hold.settle_s:
        turn.update(hold_end_ns=state.time_ns + round(state.plan.hold.hold_s * 1e9))
        turn.transition(
            Cause.SETTLED, ("steady_s", steady_s), ("load_error_n", load_error_n(state)), ("stage_error_um", stage_error_um(state))
        )


def hold(turn: StepContext) -> None:
    """In HOLDING: go on when the hold is over; a disturbance begins settling again."""
    state = turn.state
    if state.stale or rest_fault(turn) or on_disturbance(turn):
        return
    if state.time_ns >= state.since_ns + round(state.plan.hold.hold_s * 1e9):
        reason = hold_extension_reason(state)
        if reason is not None:
            _hold_longer(turn, reason)
            return
        # A frame that was scanned while the hold was made longer is not of this step's pair.
        turn.update(frame_requested=False, hold_end_ns=min(state.hold_end_ns, state.time_ns))
        held_s, late_s = state.seconds_since(state.since_ns), turn.state.seconds_since(turn.state.hold_end_ns)
        turn.transition(Cause.HOLD_COMPLETE, ("held_s", held_s), ("late_s", late_s), ("load_error_n", load_error_n(state)))


def _hold_longer(turn: StepContext, reason: str) -> None:
    """No frame counts before the hold is over, and nobody knows yet when that is: at the latest, its longest."""
    state, rule = turn.state, turn.state.plan.adaptive_hold
    assert rule is not None, "only an adaptive hold is made longer"
    latest_ns = state.since_ns + round(rule.max_hold_s * 1e9)
    if state.hold_end_ns != latest_ns:
        turn.update(hold_end_ns=latest_ns)
        turn.announce(f"the hold of step {state.step.number} is made longer, because {reason}")


def on_disturbance(turn: StepContext) -> bool:
    """In HOLDING and IMAGING: back to SETTLING if this is no rest any more."""
    state = turn.state
    reason = not_at_rest_reason(state)
    if reason is None:
        return False
    what = "hold" if state.state is State.HOLDING else "imaging"
    turn.discard_frames(f"{reason} while step {state.step.number} was imaged")
    turn.transition(Cause.DISTURBED, ("reason", reason), ("load_error_n", load_error_n(state)), ("stage_error_um", stage_error_um(state)))
    turn.update(
        motion=MotionProgress(began_ns=state.time_ns, approaches=state.motion.approaches),
        in_tolerance_since_ns=None,
        hold_load_n=None,
    )
    turn.announce(f"the {what} of step {state.step.number} begins again because {reason}")
    return True
