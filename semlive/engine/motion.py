"""Motion to the load and position of a step, settling and hold.

Only `_order` issues motion commands, and only in RAMPING.
"""

from __future__ import annotations

import math
from dataclasses import replace

from semlive.data.experiment import Limits, Plan
from semlive.data.faults import FaultCode
from semlive.data.loading import ControlMode, MotionState
from semlive.engine.commands import MoveStage, RampTo
from semlive.engine.context import StepContext
from semlive.engine.events import Device, FieldOfViewMeasured
from semlive.engine.gates.adaptive_hold import hold_extension_reason
from semlive.engine.limits import move_problem, ramp_problem
from semlive.engine.state import EngineState, MotionProgress
from semlive.engine.states import Cause, State
from semlive.engine.supervision.unloading import loaded_problem, unloading_problem
from semlive.engine.tolerances import (
    all_at_rest,
    load_error_n,
    load_within,
    not_at_rest_reason,
    rest_fault,
    stage_error_um,
    stage_target_um,
    stage_within,
)

MAX_APPROACHES = 3
"""Largest number of repeated approaches in one step: relaxation needs one or two; a slipping grip needs an unlimited number."""

_CORRECTION_DIGITS = 4
"""Decimal digits of a correction by recentring, um, so that a correction of zero causes no motion."""
_UNMOVED_FRACTION = 0.1
"""If less than this fraction of the ordered load change appears in the reading, the reading does not show the motion."""
_EARLY_FRACTION = 0.25
"""If more than this fraction remains when a motion ends, it was stopped at the machine, or the device was restarted."""


def start_motion(context: StepContext) -> None:
    """Begin the motion of a step: check it against the limits, then order the first device to move."""
    state = context.state
    step, plan = state.step, state.plan
    pending: list[Device] = []
    if step.shift_um != state.hold.reached_shift_um or not stage_within(state):
        pending.append(Device.STAGE)
    if step.load_n is not None and (step.load_n != state.hold.reached_load_n or not load_within(state)):
        pending.append(Device.LOAD_FRAME)
    missing = [d for d in pending if d not in state.devices.present]
    if missing:
        context.fault(Cause.LIMIT, f"step {step.number} needs the {missing[0].words}, but the run has none")
        return
    unloading = unloading_problem(state) if Device.LOAD_FRAME in pending else None
    if unloading is not None:
        context.fault(Cause.LIMIT, unloading, ("load_error_n", load_error_n(state)), code=FaultCode.WOULD_UNLOAD)
        return
    problem = move_problem(state.limits, step.shift_um)
    if problem is None and step.load_n is not None and state.devices.load is not None:
        reached_n = state.hold.reached_load_n
        from_n = state.devices.load.force_n if reached_n is None else reached_n
        slack_n = plan.hold.load_tolerance(from_n) if reached_n is None else 0.0
        problem = ramp_problem(state.limits, step.load_n, plan.ramp_rate_n_s, from_n, slack_n)
    if problem is not None:
        context.fault(Cause.LIMIT, f"step {step.number} is not commanded: {problem}")
        return
    motion = replace(state.motion, pending_devices=tuple(pending), acknowledged_ns=None, out_of_tolerance_since_ns=None)
    context.update(motion=motion, hold=replace(state.hold, load_n=None))
    _order(context)


def start_step(context: StepContext) -> None:
    """Begin a step: recentre its position, restart the motion timeout and begin the motion."""
    plan = recentre(context.state.plan, context.state.limits, context.state.step_index, context.state.analysis.field_of_view)
    now_ns = context.state.time_ns
    hold = replace(context.state.hold, end_ns=now_ns, in_tolerance_since_ns=None)
    context.update(plan=plan, motion=MotionProgress(began_ns=now_ns), hold=hold)
    step = context.state.step
    load = "load as it is" if step.load_n is None else f"{step.load_n:g} N"
    x, y = step.shift_um
    load_problem = loaded_problem(context.state)
    if load_problem is not None:
        context.fault(Cause.LIMIT, load_problem, code=FaultCode.LOADED_AT_START)
        return
    context.announce(f"step {step.number} of {len(context.state.plan.steps)}: {step.phase}, shift ({x:g}, {y:g}) um, {load}")
    start_motion(context)


def _order(context: StepContext) -> None:
    """Order the next pending device to move; go to SETTLING if none is pending."""
    state = context.state
    if state.state is not State.RAMPING:
        raise RuntimeError(f"a motion was to be ordered in state {state.state}")
    if not state.motion.pending_devices:
        context.transition(Cause.ARRIVED, ("load_error_n", load_error_n(state)), ("stage_error_um", stage_error_um(state)))
        return
    if state.motion.pending_devices[0] is Device.STAGE:
        context.update(hold=replace(state.hold, reached_shift_um=None))
        context.commands.append(MoveStage(*stage_target_um(state)))
    elif state.step.load_n is not None:
        from_n = None if state.devices.load is None else state.devices.load.force_n
        context.update(hold=replace(state.hold, reached_load_n=None), motion=replace(state.motion, from_n=from_n))
        tolerance_n = state.plan.hold.load_tolerance(state.step.load_n)
        context.commands.append(RampTo(state.step.load_n, state.plan.ramp_rate_n_s, tolerance_n))


def continue_motion(context: StepContext) -> None:
    """In RAMPING: continue when the moving device has acknowledged its command and reports rest within tolerance."""
    state = context.state
    motion = state.motion
    if state.devices.stale or not motion.pending_devices or motion.acknowledged_ns is None:
        return
    device = motion.pending_devices[0]
    sample = state.devices.sample(device)
    if sample is None or sample.time_ns <= motion.acknowledged_ns or sample.motion is not MotionState.STOPPED:
        context.update(motion=replace(motion, out_of_tolerance_since_ns=None))
        return
    step = state.step
    if not (stage_within(state) if device is Device.STAGE else load_within(state)):
        _approach_again(context)
        return
    context.update(motion=replace(motion, pending_devices=motion.pending_devices[1:], acknowledged_ns=None, out_of_tolerance_since_ns=None))
    if device is Device.STAGE:
        context.update(hold=replace(state.hold, reached_shift_um=step.shift_um))
        if context.state.motion.pending_devices:
            context.transition(Cause.STAGE_ARRIVED, ("stage_error_um", stage_error_um(context.state)))
    else:
        context.update(hold=replace(state.hold, reached_load_n=step.load_n))
    _order(context)


def _approach_again(context: StepContext) -> None:
    """Handle rest out of tolerance: approach the target again after the settle time, at most `MAX_APPROACHES` times."""
    state = context.state
    motion = state.motion
    if motion.out_of_tolerance_since_ns is None:
        context.update(motion=replace(motion, out_of_tolerance_since_ns=state.time_ns))
        return
    if state.seconds_since(motion.out_of_tolerance_since_ns) < state.plan.hold.settle_s:
        return
    guards = (("load_error_n", load_error_n(state)), ("stage_error_um", stage_error_um(state)), ("approaches", motion.approaches))
    if state.state is State.RAMPING and _load_did_not_change(state):
        what = f"the motion to step {state.step.number} has ended, but the load reading does not show it ({load_error_n(state):+.1f} N off)"
        context.fault(Cause.NOT_REACHED, f"{what}: check the drive, the load cell and the grips", *guards, code=FaultCode.NO_RESPONSE)
        return
    early = _stopped_early(state)
    if early is not None:
        context.fault(Cause.NOT_REACHED, early, *guards, code=FaultCode.STOPPED_EARLY)
        return
    if motion.approaches >= MAX_APPROACHES:
        reason = f"step {state.step.number} is not reached after {MAX_APPROACHES} approaches: {not_at_rest_reason(state)}"
        context.fault(Cause.NOT_REACHED, reason, *guards)
        return
    context.transition(Cause.APPROACH_AGAIN, *guards)
    context.update(motion=replace(motion, approaches=motion.approaches + 1))
    start_motion(context)


def _load_did_not_change(state: EngineState) -> bool:
    """Whether the load reading shows almost nothing of the ordered change; a repeated order could then increase the load unobserved."""
    frame, load, target_n, from_n = state.devices.load_frame, state.devices.load, state.step.load_n, state.motion.from_n
    if frame is None or load is None or target_n is None or from_n is None or frame.control is ControlMode.MANUAL:
        return False
    return (load.force_n - from_n) * math.copysign(1.0, target_n - from_n) < _UNMOVED_FRACTION * abs(target_n - from_n)


def _stopped_early(state: EngineState) -> str | None:
    """Return a message if a ramp ended too far from its target for the control of the device to have ended it; else None."""
    frame, load, target_n, from_n = state.devices.load_frame, state.devices.load, state.step.load_n, state.motion.from_n
    if frame is None or load is None or target_n is None or from_n is None or frame.control is ControlMode.MANUAL:
        return None
    remaining_n = math.copysign(1.0, target_n - from_n) * (target_n - load.force_n)
    tolerance_n = state.plan.hold.load_tolerance(target_n)
    if remaining_n <= max(3.0 * tolerance_n, _EARLY_FRACTION * abs(target_n - from_n)):
        return None
    what = f"the load frame ended its motion at {load.force_n:.1f} N, far from the ordered {target_n:g} N"
    return f"{what}: was it stopped at the machine, or restarted? Check its zero, position and settings"


def settle(context: StepContext) -> None:
    """In SETTLING: continue when all devices have been at rest within tolerance, with fresh readings, for the settle time."""
    state = context.state
    if state.devices.stale:
        context.update(hold=replace(state.hold, in_tolerance_since_ns=None))
        return
    if rest_fault(context):
        return
    if state.hold.load_n is None and state.devices.load is not None:
        context.update(hold=replace(state.hold, load_n=state.devices.load.force_n))
        state = context.state
    if not_at_rest_reason(state) is not None:
        load_n = None if state.step.load_n is None else state.hold.load_n
        context.update(hold=replace(state.hold, in_tolerance_since_ns=None, load_n=load_n))
        if all_at_rest(state) and (state.step.load_n is not None or not stage_within(state)):
            _approach_again(context)
        return
    since = state.time_ns if state.hold.in_tolerance_since_ns is None else state.hold.in_tolerance_since_ns
    progress = replace(state.hold, in_tolerance_since_ns=since)
    context.update(hold=progress, motion=replace(state.motion, out_of_tolerance_since_ns=None))
    steady_s = state.seconds_since(since)
    if steady_s >= state.plan.hold.settle_s:
        context.update(hold=replace(progress, end_ns=state.time_ns + round(state.plan.hold.hold_s * 1e9)))
        context.transition(
            Cause.SETTLED, ("steady_s", steady_s), ("load_error_n", load_error_n(state)), ("stage_error_um", stage_error_um(state))
        )


def hold(context: StepContext) -> None:
    """In HOLDING: continue when the hold is complete; after a disturbance, return to SETTLING."""
    state = context.state
    if state.devices.stale or rest_fault(context) or on_disturbance(context):
        return
    if state.time_ns >= state.since_ns + round(state.plan.hold.hold_s * 1e9):
        reason = hold_extension_reason(state)
        if reason is not None:
            _extend_hold(context, reason)
            return
        # A frame that was scanned during the extension of the hold does not belong to the pair of this step.
        end_ns = min(state.hold.end_ns, state.time_ns)
        context.update(imaging=replace(state.imaging, frame_requested=False), hold=replace(state.hold, end_ns=end_ns))
        held_s, late_s = state.seconds_since(state.since_ns), state.seconds_since(end_ns)
        guards = (("held_s", held_s), ("late_s", late_s), ("load_error_n", load_error_n(state)))
        context.transition(Cause.HOLD_COMPLETE, *guards, late_s=late_s)


def _extend_hold(context: StepContext, reason: str) -> None:
    """Extend the hold: frames are valid only after its end, which is set to the latest possible time for now."""
    state, rule = context.state, context.state.plan.adaptive_hold
    assert rule is not None, "only an adaptive hold is made longer"
    latest_ns = state.since_ns + round(rule.max_hold_s * 1e9)
    if state.hold.end_ns != latest_ns:
        context.update(hold=replace(state.hold, end_ns=latest_ns))
        context.announce(f"the hold of step {state.step.number} is made longer, because {reason}")


def on_disturbance(context: StepContext) -> bool:
    """In HOLDING and IMAGING: return to SETTLING if the devices are not at rest in tolerance; return True in that case."""
    state = context.state
    reason = not_at_rest_reason(state)
    if reason is None:
        return False
    what = "hold" if state.state is State.HOLDING else "imaging"
    context.discard_frames(f"{reason} while step {state.step.number} was imaged")
    context.transition(
        Cause.DISTURBED, ("reason", reason), ("load_error_n", load_error_n(state)), ("stage_error_um", stage_error_um(state))
    )
    context.update(
        motion=MotionProgress(began_ns=state.time_ns, approaches=state.motion.approaches),
        hold=replace(state.hold, in_tolerance_since_ns=None, load_n=None),
    )
    context.announce(f"the {what} of step {state.step.number} begins again because {reason}")
    return True


def recentre(plan: Plan, limits: Limits, index: int, measured: FieldOfViewMeasured | None) -> Plan:
    """Return the plan with the stage position of one step corrected for the measured field of view of an earlier pair.

    Recentring corrects the stage position for drift and specimen motion. Material points then stay at nearly the scan addresses of frame 0,
    where most of the distortion cancels in the difference. At x10,000 the beam drifts by a tenth of the field in an hour. In the simulated
    experiment the contribution of the correction to the strain under load decreased from 5.7e-5 to 2e-5.

    The correction is added to that of the measured pair, whose age is therefore irrelevant. It never exceeds the travel limit of the
    stage. A planned position beyond the limit is not changed here; it is rejected when the motion is ordered.

    Args:
        plan: the experiment.
        limits: soft limits.
        index: index of the step that begins.
        measured: field of view of the newest correlated pair; with None, or without `recentring`, the plan is returned unchanged.
    """
    rule, step = plan.recentring, plan.steps[index]
    if rule is None or measured is None or not 0 <= measured.pair < index:
        return plan
    pair_step, first_step = plan.steps[measured.pair], plan.steps[0]
    offset_px = [
        shift_px - (planned_px - first_px)
        for shift_px, planned_px, first_px in zip(measured.shift_px, pair_step.shift_px, first_step.shift_px, strict=True)
    ]
    if max(map(abs, offset_px)) <= rule.threshold_px:
        offset_px = [0.0, 0.0]
    x_um, y_um = (
        _clip(
            planned_um + round(pair_um - (pair_px + error_px) * rule.um_per_px, _CORRECTION_DIGITS),
            max(limits.stage_travel_um, abs(planned_um)),
        )
        for planned_um, pair_um, pair_px, error_px in zip(step.shift_um, pair_step.shift_um, pair_step.shift_px, offset_px, strict=True)
    )
    return replace(plan, steps=(*plan.steps[:index], replace(step, shift_um=(x_um, y_um)), *plan.steps[index + 1 :]))


def _clip(value_um: float, limit_um: float) -> float:
    return min(max(value_um, -limit_um), limit_um)
