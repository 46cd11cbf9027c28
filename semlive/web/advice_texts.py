"""Advice for the operator: one text for each reason for which a run waits."""

from __future__ import annotations

from collections.abc import Mapping

from semlive.data.faults import FaultCode, FaultKind
from semlive.engine import Cause, State

_RESUME = "press Resume; a confirmation is required before anything moves"
_FAULTS: Mapping[str, str] = {
    Cause.LIMIT: f"Motion was stopped and is held. Check specimen and load frame; if both are intact, {_RESUME}. Stop ends the run.",
    Cause.LINK_LOST: f"Make sure that the machine does not move. Check cable, power and adapter; when the device replies again, {_RESUME}.",
    Cause.DEVICE_FAULT: f"Motion was stopped and is held. Correct the fault at the device, then {_RESUME}.",
    Cause.DEVICE_STOPPED: f"The device was stopped. Find the reason, then {_RESUME}.",
    Cause.NOT_REACHED: f"Check whether the specimen slips, a device is blocked, or the tolerance is too small, then {_RESUME}.",
    Cause.MOTION_TIMEOUT: f"Check whether the device moves, then {_RESUME}.",
    Cause.FRAME_TIMEOUT: f"Check whether the SEM scans and saves into the export folder, then {_RESUME}.",
}
_STATES: Mapping[str, str] = {
    State.READY: "Waiting for a new reading of the devices; the run starts automatically, or with Start.",
    State.PAUSED: "Motion is held. Resume repeats the step with its complete hold; Stop ends the run.",
    State.FAULT: f"Motion was stopped and is held. Check the machine, then {_RESUME}. Stop ends the run.",
    State.EMERGENCY_STOP: f"The emergency stop or a limit switch is active. Release it at the machine when it is safe, then {_RESUME}.",
    State.RESUMING: "Compare load and stage with the values shown here; Resume continues with the motion of the step, Stop ends the run.",
    State.ABORTED: "The run has ended; the log contains all measurements. semlive run --resume continues it.",
}
QUESTION_STATES = frozenset({State.PAUSED, State.FAULT, State.EMERGENCY_STOP, State.RESUMING})
"""States in which the run waits for the operator."""


def advice(state: str, cause: str) -> str:
    """Advice for a state and the cause of its transition; empty if no action is needed."""
    if state == State.FAULT and cause in _FAULTS:
        return _FAULTS[cause]
    if state == State.PAUSED and cause == Cause.POOR_CALIBRATION:
        return "The specimen was not loaded. Stop, and start a run with the missing translations; Resume loads the specimen without them."
    if state == State.PAUSED and cause == Cause.WARM_UP_TIMEOUT:
        return "The drift did not become slow enough in time. Resume loads the specimen anyway; to wait longer, leave the run paused."
    return _STATES.get(state, "")


def advice_for(kind: str, code: str = "") -> str:
    """Advice for a fault by its `FaultKind` and `FaultCode`; empty if there is none beyond the reaction of semlive."""
    if code == FaultCode.STOP_NOT_OBEYED:
        return "Press the machine's own emergency stop now. Acknowledge when the machine has stopped."
    if kind == FaultKind.LOG:
        return "Free space on the disk; when the log is written again, press Resume."
    if kind == FaultKind.EXPORT_FOLDER:
        return "Check the network share of the export folder."
    if kind in (FaultKind.DEVICE, FaultKind.RUN):
        return "If the run waits for the operator, the bar above shows what to do."
    if kind == FaultKind.ANALYSIS:
        return "No action is needed: recording continues, and the results follow later."
    return ""
