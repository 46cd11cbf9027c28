"""The protocol as a pure function: ``step(state, event) -> (state, commands)``.

Every event goes the same way: time is taken over, the event's own handler speaks, then the state looks at what it waits for.
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

_STOP_TOLD_S = 2.0
"""Experiment seconds after which the operator is told who has not confirmed a stop."""
_WAITING = "waiting for the word that it rests of"


def start(plan: Plan, now_ns: int, *, next_step: int = 0, before: InterruptedRun | None = None) -> EngineState:
    """The state before anything has happened.

    Args:
        plan: what is to be done.
        now_ns: experiment time.
        next_step: index of the first step to be done; more than 0 continues a run, and asks before anything moves.
        before: what the log tells of the run that is taken up again; says itself which step is next.

    Raises:
        BadInput: if the plan has no such step, or breaks its own limits, or is not the one that was interrupted.
    """
    if before is not None:
        plan, next_step = before.steps_of(plan), len(before.completed_pairs)
    all_done = before is not None and next_step == len(plan.steps)
    if not 0 <= next_step < len(plan.steps) and not all_done:
        raise BadInput(f"the plan has {len(plan.steps)} steps, none of index {next_step}; give it at least one step to do")
    problem = plan_problem(plan, plan.limits, next_step)
    if problem is not None:
        raise BadInput(f"the plan breaks its limits in {problem}; change the plan or the limits")
    keep_s = 2 * plan.hold.frame_timeout_s + plan.hold.hold_s
    state = EngineState(
        plan=plan,
        limits=plan.limits,
        state=State.IDLE,
        step_index=min(next_step, len(plan.steps) - 1),
        time_ns=now_ns,
        since_ns=now_ns,
        history=LoadHistory(keep_ns=round(keep_s * 1e9)),
        reached_shift_um=(0.0, 0.0) if next_step == 0 and before is None else None,
    )
    if before is None:
        return state
    return replace(
        state,
        interrupted_run=before,
        origin_um=before.origin_um,
        reference=before.completed_pairs[0].first if before.completed_pairs else None,
        start_sigma_s=state.start_sigma_s if before.start_sigma_s is None else before.start_sigma_s,
        field_of_view=before.field_of_view,
        drift_forecast=before.drift_forecast,
        calibration_assessment=before.calibration_assessment,
        calibration_gate_passed=calibration_gate.passed([one.step for one in before.completed_pairs]),
        warm_up_gate_passed=warm_up_gate.passed(plan, [one.step for one in before.completed_pairs]),
    )


def step(state: EngineState, event: Event) -> tuple[EngineState, tuple[Command, ...]]:
    """What follows from an event.

    Raises:
        ImpossibleTransition: never, unless the engine itself is wrong.
    """
    if state.state in FINAL_STATES:
        return state, ()
    turn = StepContext(replace(state, time_ns=max(state.time_ns, event.time_ns)))
    _hear(turn, event)
    _look(turn)
    return turn.state, tuple(turn.commands)


def _hear(turn: StepContext, event: Event) -> None:
    """The event's own consequences."""
    match event:
        case ev.Tick():
            pass
        case ev.LoadReading(sample=sample):
            _load_reading(turn, sample)
        case ev.StageReading(sample=sample):
            _stage_reading(turn, sample)
        case ev.FrameScanned(info=info):
            _wait_over(turn)
            frame_scanned(turn, info)
        case ev.FieldOfViewMeasured():
            turn.update(field_of_view=event)
        case ev.DriftForecastUpdated():
            turn.update(drift_forecast=event)
        case ev.HoldDriftMeasured():
            turn.update(hold_drift=event)
        case ev.CalibrationAssessed():
            turn.update(calibration_assessment=event)
        case ev.FrameUnreadable(export=export, reason=reason):
            frame_unreadable(turn, export, reason)
        case ev.CommandAcknowledged(time_ns=time_ns, device=device):
            if turn.state.state is State.RAMPING and turn.state.motion.pending_devices[:1] == (device,):
                turn.update(motion=replace(turn.state.motion, acknowledged_ns=time_ns))
        case ev.OperatorAction(verb=verb, reason=reason):
            _operator(turn, verb, reason)
        case ev.LinksOpening():
            _opening(turn)
        case ev.LinksReady():
            _ready(turn, event)
        case ev.LinkStale(device=device):
            turn.update(stale=turn.state.stale | {device})
        case ev.LinkLost(device=device, reason=reason):
            turn.update(stale=turn.state.stale | {device})
            turn.fault(Cause.LINK_LOST, f"the link to the {device.words} is lost: {reason}", ("device", device.value))
        case ev.LinkRestored(device=device):
            turn.announce(f"the {device.words} answers again")
        case ev.DeviceStopped(device=device, reason=reason):
            _device_stopped(turn, device, reason)
        case ev.DeviceFault(device=device, reason=reason, emergency=emergency, code=code):
            cause = Cause.EMERGENCY if emergency else Cause.DEVICE_FAULT
            turn.fault(cause, f"{device.words}: {reason}", ("device", device.value), code=code)


def _opening(turn: StepContext) -> None:
    """The links are being opened, unless there is nothing left to do."""
    before, steps = turn.state.interrupted_run, len(turn.state.plan.steps)
    if turn.state.state is not State.IDLE:
        return
    if before is not None and len(before.completed_pairs) == steps:
        turn.finish(Cause.LAST_STEP, f"all {steps} steps were done before; no device is asked for anything")
    else:
        turn.transition(Cause.OPENING)


def _device_stopped(turn: StepContext, device: Device, reason: str) -> None:
    """Where motion was expected, or nothing was known yet, it is a fault; what is taken up again asks anyway, and says it then."""
    told = f"the {device.words} was stopped: {reason}"
    if turn.state.state is State.CONNECTING and turn.state.interrupted_run is not None:
        turn.update(stopped_on_resume=turn.state.stopped_on_resume | {device})
        turn.announce(told)
    else:
        turn.fault(Cause.DEVICE_STOPPED, told, ("device", device.value))


def _wait_over(turn: StepContext) -> None:
    """A frame may arrive at the very instant that ends the hold: let the hold end first."""
    if turn.state.state is State.HOLDING:
        hold(turn)


def _look(turn: StepContext) -> None:
    """What the state waits for."""
    _timeouts(turn)
    match turn.state.state:
        case State.RAMPING:
            continue_motion(turn)
        case State.SETTLING:
            settle(turn)
        case State.HOLDING:
            hold(turn)
        case State.IMAGING:
            select_pair(turn)
        case State.CALIBRATION_GATE if not rest_fault(turn):
            calibration_gate.evaluate(turn)
        case State.WARM_UP if not rest_fault(turn):
            warm_up_gate.evaluate(turn)
        case State.STOPPING:
            _stopping(turn)
    if turn.state.state is State.STEP_DONE:
        _step_done(turn)


def _step_done(turn: StepContext) -> None:
    """On to the next step, or the end: load and position stay as they are."""
    if turn.state.step_index + 1 == len(turn.state.plan.steps):
        turn.finish(Cause.LAST_STEP, f"all {len(turn.state.plan.steps)} steps are done; load and position are held")
        return
    done, after = turn.state, replace(turn.state, step_index=turn.state.step_index + 1)
    if calibration_gate.is_closed(after):
        turn.transition(Cause.CALIBRATION_CHECK)
        turn.update(step_index=done.step_index + 1)
        return
    if warm_up_gate.is_closed(after):
        warm_up_gate.enter(turn, Cause.WARM_UP)
        turn.update(step_index=done.step_index + 1)
        return
    turn.transition(Cause.NEXT_STEP)
    turn.update(step_index=done.step_index + 1)
    start_step(turn)


def _load_reading(turn: StepContext, sample: LoadSample) -> None:
    state = turn.state
    watch, sudden = state.watch.with_sample(state.limits, sample)
    turn.update(
        load=sample,
        watch=watch,
        rest=state.rest.with_sample(sample, ordered=state.state not in AT_REST_STATES),
        stale=state.stale - {Device.LOAD_FRAME},
        history=state.history.with_sample(sample.time_ns, sample.force_n, sample.gage_strain),
    )
    problem = sample_problem(state.limits, sample) or sudden
    if problem is not None and turn.is_allowed(Cause.LIMIT):
        guards = (("force_n", sample.force_n), ("extension_mm", sample.extension_mm), ("sequence", sample.sequence))
        turn.fault(Cause.LIMIT, problem, *guards)
    resuming = turn.state.state is State.CONNECTING and turn.state.interrupted_run is not None
    if sample.order_changed is not None and (resuming or turn.state.state in (State.RAMPING, *AT_REST_STATES)):
        turn.fault(Cause.DEVICE_FAULT, f"load frame: {sample.order_changed}", code=order_code(sample))
    _motion_word(turn, Device.LOAD_FRAME, sample, state.load)


def _stage_reading(turn: StepContext, sample: StageSample) -> None:
    state = turn.state
    turn.update(
        position=sample,
        stale=state.stale - {Device.STAGE},
        origin_um=state.origin_um or (sample.x_um, sample.y_um),
    )
    _motion_word(turn, Device.STAGE, sample, state.position)


def _motion_word(turn: StepContext, device: Device, now: LoadSample | StageSample, before: LoadSample | StageSample | None) -> None:
    """A device that says it is in trouble is believed.

    One whose watchdog stopped it when a run died says so until it is spoken to: told to stop once, before the operator is asked.
    """
    if now.motion is not MotionState.FAULT:
        return
    trouble = now.trouble if isinstance(now, LoadSample) else None
    if trouble is not None and trouble.is_emergency:
        # Who was told to stop in an emergency is not kept from ending by the same emergency, which lasts.
        known = turn.state.state is State.STOPPING and before is not None and before.motion is MotionState.FAULT
        if turn.is_allowed(Cause.EMERGENCY) and not known:
            reason = f"the {device.words} was stopped by its {trouble}; free the machine, then resume"
            code = FaultCode.LIMIT_SWITCH if trouble is DeviceFault.LIMIT_SWITCH else FaultCode.EMERGENCY_STOP
            turn.fault(Cause.EMERGENCY, reason, ("device", device.value), ("trouble", trouble.value), code=code)
    elif turn.state.state is State.CONNECTING and turn.state.interrupted_run is not None:
        if before is None or before.motion is not MotionState.FAULT:
            turn.commands.append(StopMotion(f"the {device.words} has been in fault since the run was interrupted"))
    elif turn.is_allowed(Cause.DEVICE_FAULT):
        what = "is in fault" if trouble is None else f"is in fault ({trouble})"
        turn.fault(Cause.DEVICE_FAULT, f"the {device.words} says that it {what}; look at it, then resume", ("device", device.value))


def _ready(turn: StepContext, event: ev.LinksReady) -> None:
    # Also where a device has said meanwhile that it is in trouble: once it is out of it the run goes on with these devices.
    limits = with_device_limits(turn.state.plan.limits, event.load_frame)
    turn.update(load_frame=event.load_frame, stage=event.stage, limits=limits, linked=True)
    if event.stage is None:
        turn.update(reached_shift_um=(0.0, 0.0))
    cause = Cause.LINKED if turn.state.step_index == 0 and turn.state.interrupted_run is None else Cause.RECONNECTED
    if not turn.is_allowed(cause):
        return
    problem = plan_problem(turn.state.plan, limits, turn.state.step_index)
    if problem is not None:
        turn.fault(Cause.LIMIT, f"the plan breaks the load frame's own limit in {problem}")
        return
    found = _changed(turn.state)
    if found is not None:
        turn.fault(Cause.DEVICE_FAULT, f"the run was interrupted, and {found.reason}: look at the machine, then resume", code=found.code)
        return
    turn.transition(cause)
    if turn.state.state is State.RESUMING:
        _ask_to_resume(turn)


def _ask_to_resume(turn: StepContext) -> None:
    """Say what resuming will do, and what is other than the log left it."""
    now = turn.state
    load = "" if now.step.load_n is None else f" and the load to {now.step.load_n:g} N"
    x, y = now.step.shift_um
    other = changed_since(now)
    first = "" if other is None else f"look first: {other.reason}; "
    turn.announce(f"{first}resume sets the stage to ({x:g}, {y:g}) um{load} and begins step {now.step_index + 1} again; or stop")


def changed_since(state: EngineState) -> Finding | None:
    """In a run that is resumed: how the devices differ from what its log left, or None."""
    if state.interrupted_run is not None and Device.LOAD_FRAME in state.stopped_on_resume:
        # A stage's way has an end; a load frame that nobody had held against the limits is looked at by a person.
        return Finding(FaultCode.UNORDERED_MOTION, f"the {Device.LOAD_FRAME.words} was still moving, and was stopped")
    return _changed(state)


def _changed(state: EngineState) -> Finding | None:
    """As `changed_since`, without a load frame that was found in motion, which is a fault of its own."""
    before = state.interrupted_run
    if before is None:
        return None
    tolerance_n = state.plan.hold.load_tolerance(0.0 if before.load is None else before.load.force_n)
    return device_changes(before, state.step, tolerance_n, state.load, state.position)


def _not_fit_to_move(state: EngineState) -> str | None:
    """Why motion must not begin now, as words, or None."""
    if not state.linked:
        return "the devices and the analysis are not ready yet"
    for device in state.devices:
        sample = state.sample(device)
        if sample is None or device in state.stale:
            return f"the {device.words} gives no fresh reading"
        if sample.motion is not MotionState.STOPPED:
            return f"the {device.words} is {sample.motion}"
    return None if state.load is None else sample_problem(state.limits, state.load) or unloading_problem(state)


def _operator(turn: StepContext, verb: OperatorCommand, reason: str) -> None:
    """What the operator says, where the table knows it; elsewhere only an answer."""
    cause = Cause(verb.value)
    at = turn.state.state
    if not turn.is_allowed(cause):
        turn.announce(f"cannot {verb} while {at}")
    elif verb in (OperatorCommand.START, OperatorCommand.RESUME):
        loaded = loaded_problem(turn.state)
        if loaded is not None and turn.is_allowed(Cause.LIMIT):
            turn.fault(Cause.LIMIT, loaded, code=FaultCode.LOADED_AT_START)
            return
        problem = _not_fit_to_move(turn.state)
        if problem is not None:
            turn.announce(f"cannot {verb}: {problem}")
            return
        _go_on(turn, cause)
    elif verb is OperatorCommand.ABORT:
        turn.stop_and_go(cause, f"aborted by the operator while {at}")
        turn.commands.append(FinishRun(turn.state.state, turn.state.message))
    else:
        words = "paused" if verb is OperatorCommand.PAUSE else "stopped"
        turn.stop_and_go(cause, f"{words} while {at}: {reason}" if reason else f"{words} by the operator while {at}")


def _go_on(turn: StepContext, cause: Cause) -> None:
    """START or RESUME, with every device fit to move."""
    at, gate = turn.state.state, warm_up_gate.is_closed(turn.state)
    if at in (State.PAUSED, State.RESUMING) and calibration_gate.is_closed(turn.state):
        asked = at is State.PAUSED and turn.state.calibration_asked
        turn.update(interrupted_run=None, calibration_gate_passed=asked)
        if not asked:
            turn.transition(Cause.CALIBRATION_CHECK)
            return
        if gate:
            # The operator was told of the calibration, and not how fast it drifts.
            warm_up_gate.enter(turn, Cause.WARM_UP)
            return
    if at is State.RESUMING and gate and turn.state.step_index > 0:
        warm_up_gate.enter(turn, Cause.WARM_UP)
        turn.update(interrupted_run=None)
        return
    turn.transition(cause)
    if turn.state.state is not State.RAMPING:
        _ask_to_resume(turn)
        return
    turn.update(interrupted_run=None)
    if gate and at is State.PAUSED:
        # The operator was told how fast it drifts, and goes on.
        turn.update(warm_up_gate_passed=True)
    elif gate:
        turn.update(warming_since_ns=turn.state.time_ns)
        warm_up_gate.start_extra_pair(turn)
        return
    start_step(turn)


def _stopping(turn: StepContext) -> None:
    """In STOPPING: end when every device says, after the stop, that it does not move.

    A device that answers and still moves is waited for without end, because its link thread goes on stopping it; only abort ends that.
    """
    state = turn.state
    restless = [d for d in state.devices if not _rests_since(state.sample(d), state.since_ns)]
    names = " and ".join(f"the {device.words}" for device in restless)
    if not restless:
        turn.finish(Cause.AT_REST, "the run was stopped; load and position are held")
    elif state.seconds_since(state.since_ns) > state.limits.stop_timeout_s and not any(_moves_on(state, d) for d in restless):
        turn.commands.append(StopMotion("the stop was not confirmed"))
        turn.finish(
            Cause.STOP_UNCONFIRMED,
            f"the run was stopped, but not every device confirmed that it rests ({names} did not): look at the machine",
        )
    elif state.seconds_since(state.since_ns) > _STOP_TOLD_S and not state.message.startswith(_WAITING):
        moving = any(_moves_on(state, device) for device in restless)
        until = "which still moves: press its emergency stop" if moving else f"at most {state.limits.stop_timeout_s:g} s"
        turn.announce(f"{_WAITING} {names}, {until}; abort ends without it")


def _moves_on(state: EngineState, device: Device) -> bool:
    """Whether a device, by a fresh reading, moves although it was stopped."""
    sample = state.sample(device)
    return sample is not None and device not in state.stale and sample.motion is MotionState.MOVING


def _rests_since(sample: LoadSample | StageSample | None, since_ns: int) -> bool:
    return sample is not None and sample.time_ns > since_ns and sample.motion is not MotionState.MOVING


def _timeouts(turn: StepContext) -> None:
    state = turn.state
    rule = state.plan.hold
    if state.state in (State.RAMPING, State.SETTLING) and state.seconds_since(state.motion.began_ns) > rule.motion_timeout_s:
        reason = f"step {state.step.number} has not settled for {rule.motion_timeout_s:g} s"
        turn.fault(Cause.MOTION_TIMEOUT, reason, ("waited_s", state.seconds_since(state.motion.began_ns)))
    elif state.state is State.IMAGING and state.seconds_since(state.since_ns) > rule.frame_timeout_s:
        reason = f"no frame for step {state.step.number} for {rule.frame_timeout_s:g} s: is the SEM scanning and exporting into the folder?"
        turn.fault(Cause.FRAME_TIMEOUT, reason, ("waited_s", state.seconds_since(state.since_ns)))
