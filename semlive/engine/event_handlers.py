"""Handlers of the events of devices (links, samples, stops by the link thread) and of the commands of the operator."""

from __future__ import annotations

from dataclasses import replace

from semlive.data.faults import FaultCode
from semlive.data.loading import DeviceFault, LoadSample, MotionState, StageSample
from semlive.engine.commands import FinishRun, StopMotion
from semlive.engine.context import StepContext
from semlive.engine.events import Device, LinksReady, OperatorCommand
from semlive.engine.gates import calibration, warm_up
from semlive.engine.limits import plan_problem, sample_problem, with_device_limits
from semlive.engine.motion import start_step
from semlive.engine.resume import device_changes, order_code
from semlive.engine.state import EngineState
from semlive.engine.states import AT_REST_STATES, Cause, State
from semlive.engine.supervision.ramp_supervision import Finding
from semlive.engine.supervision.unloading import loaded_problem, unloading_problem


def open_links(context: StepContext) -> None:
    """Go to CONNECTING; finish the run at once if all its steps are complete."""
    before, steps = context.state.interrupted_run, len(context.state.plan.steps)
    if context.state.state is not State.IDLE:
        return
    if before is not None and len(before.completed_pairs) == steps:
        context.finish(Cause.LAST_STEP, f"all {steps} steps were completed before; no device receives a command")
    else:
        context.transition(Cause.OPENING)


def device_stopped(context: StepContext, device: Device, reason: str) -> None:
    """Handle a stop by the link thread: a fault, except while a resumed run connects, which needs a confirmation in any case."""
    message = f"the {device.words} was stopped: {reason}"
    if context.state.state is State.CONNECTING and context.state.interrupted_run is not None:
        devices = context.state.devices
        context.update(devices=replace(devices, stopped_on_resume=devices.stopped_on_resume | {device}))
        context.announce(message)
    else:
        context.fault(Cause.DEVICE_STOPPED, message, ("device", device.value))


def load_reading(context: StepContext, sample: LoadSample) -> None:
    """Store a sample of the load frame, and go to FAULT if it violates a limit or shows a fault."""
    state = context.state
    devices, sudden_change = state.devices.with_load(sample, state.limits, ordered=state.state not in AT_REST_STATES)
    context.update(devices=devices)
    problem = sample_problem(state.limits, sample) or sudden_change
    if problem is not None and context.is_allowed(Cause.LIMIT):
        guards = (("force_n", sample.force_n), ("extension_mm", sample.extension_mm), ("sequence", sample.sequence))
        context.fault(Cause.LIMIT, problem, *guards)
    resuming = context.state.state is State.CONNECTING and context.state.interrupted_run is not None
    if sample.order_changed is not None and (resuming or context.state.state in (State.RAMPING, *AT_REST_STATES)):
        context.fault(Cause.DEVICE_FAULT, f"load frame: {sample.order_changed}", code=order_code(sample))
    _check_motion_state(context, Device.LOAD_FRAME, sample, state.devices.load)


def stage_reading(context: StepContext, sample: StageSample) -> None:
    """Store a sample of the stage, and go to FAULT if it shows a fault."""
    previous = context.state.devices.position
    context.update(devices=context.state.devices.with_position(sample))
    _check_motion_state(context, Device.STAGE, sample, previous)


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
        context.fault(Cause.DEVICE_FAULT, f"the {device.words} reports that it {what}; inspect it, then resume", ("device", device.value))


def links_ready(context: StepContext, event: LinksReady) -> None:
    """Store the devices, compare them with the plan and with the log of an interrupted run, and go to READY or RESUMING."""
    # The devices are stored even if one of them has reported a fault meanwhile: the run continues with them once the fault is cleared.
    limits = with_device_limits(context.state.plan.limits, event.load_frame)
    devices = replace(context.state.devices, load_frame=event.load_frame, stage=event.stage, linked=True)
    context.update(devices=devices, limits=limits)
    if event.stage is None:
        context.update(hold=replace(context.state.hold, reached_shift_um=(0.0, 0.0)))
    cause = Cause.LINKED if context.state.step_index == 0 and context.state.interrupted_run is None else Cause.RECONNECTED
    if not context.is_allowed(cause):
        return
    problem = plan_problem(context.state.plan, limits, context.state.step_index)
    if problem is not None:
        context.fault(Cause.LIMIT, f"the plan breaks the load frame's own limit in {problem}")
        return
    change = device_differences(context.state)
    if change is not None:
        context.fault(
            Cause.DEVICE_FAULT, f"the run was interrupted, and {change.reason}: look at the machine, then resume", code=change.code
        )
        return
    context.transition(cause)
    if context.state.state is State.RESUMING:
        ask_to_resume(context)


def ask_to_resume(context: StepContext) -> None:
    """Announce the motion that resuming starts, and the differences between the devices and the log."""
    now = context.state
    load = "" if now.step.load_n is None else f" and the load to {now.step.load_n:g} N"
    x, y = now.step.shift_um
    change = changed_since(now)
    hint = "" if change is None else f"look first: {change.reason}; "
    context.announce(f"{hint}resume sets the stage to ({x:g}, {y:g}) um{load} and begins step {now.step_index + 1} again; or stop")


def changed_since(state: EngineState) -> Finding | None:
    """Return how the devices of a resumed run differ from the last readings in its log; None if they do not."""
    if state.interrupted_run is not None and Device.LOAD_FRAME in state.devices.stopped_on_resume:
        # The travel of a stage is finite. A load frame that moved without supervision must be inspected by a person.
        return Finding(FaultCode.UNORDERED_MOTION, f"the {Device.LOAD_FRAME.words} was still moving, and was stopped")
    return device_differences(state)


def device_differences(state: EngineState) -> Finding | None:
    """Return the differences of `changed_since`, without a load frame found in motion, which is a separate fault."""
    before = state.interrupted_run
    if before is None:
        return None
    tolerance_n = state.plan.hold.load_tolerance(0.0 if before.load is None else before.load.force_n)
    return device_changes(before, state.step, tolerance_n, state.devices.load, state.devices.position)


def _motion_blocker(state: EngineState) -> str | None:
    """Return the reason why motion must not begin now, as a clause; None if it may begin."""
    if not state.devices.linked:
        return "the devices and the analysis are not ready yet"
    for device in state.devices.present:
        sample = state.devices.sample(device)
        if sample is None or device in state.devices.stale:
            return f"the {device.words} gives no fresh reading"
        if sample.motion is not MotionState.STOPPED:
            return f"the {device.words} is {sample.motion}"
    return None if state.devices.load is None else sample_problem(state.limits, state.devices.load) or unloading_problem(state)


def operator_command(context: StepContext, verb: OperatorCommand, reason: str) -> None:
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
    at, gate = context.state.state, warm_up.is_closed(context.state)
    if at in (State.PAUSED, State.RESUMING) and calibration.is_closed(context.state):
        answered = at is State.PAUSED and context.state.gates.calibration_rejected
        context.update(interrupted_run=None, gates=replace(context.state.gates, calibration_passed=answered))
        if not answered:
            context.transition(Cause.CALIBRATION_CHECK)
            return
        if gate:
            # The operator has seen the message about the calibration, but no message about the drift rate.
            warm_up.enter(context, Cause.WARM_UP)
            return
    if at is State.RESUMING and gate and context.state.step_index > 0:
        warm_up.enter(context, Cause.WARM_UP)
        context.update(interrupted_run=None)
        return
    context.transition(cause)
    if context.state.state is not State.RAMPING:
        ask_to_resume(context)
        return
    context.update(interrupted_run=None)
    if gate and at is State.PAUSED:
        # The operator has seen the drift rate and continues.
        context.update(gates=replace(context.state.gates, warm_up_passed=True))
    elif gate:
        warm_up.store_begin(context)
        warm_up.start_extra_pair(context)
        return
    start_step(context)
