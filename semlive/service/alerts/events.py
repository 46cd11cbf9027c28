"""Events of a run that an alert reports: a pure function of the messages of its log."""

from __future__ import annotations

from dataclasses import dataclass

from pydantic import BaseModel

from semlive.data.faults import RESULT_FAULTS
from semlive.engine import Cause, State
from semlive.engine.states import FINAL_STATES
from semlive.formats.log.messages import FaultMessage, OperatorMessage, StateMessage
from semlive.inputs.printable import printable
from semlive.ports import PromptEvent
from semlive.service.config.sections import AlertEvent

_DECISIONS = {
    Cause.POOR_CALIBRATION: "the translations do not determine the distortion; the run is paused for a decision",
    Cause.WARM_UP_TIMEOUT: "the drift did not become slow enough in the maximum time of the warm-up; the run is paused for a decision",
}


@dataclass(frozen=True, slots=True)
class Alert:
    """What is sent.

    Attributes:
        event: kind of event.
        title: one line.
        text: the message.
    """

    event: AlertEvent
    title: str
    text: str


def alert_of(payload: BaseModel, run: str) -> Alert | None:
    """Return the alert about a message of the log; None if nobody needs to be called.

    Args:
        payload: a message of the log.
        run: name of the run.
    """
    match payload:
        case FaultMessage(kind=kind) if kind not in RESULT_FAULTS:
            return Alert(AlertEvent.FAULT, f"{run}: fault", printable(f"{payload.what} ({payload.where}). Reaction: {payload.action}."))
        case OperatorMessage(what=PromptEvent.PROMPT):
            return Alert(AlertEvent.QUESTION, f"{run}: question", printable(str(payload.args.get("text", ""))))
        case StateMessage(cause=cause) if cause in _DECISIONS:
            return Alert(AlertEvent.QUESTION, f"{run}: decision needed", _DECISIONS[Cause(cause)])
        case StateMessage(cause=Cause.WARMED_UP):
            return Alert(AlertEvent.WARM_UP, f"{run}: warm-up complete", "the drift is slow enough; the next step follows")
        case StateMessage(after=after) if after in FINAL_STATES:
            text = "all steps are done" if after == State.COMPLETE else "the run ended before its last step"
            return Alert(AlertEvent.END, f"{run}: {after}", f"{text}; load and position are held")
    return None
