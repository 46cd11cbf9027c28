"""Selection of the two exported frames that form the pair of a step, with a reason for each rejected frame."""

from __future__ import annotations

from dataclasses import replace

from semlive.data.frame import ColumnSettings, FrameInfo
from semlive.data.pair import PairDecision
from semlive.data.scan import geometry_difference
from semlive.engine.commands import AcceptPair, RejectFrame, TriggerFrame
from semlive.engine.context import StepContext
from semlive.engine.load_history import frame_load
from semlive.engine.motion import on_disturbance
from semlive.engine.state import EngineState, PendingFrame
from semlive.engine.states import Cause, State
from semlive.engine.tolerances import rest_fault

_RELATIVE_TOLERANCE = 1e-3
"""Relative difference of dwell time, row time or pixel size that is attributed to rounding in the header."""

_REJECTION_REASONS = {
    State.RAMPING: "load or stage were being set",
    State.SETTLING: "load and stage were settling",
    State.PAUSED: "the run was paused",
    State.FAULT: "the run was stopped by a fault",
    State.EMERGENCY_STOP: "the emergency stop was pressed",
    State.RESUMING: "the run was being recovered",
}


def _sigma_ns(info: FrameInfo) -> int:
    """Return three standard uncertainties of the start time, ns: the safety margin in all comparisons of scan times."""
    return round(3e9 * info.start_sigma_s)


def _earliest_ns(info: FrameInfo) -> int:
    return info.start_time_ns.value - _sigma_ns(info)


def _latest_end_ns(info: FrameInfo) -> int:
    return info.end_time_ns + _sigma_ns(info)


def frame_scanned(context: StepContext, info: FrameInfo) -> None:
    """Queue an exported frame for selection, or reject it at once if no step is being imaged."""
    context.update(imaging=replace(context.state.imaging, start_sigma_s=info.start_sigma_s))
    state = context.state
    after_hold = state.state is State.HOLDING and _earliest_ns(info) >= state.hold.end_ns
    if state.state is State.IMAGING or after_hold:
        pending = (*state.imaging.pending, PendingFrame(info, state.time_ns))
        context.update(imaging=replace(state.imaging, pending=pending))
    elif state.state is State.HOLDING:
        context.commands.append(RejectFrame(info.export, _early_reason(state, info)))
    else:
        reason = _REJECTION_REASONS.get(state.state, f"no step was being imaged (the run is {state.state})")
        context.commands.append(RejectFrame(info.export, f"{info.name} is not used: {reason} when it arrived"))


def frame_unreadable(context: StepContext, export: int, reason: str) -> None:
    """Reject an unreadable file; in triggered mode, request another frame."""
    context.commands.append(RejectFrame(export, reason))
    _request_next(context)


def select_pair(context: StepContext) -> None:
    """In IMAGING: evaluate the pending frames in order, as far as load samples reach the end of their scans."""
    if context.state.devices.stale or rest_fault(context) or on_disturbance(context):
        return
    _request_first(context)
    while context.state.state is State.IMAGING and context.state.imaging.pending:
        scanned, *pending = context.state.imaging.pending
        if not _load_available(context.state, scanned):
            return
        context.update(imaging=replace(context.state.imaging, pending=tuple(pending)))
        reason = _rejection_reason(context.state, scanned)
        if reason is not None:
            context.commands.append(RejectFrame(scanned.info.export, reason))
            _request_next(context)
        elif context.state.imaging.first is None:
            _set_first(context, scanned.info)
        else:
            _complete_pair(context, context.state.imaging.first, scanned.info)


def _request_first(context: StepContext) -> None:
    """In triggered mode, request the first frame once its start is distinguishable from the end of the hold."""
    state = context.state
    if (
        state.plan.triggered
        and not state.imaging.frame_requested
        and state.time_ns >= state.hold.end_ns + round(3e9 * state.imaging.start_sigma_s)
    ):
        context.update(imaging=replace(state.imaging, frame_requested=True))
        context.commands.append(TriggerFrame())


def _request_next(context: StepContext) -> None:
    if context.state.imaging.frame_requested and context.state.state is State.IMAGING:
        context.commands.append(TriggerFrame())


def _load_available(state: EngineState, scanned: PendingFrame) -> bool:
    """Whether load samples reach the end of the scan; the arrival time of the frame is the latest possible end."""
    if state.devices.load_frame is None:
        return True
    end_ns = min(_latest_end_ns(scanned.info), scanned.arrival_time_ns)
    return state.devices.load is not None and state.devices.load.time_ns >= end_ns


def _early_reason(state: EngineState, info: FrameInfo) -> str:
    early_s = (state.hold.end_ns - _earliest_ns(info)) / 1e9
    return (
        f"{info.name} is not used: its scan may have begun {early_s:.1f} s before the hold of step {state.step.number} ended "
        f"(its start is known within {3 * info.start_sigma_s:g} s)"
    )


def difference(a: FrameInfo, b: FrameInfo) -> str | None:
    """Return the first difference in size, timing, column or scan settings of two frames, as a clause; None if there is none."""
    if (a.width_px, a.height_px) != (b.width_px, b.height_px):
        return f"{b.width_px} x {b.height_px} px instead of {a.width_px} x {a.height_px}"
    if a.timing.integrations.value != b.timing.integrations.value:
        return f"{b.timing.integrations.value} integrated scans instead of {a.timing.integrations.value}"
    if a.timing.line_integrations.value != b.timing.line_integrations.value:
        return f"{b.timing.line_integrations.value} passes over each line instead of {a.timing.line_integrations.value}"
    for quantity, unit, value_a, value_b in (
        ("dwell time", "s", a.timing.dwell_time_s.value, b.timing.dwell_time_s.value),
        ("row time", "s", a.timing.row_time_s.value, b.timing.row_time_s.value),
        ("frame time", "s", a.timing.frame_time_s.value, b.timing.frame_time_s.value),
        ("pixel size", "m", a.pixel_size_m.value, b.pixel_size_m.value),
    ):
        if not abs(value_b - value_a) <= _RELATIVE_TOLERANCE * abs(value_a):
            return f"{quantity} {value_b:g} {unit} instead of {value_a:g} {unit}"
    return _column_difference(a.column, b.column) or geometry_difference(a.geometry, b.geometry)


def _column_difference(a: ColumnSettings, b: ColumnSettings) -> str | None:
    """Return the first difference in column settings, as a clause, or None; settings that only one file states are ignored."""
    if a.detector and b.detector and a.detector.value != b.detector.value:
        return f"detector {b.detector.value} instead of {a.detector.value}"
    for quantity, unit, value_a, value_b in (
        ("voltage", "V", a.voltage_v, b.voltage_v),
        ("magnification", "x", a.magnification, b.magnification),
        ("scan rotation", "degrees", a.scan_rotation_deg, b.scan_rotation_deg),
    ):
        if value_a and value_b and not abs(value_b.value - value_a.value) <= _RELATIVE_TOLERANCE * max(abs(value_a.value), 1.0):
            return f"{quantity} {value_b.value:g} {unit} instead of {value_a.value:g} {unit}"
    return None


def _pair_difference(a: FrameInfo, b: FrameInfo) -> str | None:
    """Return the first difference of the two frames of a pair, as a clause, or None.

    The working distance must be equal within a pair; it may change between steps.
    """
    distance_a, distance_b = a.column.working_distance_m, b.column.working_distance_m
    if distance_a and distance_b and not abs(distance_b.value - distance_a.value) <= _RELATIVE_TOLERANCE * distance_a.value:
        return f"working distance {distance_b.value:g} m instead of {distance_a.value:g} m"
    return difference(a, b)


def _rejection_reason(state: EngineState, scanned: PendingFrame) -> str | None:
    """Return why a frame is not part of the pair, as one message; None if it is."""
    info = scanned.info
    ahead_s = (info.end_time_ns - _sigma_ns(info) - scanned.arrival_time_ns) / 1e9
    if ahead_s > 0:
        return (
            f"{info.name} is not used: by its own time its scan ended {ahead_s:.1f} s after it arrived; "
            "set the SEM's clock, or start_anchor in the scan profile"
        )
    if _earliest_ns(info) < state.hold.end_ns:
        return _early_reason(state, info)
    if state.imaging.reference is not None and (mismatch := difference(state.imaging.reference, info)):
        return f"{info.name} is not used: it has {mismatch} as in the first pair"
    if state.imaging.first is not None:
        overlap_s = (state.imaging.first.end_time_ns - _sigma_ns(state.imaging.first) - info.start_time_ns.value - _sigma_ns(info)) / 1e9
        if overlap_s > 0:
            return f"{info.name} is not used: it does not follow {state.imaging.first.name}, their scans overlap by {overlap_s:.1f} s"
    return None


def _set_first(context: StepContext, info: FrameInfo) -> None:
    context.accept_first_frame(info)
    _request_next(context)


def _complete_pair(context: StepContext, first: FrameInfo, second: FrameInfo) -> None:
    """Complete the pair; if the settings of the SEM changed between the frames, the second frame becomes the first."""
    if mismatch := _pair_difference(first, second):
        context.commands.append(RejectFrame(first.export, f"{first.name} is not used: the frame after it has {mismatch}"))
        _set_first(context, second)
        return
    state = context.state
    loads = None
    if state.devices.load_frame is not None:
        first_load, second_load = (frame_load(state.devices.history, i.start_time_ns.value, i.end_time_ns) for i in (first, second))
        if first_load is None or second_load is None:
            context.commands.append(RejectFrame(first.export, f"{first.name} is not used: the load during its scan is not known any more"))
            _set_first(context, second)
            return
        loads = (first_load, second_load)
    context.commands.append(AcceptPair(PairDecision(state.step.step, state.step, first, second, loads)))
    stationary_s = (first.start_time_ns.value - state.hold.end_ns) / 1e9 + state.plan.hold.hold_s
    context.update(imaging=replace(state.imaging, first=None, reference=state.imaging.reference or first))
    context.transition(Cause.PAIR_COMPLETE, ("first", first.export), ("second", second.export), ("rested_s", stationary_s))
    context.discard_frames("the pair of its step was complete")
