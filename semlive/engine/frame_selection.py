"""Which exported frames are the pair of a step, and why the others are not."""

from __future__ import annotations

from semlive.data.frame import ColumnSettings, FrameInfo
from semlive.data.pair import PairDecision
from semlive.engine.commands import AcceptPair, RejectFrame, TriggerFrame
from semlive.engine.load_history import frame_load
from semlive.engine.motion import on_disturbance, rest_fault
from semlive.engine.state import EngineState, PendingFrame, StepContext
from semlive.engine.states import Cause, State

_SAME_WITHIN = 1e-3
"""Relative difference of dwell, row time or pixel size that is rounding in a header, not another setting."""

_OUTSIDE = {
    State.RAMPING: "load or stage were being set",
    State.SETTLING: "load and stage were settling",
    State.PAUSED: "the run was paused",
    State.FAULT: "the run was stopped by a fault",
    State.EMERGENCY_STOP: "the emergency stop was pressed",
    State.RESUMING: "the run was being recovered",
}


def _sigma_ns(info: FrameInfo) -> int:
    """Three standard uncertainties of the start time: what a frame has to prove it proves beyond that."""
    return round(3e9 * info.start_sigma_s)


def _earliest_ns(info: FrameInfo) -> int:
    return info.start_time_ns.value - _sigma_ns(info)


def _latest_end_ns(info: FrameInfo) -> int:
    return info.end_time_ns + _sigma_ns(info)


def frame_scanned(turn: StepContext, info: FrameInfo) -> None:
    """A frame was exported: let it wait for its verdict, or refuse it at once where no step is imaged."""
    turn.update(start_sigma_s=info.start_sigma_s)
    state = turn.state
    in_time = state.state is State.HOLDING and _earliest_ns(info) >= state.hold_end_ns
    if state.state is State.IMAGING or in_time:
        turn.update(pending_frames=(*state.pending_frames, PendingFrame(info, state.time_ns)))
    elif state.state is State.HOLDING:
        turn.commands.append(RejectFrame(info.export, _too_early(state, info)))
    else:
        why = _OUTSIDE.get(state.state, f"no step was being imaged (the run is {state.state})")
        turn.commands.append(RejectFrame(info.export, f"{info.name} is not used: {why} when it arrived"))


def frame_unreadable(turn: StepContext, export: int, reason: str) -> None:
    """A file cannot be used; in triggered mode another frame is asked for."""
    turn.commands.append(RejectFrame(export, reason))
    _ask_again(turn)


def select_pair(turn: StepContext) -> None:
    """In IMAGING: judge the waiting frames in order, as far as the load is known up to the end of their scans."""
    if turn.state.stale or rest_fault(turn) or on_disturbance(turn):
        return
    _ask_first(turn)
    while turn.state.state is State.IMAGING and turn.state.pending_frames:
        scanned = turn.state.pending_frames[0]
        if not _load_known(turn.state, scanned):
            return
        turn.update(pending_frames=turn.state.pending_frames[1:])
        reason = _problem(turn.state, scanned)
        if reason is not None:
            turn.commands.append(RejectFrame(scanned.info.export, reason))
            _ask_again(turn)
        elif turn.state.first is None:
            _take_first(turn, scanned.info)
        else:
            _take_second(turn, turn.state.first, scanned.info)


def _ask_first(turn: StepContext) -> None:
    """In triggered mode, ask for the first frame only when its start can be told from the end of the hold."""
    state = turn.state
    if state.plan.triggered and not state.frame_requested and state.time_ns >= state.hold_end_ns + round(3e9 * state.start_sigma_s):
        turn.update(frame_requested=True)
        turn.commands.append(TriggerFrame())


def _ask_again(turn: StepContext) -> None:
    if turn.state.frame_requested and turn.state.state is State.IMAGING:
        turn.commands.append(TriggerFrame())


def _load_known(state: EngineState, scanned: PendingFrame) -> bool:
    """Whether samples reach beyond the end of the scan (at the latest, it ended when it arrived)."""
    if state.load_frame is None:
        return True
    end_ns = min(_latest_end_ns(scanned.info), scanned.arrival_time_ns)
    return state.load is not None and state.load.time_ns >= end_ns


def _too_early(state: EngineState, info: FrameInfo) -> str:
    early_s = (state.hold_end_ns - _earliest_ns(info)) / 1e9
    return (
        f"{info.name} is not used: its scan may have begun {early_s:.1f} s before the hold of step {state.step.number} ended "
        f"(its start is known within {3 * info.start_sigma_s:g} s)"
    )


def difference(a: FrameInfo, b: FrameInfo) -> str | None:
    """What distinguishes two frames that should be of one kind, as words, or None."""
    if (a.width_px, a.height_px) != (b.width_px, b.height_px):
        return f"{b.width_px} x {b.height_px} px instead of {a.width_px} x {a.height_px}"
    if a.timing.integrations.value != b.timing.integrations.value:
        return f"{b.timing.integrations.value} integrated scans instead of {a.timing.integrations.value}"
    if a.timing.line_integrations.value != b.timing.line_integrations.value:
        return f"{b.timing.line_integrations.value} passes over each line instead of {a.timing.line_integrations.value}"
    for what, unit, one, other in (
        ("dwell time", "s", a.timing.dwell_time_s.value, b.timing.dwell_time_s.value),
        ("row time", "s", a.timing.row_time_s.value, b.timing.row_time_s.value),
        ("frame time", "s", a.timing.frame_time_s.value, b.timing.frame_time_s.value),
        ("pixel size", "m", a.pixel_size_m.value, b.pixel_size_m.value),
    ):
        if not abs(other - one) <= _SAME_WITHIN * abs(one):
            return f"{what} {other:g} {unit} instead of {one:g} {unit}"
    return _column_difference(a.column, b.column)


def _column_difference(a: ColumnSettings, b: ColumnSettings) -> str | None:
    """The same of how the microscope was set; what only one of the files tells is passed over."""
    if a.detector and b.detector and a.detector.value != b.detector.value:
        return f"detector {b.detector.value} instead of {a.detector.value}"
    for what, unit, one, other in (
        ("voltage", "V", a.voltage_v, b.voltage_v),
        ("magnification", "x", a.magnification, b.magnification),
        ("scan rotation", "degrees", a.scan_rotation_deg, b.scan_rotation_deg),
    ):
        if one and other and not abs(other.value - one.value) <= _SAME_WITHIN * max(abs(one.value), 1.0):
            return f"{what} {other.value:g} {unit} instead of {one.value:g} {unit}"
    return None


def _pair_difference(a: FrameInfo, b: FrameInfo) -> str | None:
    """What distinguishes the two frames of a pair; from step to step the focus may follow the specimen, within a pair it may not."""
    one, other = a.column.working_distance_m, b.column.working_distance_m
    if one and other and not abs(other.value - one.value) <= _SAME_WITHIN * one.value:
        return f"working distance {other.value:g} m instead of {one.value:g} m"
    return difference(a, b)


def _problem(state: EngineState, scanned: PendingFrame) -> str | None:
    """Why a frame is no part of the pair, as a sentence, or None."""
    info = scanned.info
    ahead_s = (info.end_time_ns - _sigma_ns(info) - scanned.arrival_time_ns) / 1e9
    if ahead_s > 0:
        return (
            f"{info.name} is not used: by its own time its scan ended {ahead_s:.1f} s after it arrived; "
            "set the SEM's clock, or start_anchor in the scan profile"
        )
    if _earliest_ns(info) < state.hold_end_ns:
        return _too_early(state, info)
    if state.reference is not None and (other := difference(state.reference, info)):
        return f"{info.name} is not used: it has {other} as in the first pair"
    if state.first is not None:
        overlap_s = (state.first.end_time_ns - _sigma_ns(state.first) - info.start_time_ns.value - _sigma_ns(info)) / 1e9
        if overlap_s > 0:
            return f"{info.name} is not used: it does not follow {state.first.name}, their scans overlap by {overlap_s:.1f} s"
    return None


def _take_first(turn: StepContext, info: FrameInfo) -> None:
    turn.update(first=info, since_ns=turn.state.time_ns)
    _ask_again(turn)


def _take_second(turn: StepContext, first: FrameInfo, second: FrameInfo) -> None:
    """Complete the pair, unless the settings of the SEM changed in between: then the second becomes the first."""
    if other := _pair_difference(first, second):
        turn.commands.append(RejectFrame(first.export, f"{first.name} is not used: the frame after it has {other}"))
        _take_first(turn, second)
        return
    state = turn.state
    loads = None
    if state.load_frame is not None:
        one, two = (frame_load(state.history, i.start_time_ns.value, i.end_time_ns) for i in (first, second))
        if one is None or two is None:
            turn.commands.append(RejectFrame(first.export, f"{first.name} is not used: the load during its scan is not known any more"))
            _take_first(turn, second)
            return
        loads = (one, two)
    turn.commands.append(AcceptPair(PairDecision(state.step.step, state.step, first, second, loads)))
    rested_s = (first.start_time_ns.value - state.hold_end_ns) / 1e9 + state.plan.hold.hold_s
    turn.update(first=None, reference=state.reference or first)
    turn.transition(Cause.PAIR_COMPLETE, ("first", first.export), ("second", second.export), ("rested_s", rested_s))
    turn.discard_frames("the pair of its step was complete")
