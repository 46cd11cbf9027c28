"""The protocol as a pure function: ``step(state, event) -> (state, commands)``.

Each event is processed in three steps: the time of the state is updated, the handler of the event runs, and the condition that the state
waits for is evaluated.
"""

from __future__ import annotations

from dataclasses import replace

from semlive.data.experiment import Plan
from semlive.data.loading import LoadSample, MotionState, StageSample
from semlive.engine import events as ev
from semlive.engine.commands import Command, StopMotion
from semlive.engine.context import StepContext
from semlive.engine.event_handlers import device_stopped, links_ready, load_reading, open_links, operator_command, stage_reading
from semlive.engine.events import Device, Event
from semlive.engine.frame_selection import frame_scanned, frame_unreadable, select_pair
from semlive.engine.gates import calibration, warm_up
from semlive.engine.limits import plan_problem
from semlive.engine.load_history import LoadHistory
from semlive.engine.motion import continue_motion, hold, settle, start_step
from semlive.engine.resume import InterruptedRun
from semlive.engine.state import AnalysisResults, Devices, EngineState, Gates, HoldProgress, Imaging
from semlive.engine.states import FINAL_STATES, Cause, State
from semlive.engine.tolerances import rest_fault
from semlive.errors import BadInput

_STOP_REPORT_S = 2.0
"""Time without a confirmed stop, experiment seconds, after which a message names the devices that have not confirmed it."""
_STOP_WAIT_TEXT = "waiting for confirmation of the stop by"


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
        devices=Devices(LoadHistory(keep_ns=round(history_s * 1e9))),
        hold=HoldProgress(reached_shift_um=(0.0, 0.0) if next_step == 0 and interrupted_run is None else None),
    )
    if interrupted_run is None:
        return state
    completed = [pair.step for pair in interrupted_run.completed_pairs]
    return replace(
        state,
        interrupted_run=interrupted_run,
        devices=replace(state.devices, origin_um=interrupted_run.origin_um),
        imaging=Imaging(
            reference=interrupted_run.completed_pairs[0].first if interrupted_run.completed_pairs else None,
            start_sigma_s=state.imaging.start_sigma_s if interrupted_run.start_sigma_s is None else interrupted_run.start_sigma_s,
        ),
        analysis=AnalysisResults(
            field_of_view=interrupted_run.field_of_view,
            drift_forecast=interrupted_run.drift_forecast,
            calibration=interrupted_run.calibration_assessment,
        ),
        gates=Gates(calibration_passed=calibration.passed(completed), warm_up_passed=warm_up.passed(plan, completed)),
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
            load_reading(context, sample)
        case ev.StageReading(sample=sample):
            stage_reading(context, sample)
        case ev.FrameScanned(info=info):
            _end_hold(context)
            frame_scanned(context, info)
        case ev.FieldOfViewMeasured() | ev.DriftForecastUpdated() | ev.HoldDriftMeasured() | ev.CalibrationAssessed():
            context.update(analysis=context.state.analysis.with_result(event))
        case ev.FrameUnreadable(export=export, reason=reason):
            frame_unreadable(context, export, reason)
        case ev.CommandAcknowledged(time_ns=time_ns, device=device):
            if context.state.state is State.RAMPING and context.state.motion.pending_devices[:1] == (device,):
                context.update(motion=replace(context.state.motion, acknowledged_ns=time_ns))
        case ev.OperatorAction(verb=verb, reason=reason):
            operator_command(context, verb, reason)
        case ev.LinksOpening():
            open_links(context)
        case ev.LinksReady():
            links_ready(context, event)
        case ev.LinkStale(device=device):
            context.update(devices=context.state.devices.with_stale(device))
        case ev.LinkLost(device=device, reason=reason):
            context.update(devices=context.state.devices.with_stale(device))
            context.fault(Cause.LINK_LOST, f"the link to the {device.words} is lost: {reason}", ("device", device.value))
        case ev.LinkRestored(device=device):
            context.announce(f"the {device.words} answers again")
        case ev.DeviceStopped(device=device, reason=reason):
            device_stopped(context, device, reason)
        case ev.DeviceFault(device=device, reason=reason, emergency=emergency, code=code):
            cause = Cause.EMERGENCY if emergency else Cause.DEVICE_FAULT
            context.fault(cause, f"{device.words}: {reason}", ("device", device.value), code=code)


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
            calibration.evaluate(context)
        case State.WARM_UP if not rest_fault(context):
            warm_up.evaluate(context)
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
    if calibration.is_closed(after):
        context.transition(Cause.CALIBRATION_CHECK)
        context.update(step_index=completed.step_index + 1)
        return
    if warm_up.is_closed(after):
        warm_up.enter(context, Cause.WARM_UP)
        context.update(step_index=completed.step_index + 1)
        return
    context.transition(Cause.NEXT_STEP)
    context.update(step_index=completed.step_index + 1)
    start_step(context)


def _check_stopped(context: StepContext) -> None:
    """In STOPPING: finish the run when every device has reported, after the stop, that it does not move.

    There is no timeout for a device that answers and still moves, because its link thread repeats the stop command; only ABORT ends it.
    """
    state = context.state
    unconfirmed = [d for d in state.devices.present if not _stopped_since(state.devices.sample(d), state.since_ns)]
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
    sample = state.devices.sample(device)
    return sample is not None and device not in state.devices.stale and sample.motion is MotionState.MOVING


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
