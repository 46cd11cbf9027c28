"""The protocol as a pure function: ``step(state, event) -> (state, commands)``.

Each event is processed in three steps: the time of the state is updated, the handler of the event runs, and the condition that the state
waits for is evaluated.
"""

from __future__ import annotations

from dataclasses import replace

from semlive.data.experiment import Plan
from semlive.data.faults import FaultCode
from semlive.data.loading import DeviceFault, LoadSample, MotionState, StageSample
from semlive.engine import calibration_gate, warm_up_gate
from semlive.engine import events as ev
from semlive.engine.commands import Command, FinishRun, StopMotion
from semlive.engine.events import Device, Event, OperatorCommand
from semlive.engine.frame_selection import frame_scanned, frame_unreadable, select_pair
from semlive.engine.limits import plan_problem, sample_problem, with_device_limits
from semlive.engine.load_history import LoadHistory
from semlive.engine.motion import continue_motion, hold, rest_fault, settle, start_step
from semlive.engine.resume import InterruptedRun, device_changes, order_code
from semlive.engine.state import EngineState, StepContext
from semlive.engine.states import AT_REST_STATES, FINAL_STATES, Cause, State
from semlive.engine.supervision.ramp_supervision import Finding
from semlive.engine.supervision.unloading import loaded_problem, unloading_problem
from semlive.errors import BadInput

_STOP_REPORT_S = 2.0
"""Time without a confirmed stop, experiment seconds, after which a message names the devices that have not confirmed it."""
_STOP_WAIT_TEXT = "waiting for the word that it rests of"


def start(plan: Plan, now_ns: int, *, next_step: int = 0, interrupted_run: InterruptedRun | None = None) -> EngineState:
    """Return the state before the first event.

    Args:
        plan: the plan of the run.
        now_ns: experiment time.
        next_step: index of the first step to execute. A value above 0 continues a run; motion then needs the confirmation of the operator.
        interrupted_run: contents of the log of the run that is resumed; it determines the next step. None for a new run.

    Raises:
        BadInput: if the plan has no such step, violates its limits, or differs from the plan of the interrupted run.
    """
    if interrupted_run is not None:
        plan, next_step = interrupted_run.steps_of(plan), len(interrupted_run.completed_pairs)
    all_done = interrupted_run is not None and next_step == len(plan.steps)
    if not 0 <= next_step < len(plan.steps) and not all_done:
        raise BadInput(f"the plan has {len(plan.steps)} steps, none of index {next_step}; give it at least one step to do")
    problem = plan_problem(plan, plan.limits, next_step)
    if problem is not None:
        raise BadInput(f"the plan breaks its limits in {problem}; change the plan or the limits")
    history_s = 2 * plan.hold.frame_timeout_s + plan.hold.hold_s
    state = EngineState(
        plan=plan,
        limits=plan.limits,
        state=State.IDLE,
        step_index=min(next_step, len(plan.steps) - 1),
        time_ns=now_ns,
        since_ns=now_ns,
        history=LoadHistory(keep_ns=round(history_s * 1e9)),
        reached_shift_um=(0.0, 0.0) if next_step == 0 and interrupted_run is None else None,
    )
    if interrupted_run is None:
        return state
    return replace(
        state,
        interrupted_run=interrupted_run,
        origin_um=interrupted_run.origin_um,
        reference=interrupted_run.completed_pairs[0].first if interrupted_run.completed_pairs else None,
        start_sigma_s=state.start_sigma_s if interrupted_run.start_sigma_s is None else interrupted_run.start_sigma_s,
        field_of_view=interrupted_run.field_of_view,
        drift_forecast=interrupted_run.drift_forecast,
        calibration_assessment=interrupted_run.calibration_assessment,
        calibration_gate_passed=calibration_gate.passed([pair.step for pair in interrupted_run.completed_pairs]),
        warm_up_gate_passed=warm_up_gate.passed(plan, [pair.step for pair in interrupted_run.completed_pairs]),
    )


def step(state: EngineState, event: Event) -> tuple[EngineState, tuple[Command, ...]]:
    """Return the state after an event and the commands that result from it.

    Raises:
        InvalidTransition: only after a programming error in the engine.
    """
    if state.state in FINAL_STATES:
        return state, ()
    context = StepContext(replace(state, time_ns=max(state.time_ns, event.time_ns)))
    _apply_event(context, event)
    _advance_state(context)
    return context.state, tuple(context.commands)


def _apply_event(context: StepContext, event: Event) -> None:
    """Call the handler of the event."""
    match event:
        case ev.Tick():
            pass
        case ev.LoadReading(sample=sample):
            _load_reading(context, sample)
        case ev.StageReading(sample=sample):
            _stage_reading(context, sample)
        case ev.FrameScanned(info=info):
            _end_hold(context)
            frame_scanned(context, info)
        case ev.FieldOfViewMeasured():
            context.update(field_of_view=event)
        case ev.DriftForecastUpdated():
            context.update(drift_forecast=event)
        case ev.HoldDriftMeasured():
            context.update(hold_drift=event)
        case ev.CalibrationAssessed():
            context.update(calibration_assessment=event)
        case ev.FrameUnreadable(export=export, reason=reason):
            frame_unreadable(context, export, reason)
        case ev.CommandAcknowledged(time_ns=time_ns, device=device):
            if context.state.state is State.RAMPING and context.state.motion.pending_devices[:1] == (device,):
                context.update(motion=replace(context.state.motion, acknowledged_ns=time_ns))
        case ev.OperatorAction(verb=verb, reason=reason):
            _operator_command(context, verb, reason)
        case ev.LinksOpening():
            _open_links(context)
        case ev.LinksReady():
            _links_ready(context, event)
        case ev.LinkStale(device=device):
            context.update(stale=context.state.stale | {device})
        case ev.LinkLost(device=device, reason=reason):
            context.update(stale=context.state.stale | {device})
            context.fault(Cause.LINK_LOST, f"the link to the {device.words} is lost: {reason}", ("device", device.value))
        case ev.LinkRestored(device=device):
            context.announce(f"the {device.words} answers again")
        case ev.DeviceStopped(device=device, reason=reason):
            _device_stopped(context, device, reason)
        case ev.DeviceFault(device=device, reason=reason, emergency=emergency, code=code):
            cause = Cause.EMERGENCY if emergency else Cause.DEVICE_FAULT
            context.fault(cause, f"{device.words}: {reason}", ("device", device.value), code=code)


def _open_links(context: StepContext) -> None:
    """Go to CONNECTING; finish the run at once if all its steps are complete."""
    before, steps = context.state.interrupted_run, len(context.state.plan.steps)
    if context.state.state is not State.IDLE:
        return
    if before is not None and len(before.completed_pairs) == steps:
        context.finish(Cause.LAST_STEP, f"all {steps} steps were done before; no device is asked for anything")
    else:
        context.transition(Cause.OPENING)


def _device_stopped(context: StepContext, device: Device, reason: str) -> None:
    """Handle a stop by the link thread: a fault, except while a resumed run connects, which needs a confirmation in any case."""
    message = f"the {device.words} was stopped: {reason}"
    if context.state.state is State.CONNECTING and context.state.interrupted_run is not None:
        context.update(stopped_on_resume=context.state.stopped_on_resume | {device})
        context.announce(message)
    else:
        context.fault(Cause.DEVICE_STOPPED, message, ("device", device.value))


def _end_hold(context: StepContext) -> None:
    """End the hold before a frame is processed that arrives at the end of the hold."""
    if context.state.state is State.HOLDING:
        hold(context)


def _advance_state(context: StepContext) -> None:
    """Evaluate the condition that the present state waits for."""
    _check_timeouts(context)
    match context.state.state:
        case State.RAMPING:
            continue_motion(context)
        case State.SETTLING:
            settle(context)
        case State.HOLDING:
            hold(context)
        case State.IMAGING:
            select_pair(context)
        case State.CALIBRATION_GATE if not rest_fault(context):
            calibration_gate.evaluate(context)
        case State.WARM_UP if not rest_fault(context):
            warm_up_gate.evaluate(context)
        case State.STOPPING:
            _check_stopped(context)
    if context.state.state is State.STEP_DONE:
        _finish_step(context)


def _finish_step(context: StepContext) -> None:
    """Begin the next step, enter a gate before it, or finish the run; load and position are held."""
    if context.state.step_index + 1 == len(context.state.plan.steps):
        context.finish(Cause.LAST_STEP, f"all {len(context.state.plan.steps)} steps are done; load and position are held")
        return
    completed, after = context.state, replace(context.state, step_index=context.state.step_index + 1)
    if calibration_gate.is_closed(after):
        context.transition(Cause.CALIBRATION_CHECK)
        context.update(step_index=completed.step_index + 1)
        return
    if warm_up_gate.is_closed(after):
        warm_up_gate.enter(context, Cause.WARM_UP)
        context.update(step_index=completed.step_index + 1)
        return
    context.transition(Cause.NEXT_STEP)
    context.update(step_index=completed.step_index + 1)
    start_step(context)


def _load_reading(context: StepContext, sample: LoadSample) -> None:
    state = context.state
    watch, sudden_change = state.watch.with_sample(state.limits, sample)
    context.update(
        load=sample,
        watch=watch,
        rest=state.rest.with_sample(sample, ordered=state.state not in AT_REST_STATES),
        stale=state.stale - {Device.LOAD_FRAME},
        history=state.history.with_sample(sample.time_ns, sample.force_n, sample.gage_strain),
    )
    problem = sample_problem(state.limits, sample) or sudden_change
    if problem is not None and context.is_allowed(Cause.LIMIT):
        guards = (("force_n", sample.force_n), ("extension_mm", sample.extension_mm), ("sequence", sample.sequence))
        context.fault(Cause.LIMIT, problem, *guards)
    resuming = context.state.state is State.CONNECTING and context.state.interrupted_run is not None
    if sample.order_changed is not None and (resuming or context.state.state in (State.RAMPING, *AT_REST_STATES)):
        context.fault(Cause.DEVICE_FAULT, f"load frame: {sample.order_changed}", code=order_code(sample))
    _check_motion_state(context, Device.LOAD_FRAME, sample, state.load)


def _stage_reading(context: StepContext, sample: StageSample) -> None:
    state = context.state
    context.update(
        position=sample,
        stale=state.stale - {Device.STAGE},
        origin_um=state.origin_um or (sample.x_um, sample.y_um),
    )
    _check_motion_state(context, Device.STAGE, sample, state.position)


def _check_motion_state(
    context: StepContext, device: Device, now: LoadSample | StageSample, before: LoadSample | StageSample | None
) -> None:
    """Go to FAULT or EMERGENCY_STOP if a device reports a fault.

    A device that its watchdog stopped when a run was interrupted reports that fault until it receives a command. It therefore receives one
    stop command before the operator confirms resuming.
    """
    if now.motion is not MotionState.FAULT:
        return
    trouble = now.trouble if isinstance(now, LoadSample) else None
    if trouble is not None and trouble.is_emergency:
        # An emergency that was reported before the stop, and that lasts, does not prevent the stop from completing.
        reported = context.state.state is State.STOPPING and before is not None and before.motion is MotionState.FAULT
        if context.is_allowed(Cause.EMERGENCY) and not reported:
            reason = f"the {device.words} was stopped by its {trouble}; free the machine, then resume"
            code = FaultCode.LIMIT_SWITCH if trouble is DeviceFault.LIMIT_SWITCH else FaultCode.EMERGENCY_STOP
            context.fault(Cause.EMERGENCY, reason, ("device", device.value), ("trouble", trouble.value), code=code)
    elif context.state.state is State.CONNECTING and context.state.interrupted_run is not None:
        if before is None or before.motion is not MotionState.FAULT:
            context.commands.append(StopMotion(f"the {device.words} has been in fault since the run was interrupted"))
    elif context.is_allowed(Cause.DEVICE_FAULT):
        what = "is in fault" if trouble is None else f"is in fault ({trouble})"
        context.fault(Cause.DEVICE_FAULT, f"the {device.words} says that it {what}; look at it, then resume", ("device", device.value))


def _links_ready(context: StepContext, event: ev.LinksReady) -> None:
    # The devices are stored even if one of them has reported a fault meanwhile: the run continues with them once the fault is cleared.
    limits = with_device_limits(context.state.plan.limits, event.load_frame)
    context.update(load_frame=event.load_frame, stage=event.stage, limits=limits, linked=True)
    if event.stage is None:
        context.update(reached_shift_um=(0.0, 0.0))
    cause = Cause.LINKED if context.state.step_index == 0 and context.state.interrupted_run is None else Cause.RECONNECTED
    if not context.is_allowed(cause):
        return
    problem = plan_problem(context.state.plan, limits, context.state.step_index)
    if problem is not None:
        context.fault(Cause.LIMIT, f"the plan breaks the load frame's own limit in {problem}")
        return
    change = _device_changes(context.state)
    if change is not None:
        context.fault(
            Cause.DEVICE_FAULT, f"the run was interrupted, and {change.reason}: look at the machine, then resume", code=change.code
        )
        return
    context.transition(cause)
    if context.state.state is State.RESUMING:
        _ask_to_resume(context)


def _ask_to_resume(context: StepContext) -> None:
    """Announce the motion that resuming starts, and the differences between the devices and the log."""
    now = context.state
    load = "" if now.step.load_n is None else f" and the load to {now.step.load_n:g} N"
    x, y = now.step.shift_um
    change = changed_since(now)
    hint = "" if change is None else f"look first: {change.reason}; "
    context.announce(f"{hint}resume sets the stage to ({x:g}, {y:g}) um{load} and begins step {now.step_index + 1} again; or stop")


def changed_since(state: EngineState) -> Finding | None:
    """Return how the devices of a resumed run differ from the last readings in its log; None if they do not."""
    if state.interrupted_run is not None and Device.LOAD_FRAME in state.stopped_on_resume:
        # The travel of a stage is finite. A load frame that moved without supervision must be inspected by a person.
        return Finding(FaultCode.UNORDERED_MOTION, f"the {Device.LOAD_FRAME.words} was still moving, and was stopped")
    return _device_changes(state)


def _device_changes(state: EngineState) -> Finding | None:
    """Return the differences of `changed_since`, without a load frame found in motion, which is a separate fault."""
    before = state.interrupted_run
    if before is None:
        return None
    tolerance_n = state.plan.hold.load_tolerance(0.0 if before.load is None else before.load.force_n)
    return device_changes(before, state.step, tolerance_n, state.load, state.position)


def _motion_blocker(state: EngineState) -> str | None:
    """Return the reason why motion must not begin now, as a clause; None if it may begin."""
    if not state.linked:
        return "the devices and the analysis are not ready yet"
    for device in state.devices:
        sample = state.sample(device)
        if sample is None or device in state.stale:
            return f"the {device.words} gives no fresh reading"
        if sample.motion is not MotionState.STOPPED:
            return f"the {device.words} is {sample.motion}"
    return None if state.load is None else sample_problem(state.limits, state.load) or unloading_problem(state)


def _operator_command(context: StepContext, verb: OperatorCommand, reason: str) -> None:
    """Execute a command of the operator if the table of transitions allows it; else announce why not."""
    cause = Cause(verb.value)
    at = context.state.state
    if not context.is_allowed(cause):
        context.announce(f"cannot {verb} while {at}")
    elif verb in (OperatorCommand.START, OperatorCommand.RESUME):
        load_problem = loaded_problem(context.state)
        if load_problem is not None and context.is_allowed(Cause.LIMIT):
            context.fault(Cause.LIMIT, load_problem, code=FaultCode.LOADED_AT_START)
            return
        problem = _motion_blocker(context.state)
        if problem is not None:
            context.announce(f"cannot {verb}: {problem}")
            return
        _start_or_resume(context, cause)
    elif verb is OperatorCommand.ABORT:
        context.stop_and_transition(cause, f"aborted by the operator while {at}")
        context.commands.append(FinishRun(context.state.state, context.state.message))
    else:
        verb_text = "paused" if verb is OperatorCommand.PAUSE else "stopped"
        context.stop_and_transition(cause, f"{verb_text} while {at}: {reason}" if reason else f"{verb_text} by the operator while {at}")


def _start_or_resume(context: StepContext, cause: Cause) -> None:
    """Execute START or RESUME after the readiness of every device was checked."""
    at, gate = context.state.state, warm_up_gate.is_closed(context.state)
    if at in (State.PAUSED, State.RESUMING) and calibration_gate.is_closed(context.state):
        answered = at is State.PAUSED and context.state.calibration_asked
        context.update(interrupted_run=None, calibration_gate_passed=answered)
        if not answered:
            context.transition(Cause.CALIBRATION_CHECK)
            return
        if gate:
            # The operator has seen the message about the calibration, but no message about the drift rate.
            warm_up_gate.enter(context, Cause.WARM_UP)
            return
    if at is State.RESUMING and gate and context.state.step_index > 0:
        warm_up_gate.enter(context, Cause.WARM_UP)
        context.update(interrupted_run=None)
        return
    context.transition(cause)
    if context.state.state is not State.RAMPING:
        _ask_to_resume(context)
        return
    context.update(interrupted_run=None)
    if gate and at is State.PAUSED:
        # The operator has seen the drift rate and continues.
        context.update(warm_up_gate_passed=True)
    elif gate:
        context.update(warming_since_ns=context.state.time_ns)
        warm_up_gate.start_extra_pair(context)
        return
    start_step(context)


def _check_stopped(context: StepContext) -> None:
    """In STOPPING: finish the run when every device has reported, after the stop, that it does not move.

    There is no timeout for a device that answers and still moves, because its link thread repeats the stop command; only ABORT ends it.
    """
    state = context.state
    unconfirmed = [d for d in state.devices if not _stopped_since(state.sample(d), state.since_ns)]
    names = " and ".join(f"the {device.words}" for device in unconfirmed)
    if not unconfirmed:
        context.finish(Cause.AT_REST, "the run was stopped; load and position are held")
    elif state.seconds_since(state.since_ns) > state.limits.stop_timeout_s and not any(_still_moves(state, d) for d in unconfirmed):
        context.commands.append(StopMotion("the stop was not confirmed"))
        context.finish(
            Cause.STOP_UNCONFIRMED,
            f"the run was stopped, but not every device confirmed that it rests ({names} did not): look at the machine",
        )
    elif state.seconds_since(state.since_ns) > _STOP_REPORT_S and not state.message.startswith(_STOP_WAIT_TEXT):
        moving = any(_still_moves(state, device) for device in unconfirmed)
        until = "which still moves: press its emergency stop" if moving else f"at most {state.limits.stop_timeout_s:g} s"
        context.announce(f"{_STOP_WAIT_TEXT} {names}, {until}; abort ends without it")


def _still_moves(state: EngineState, device: Device) -> bool:
    """Whether a fresh reading of a device shows motion although a stop was ordered."""
    sample = state.sample(device)
    return sample is not None and device not in state.stale and sample.motion is MotionState.MOVING


def _stopped_since(sample: LoadSample | StageSample | None, since_ns: int) -> bool:
    return sample is not None and sample.time_ns > since_ns and sample.motion is not MotionState.MOVING


def _check_timeouts(context: StepContext) -> None:
    state = context.state
    rule = state.plan.hold
    if state.state in (State.RAMPING, State.SETTLING) and state.seconds_since(state.motion.began_ns) > rule.motion_timeout_s:
        reason = f"step {state.step.number} has not settled for {rule.motion_timeout_s:g} s"
        context.fault(Cause.MOTION_TIMEOUT, reason, ("waited_s", state.seconds_since(state.motion.began_ns)))
    elif state.state is State.IMAGING and state.seconds_since(state.since_ns) > rule.frame_timeout_s:
        reason = f"no frame for step {state.step.number} for {rule.frame_timeout_s:g} s: is the SEM scanning and exporting into the folder?"
        context.fault(Cause.FRAME_TIMEOUT, reason, ("waited_s", state.seconds_since(state.since_ns)))
