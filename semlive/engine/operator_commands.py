"""Commands of the operator, and what the operator must know before a run is resumed."""

from __future__ import annotations

from dataclasses import replace

from semlive.data.faults import FaultCode
from semlive.data.loading import MotionState
from semlive.engine.commands import FinishRun
from semlive.engine.context import StepContext
from semlive.engine.events import Device, OperatorCommand
from semlive.engine.gates import calibration, warm_up
from semlive.engine.limits import sample_problem
from semlive.engine.motion import start_step
from semlive.engine.resume import device_changes
from semlive.engine.state import EngineState
from semlive.engine.states import Cause, State
from semlive.engine.supervision.ramp_supervision import Finding
from semlive.engine.supervision.unloading import loaded_problem, unloading_problem


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
