"""The protocol as a pure function: ``step(state, event) -> (state, commands)``.

Every event goes the same way: time is taken over, the event's own handler speaks, then the state looks at what it waits for.
"""

from __future__ import annotations

from dataclasses import replace

from semlive.data.experiment import Plan
from semlive.data.loading import LoadSample, MotionState, StageSample
from semlive.engine import events as ev
from semlive.engine.commands import Command, Finish, StopMotion
from semlive.engine.events import Device, Event, Verb
from semlive.engine.frames import frame_scanned, frame_unreadable, judge
from semlive.engine.history import LoadHistory
from semlive.engine.limits import plan_problem, sample_problem, tightened
from semlive.engine.motion import advance, begin_step, hold, settle
from semlive.engine.states import FINAL_STATES, Cause, State
from semlive.engine.turn import EngineState, Turn
from semlive.errors import BadInput

STOP_TIMEOUT_S = 60.0
"""Experiment seconds to wait for the devices' word that they stopped, before the run ends without it."""


def start(plan: Plan, now_ns: int, *, next_step: int = 0) -> EngineState:
    """The state before anything has happened.

    Args:
        plan: what is to be done.
        now_ns: experiment time.
        next_step: index of the first step to be done; more than 0 continues a run, and asks before anything moves.

    Raises:
        BadInput: if the plan has no such step, or breaks its own limits.
    """
    if not 0 <= next_step < len(plan.steps):
        raise BadInput(f"the plan has {len(plan.steps)} steps, none of index {next_step}; give it at least one step to do")
    problem = plan_problem(plan, plan.limits, next_step)
    if problem is not None:
        raise BadInput(f"the plan breaks its limits in {problem}; change the plan or the limits")
    keep_s = 2 * plan.hold.frame_timeout_s + plan.hold.hold_s
    return EngineState(
        plan=plan,
        limits=plan.limits,
        at=State.IDLE,
        step_index=next_step,
        time_ns=now_ns,
        since_ns=now_ns,
        history=LoadHistory(keep_ns=round(keep_s * 1e9)),
        shift_at_um=(0.0, 0.0) if next_step == 0 else None,
    )


def step(state: EngineState, event: Event) -> tuple[EngineState, tuple[Command, ...]]:
    """What follows from an event.

    Raises:
        ImpossibleTransition: never, unless the engine itself is wrong.
    """
    if state.at in FINAL_STATES:
        return state, ()
    turn = Turn(replace(state, time_ns=max(state.time_ns, event.time_ns)))
    _hear(turn, event)
    _look(turn)
    return turn.state, tuple(turn.commands)


def _hear(turn: Turn, event: Event) -> None:
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
        case ev.FieldSeen():
            turn.update(seen=event)
        case ev.FrameUnreadable(export=export, reason=reason):
            frame_unreadable(turn, export, reason)
        case ev.CommandTaken(time_ns=time_ns, device=device):
            if turn.state.at is State.RAMPING and turn.state.motion.todo[:1] == (device,):
                turn.update(motion=replace(turn.state.motion, taken_ns=time_ns))
        case ev.Operator(verb=verb):
            _operator(turn, verb)
        case ev.Opening():
            turn.go(Cause.OPENING) if turn.allows(Cause.OPENING) else None
        case ev.Ready():
            _ready(turn, event)
        case ev.LinkStale(device=device):
            turn.update(stale=turn.state.stale | {device})
        case ev.LinkLost(device=device, reason=reason):
            turn.update(stale=turn.state.stale | {device})
            turn.fault(Cause.LINK_LOST, f"the link to the {device.words} is lost: {reason}", ("device", device.value))
        case ev.LinkBack(device=device):
            turn.say(f"the {device.words} answers again")
        case ev.DeviceStopped(device=device, reason=reason):
            turn.fault(Cause.DEVICE_STOPPED, f"the {device.words} was stopped: {reason}", ("device", device.value))
        case ev.DeviceFault(device=device, reason=reason, emergency=emergency):
            cause = Cause.EMERGENCY if emergency else Cause.DEVICE_FAULT
            turn.fault(cause, f"{device.words}: {reason}", ("device", device.value))


def _wait_over(turn: Turn) -> None:
    """A frame may arrive at the very instant that ends the hold: let the hold end first."""
    if turn.state.at is State.HOLDING:
        hold(turn)


def _look(turn: Turn) -> None:
    """What the state waits for."""
    _timeouts(turn)
    match turn.state.at:
        case State.RAMPING:
            advance(turn)
        case State.SETTLING:
            settle(turn)
        case State.HOLDING:
            hold(turn)
        case State.IMAGING:
            judge(turn)
        case State.STOPPING:
            _stopping(turn)
    if turn.state.at is State.STEP_DONE:
        _step_done(turn)


def _step_done(turn: Turn) -> None:
    """On to the next step, or the end: load and position stay as they are."""
    if turn.state.step_index + 1 == len(turn.state.plan.steps):
        turn.finish(Cause.LAST_STEP, f"all {len(turn.state.plan.steps)} steps are done; load and position are held")
        return
    turn.go(Cause.NEXT_STEP)
    turn.update(step_index=turn.state.step_index + 1)
    begin_step(turn)


def _load_reading(turn: Turn, sample: LoadSample) -> None:
    state = turn.state
    turn.update(
        load=sample,
        stale=state.stale - {Device.LOAD_FRAME},
        history=state.history.with_sample(sample.time_ns, sample.force_n, sample.gage_strain),
    )
    problem = sample_problem(state.limits, sample)
    if problem is not None and turn.allows(Cause.LIMIT):
        guards = (("force_n", sample.force_n), ("extension_mm", sample.extension_mm), ("sequence", sample.sequence))
        turn.fault(Cause.LIMIT, problem, *guards)
    _motion_word(turn, Device.LOAD_FRAME, sample.motion)


def _stage_reading(turn: Turn, sample: StageSample) -> None:
    state = turn.state
    turn.update(
        position=sample,
        stale=state.stale - {Device.STAGE},
        origin_um=state.origin_um or (sample.x_um, sample.y_um),
    )
    _motion_word(turn, Device.STAGE, sample.motion)


def _motion_word(turn: Turn, device: Device, motion: MotionState) -> None:
    """A device that says it is in trouble is believed."""
    if motion is MotionState.FAULT and turn.allows(Cause.DEVICE_FAULT):
        turn.fault(Cause.DEVICE_FAULT, f"the {device.words} says that it is in fault; look at it, then resume", ("device", device.value))


def _ready(turn: Turn, event: ev.Ready) -> None:
    cause = Cause.LINKED if turn.state.step_index == 0 else Cause.LINKED_AGAIN
    if not turn.allows(cause):
        return
    limits = tightened(turn.state.plan.limits, event.load_frame)
    turn.update(load_frame=event.load_frame, stage=event.stage, limits=limits)
    problem = plan_problem(turn.state.plan, limits, turn.state.step_index)
    if problem is not None:
        turn.fault(Cause.LIMIT, f"the plan breaks the load frame's own limit in {problem}")
        return
    turn.go(cause)
    if turn.state.at is State.RECOVER:
        _ask_to_resume(turn)


def _ask_to_resume(turn: Turn) -> None:
    """Say what resuming will do."""
    now = turn.state
    load = "" if now.step.load_n is None else f" and the load to {now.step.load_n:g} N"
    x, y = now.step.shift_um
    turn.say(f"resume sets the stage to ({x:g}, {y:g}) um{load} and begins step {now.step_index + 1} again; or stop")


def _not_fit_to_move(state: EngineState) -> str | None:
    """Why motion must not begin now, as words, or None."""
    for device in state.devices:
        sample = state.sample(device)
        if sample is None or device in state.stale:
            return f"the {device.words} gives no fresh reading"
        if sample.motion is not MotionState.STOPPED:
            return f"the {device.words} is {sample.motion}"
    return None if state.load is None else sample_problem(state.limits, state.load)


def _operator(turn: Turn, verb: Verb) -> None:
    """What the operator says, where the table knows it; elsewhere only an answer."""
    cause = Cause(verb.value)
    at = turn.state.at
    if not turn.allows(cause):
        turn.say(f"cannot {verb} while {at}")
    elif verb in (Verb.START, Verb.RESUME):
        problem = _not_fit_to_move(turn.state)
        if problem is not None:
            turn.say(f"cannot {verb}: {problem}")
            return
        turn.go(cause)
        begin_step(turn) if turn.state.at is State.RAMPING else _ask_to_resume(turn)
    elif verb is Verb.ABORT:
        turn.stop_and_go(cause, f"aborted by the operator while {at}")
        turn.commands.append(Finish(turn.state.at, turn.state.message))
    else:
        words = "paused" if verb is Verb.PAUSE else "stopped"
        turn.stop_and_go(cause, f"{words} by the operator while {at}")


def _stopping(turn: Turn) -> None:
    """In STOPPING: end when every device says, after the stop, that it does not move."""
    state = turn.state
    samples = tuple(state.sample(device) for device in state.devices)
    if all(s is not None and s.time_ns > state.since_ns and s.motion is not MotionState.MOVING for s in samples):
        turn.finish(Cause.AT_REST, "the run was stopped; load and position are held")
    elif state.seconds_since(state.since_ns) > STOP_TIMEOUT_S:
        turn.commands.append(StopMotion("the stop was not confirmed"))
        turn.finish(Cause.STOP_UNCONFIRMED, "the run was stopped, but not every device confirmed that it rests: look at the machine")


def _timeouts(turn: Turn) -> None:
    state = turn.state
    rule = state.plan.hold
    if state.at in (State.RAMPING, State.SETTLING) and state.seconds_since(state.motion.began_ns) > rule.motion_timeout_s:
        reason = f"step {state.step.step} has not settled for {rule.motion_timeout_s:g} s"
        turn.fault(Cause.MOTION_TIMEOUT, reason, ("waited_s", state.seconds_since(state.motion.began_ns)))
    elif state.at is State.IMAGING and state.seconds_since(state.since_ns) > rule.frame_timeout_s:
        reason = f"no frame for step {state.step.step} for {rule.frame_timeout_s:g} s: is the SEM scanning, and exporting into the folder?"
        turn.fault(Cause.FRAME_TIMEOUT, reason, ("waited_s", state.seconds_since(state.since_ns)))
