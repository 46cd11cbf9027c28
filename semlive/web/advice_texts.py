"""What to do, in words: one sentence for each reason for which a run waits for its operator."""

from __future__ import annotations

from collections.abc import Mapping

from semlive.data.faults import FaultCode, FaultKind
from semlive.engine import Cause, State

_AGAIN = "press Resume, which asks once more before anything moves"
_FAULTS: Mapping[str, str] = {
    Cause.LIMIT: f"Motion was stopped and is held. Look at specimen and load frame; if both are sound, {_AGAIN}. Stop ends the run.",
    Cause.LINK_LOST: f"Make sure that the machine rests. See to cable, power and adapter; when the device answers again, {_AGAIN}.",
    Cause.DEVICE_FAULT: f"Motion was stopped and is held. Clear the trouble at the device, then {_AGAIN}.",
    Cause.DEVICE_STOPPED: f"The device was stopped. Look why, then {_AGAIN}.",
    Cause.NOT_REACHED: f"Look whether something slips or is blocked, and whether the tolerance is too tight, then {_AGAIN}.",
    Cause.MOTION_TIMEOUT: f"Look whether the device moves at all, then {_AGAIN}.",
    Cause.FRAME_TIMEOUT: f"Look whether the SEM scans and saves into the export folder, then {_AGAIN}.",
}
_STATES: Mapping[str, str] = {
    State.READY: "Waiting for a fresh reading of the devices; it starts by itself, or with Start.",
    State.PAUSED: "Motion is held. Resume enters the step again with its hold in full; Stop ends the run.",
    State.FAULT: f"Motion was stopped and is held. Look at the machine, then {_AGAIN}. Stop ends the run.",
    State.EMERGENCY_STOP: f"The emergency stop or a limit switch acted. Release it at the machine when it is safe, then {_AGAIN}.",
    State.RESUMING: "Compare load and stage with what is written here; Resume goes on from the step's motion, Stop ends the run.",
    State.ABORTED: "The run has ended; what was measured is in the log. semlive run --resume takes it up again.",
}
QUESTION_STATES = frozenset({State.PAUSED, State.FAULT, State.EMERGENCY_STOP, State.RESUMING})
"""States in which nothing goes on without the operator."""


def advice(state: str, cause: str) -> str:
    """What to do in a state that was entered for a cause; empty if nothing."""
    if state == State.FAULT and cause in _FAULTS:
        return _FAULTS[cause]
    if state == State.PAUSED and cause == Cause.POOR_CALIBRATION:
        return "Nothing was loaded. Stop, and begin a run with the translations that are missing; Resume loads the specimen all the same."
    if state == State.PAUSED and cause == Cause.WARM_UP_TIMEOUT:
        return "The drift did not slow down in time. Resume loads the specimen all the same; waiting longer is Pause left as it is."
    return _STATES.get(state, "")


def advice_for(kind: str, code: str = "") -> str:
    """What to do about a fault of a `FaultKind` and a `FaultCode`; empty if nothing is to be done."""
    if code == FaultCode.STOP_NOT_OBEYED:
        return "Press the machine's own emergency stop now. Acknowledge when it rests."
    if kind == FaultKind.LOG:
        return "Make room on the disk; when the log keeps up again, Resume."
    if kind == FaultKind.EXPORT_FOLDER:
        return "See to the share that holds the export folder."
    if kind in (FaultKind.DEVICE, FaultKind.RUN):
        return "Where the run waits for you, the bar above says what to do."
    if kind == FaultKind.ANALYSIS:
        return "Nothing: recording goes on, and results catch up."
    return ""
