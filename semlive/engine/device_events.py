"""Events of the devices: links, samples, and stops by the link thread."""

from __future__ import annotations

from dataclasses import replace

from semlive.data.faults import FaultCode
from semlive.data.loading import DeviceFault, LoadSample, MotionState, StageSample
from semlive.engine.commands import StopMotion
from semlive.engine.context import StepContext
from semlive.engine.events import Device, LinksReady
from semlive.engine.limits import plan_problem, sample_problem, with_device_limits
from semlive.engine.operator_commands import ask_to_resume, device_differences
from semlive.engine.resume import order_code
from semlive.engine.states import AT_REST_STATES, Cause, State


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
