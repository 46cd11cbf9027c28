"""Alarms of a run: a pure function of the messages of its log, the same for control, live page, terminal and report.

Every `/fault` message is an alarm. Logs of earlier versions have none for a transition to FAULT or ESTOPPED that no device reported (an
exceeded limit, a timeout): there the transition is the alarm. An alarm is open until an `/operator` message acknowledges it. An
acknowledgement moves no device and does not resume the run.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

from pydantic import BaseModel, JsonValue

from semlive.data.faults import RESULT_FAULTS, FaultCode, FaultKind
from semlive.engine import Device, State
from semlive.engine.context import FAULT_OF_CAUSE
from semlive.formats.log.messages import FaultMessage, LogLineMessage, OperatorMessage, StateMessage, from_json
from semlive.formats.log.reader import LogMessage
from semlive.inputs.printable import printable

ACKNOWLEDGE = "acknowledge"
"""`what` of the `/operator` message that acknowledges an alarm; its `args` are `alarm` (identity) and `by`."""
TOPICS = frozenset({"/fault", "/state", "/operator", "/log"})
"""The topics that alarms are derived from."""
PRESS_STOP = "THE MACHINE DOES NOT OBEY ITS STOP: press the machine's own emergency stop now"
_MAX_ALARMS = 500
# A transition and the fault that caused it have the same time.
_SAME_NS = 50_000_000
# Longest time between a transition and the messages about it; a simulated clock can be 40 times as fast as the computer's.
_SOON_NS = 5_000_000_000
_PROTOCOL = "protocol"
_TROUBLE = (State.FAULT, State.EMERGENCY_STOP)
_DEVICES = frozenset(device.words for device in Device)
_STOPPED = "motion was stopped and is held"


class AlarmLevel(StrEnum):
    """Urgency of an alarm."""

    DANGER = "danger"
    """The specimen or the data are in danger, or the run does not continue: a person must act."""
    ATTENTION = "attention"
    """Results of the run may be incomplete or biased, and the run continues: to be checked before they are used."""


@dataclass(frozen=True, slots=True)
class Alarm:
    """A fault that requires the attention of the operator.

    Attributes:
        time_ns: experiment time, UTC ns.
        code: a `FaultCode`; empty if the log has none.
        text: description of the fault.
        where: component that the fault concerns.
        action: reaction of semlive.
        acknowledged_ns: time of the acknowledgement; None while the alarm is open.
        acknowledged_by: origin of the acknowledgement.
        kind: a `FaultKind`; empty if there is none.
    """

    time_ns: int
    code: str
    text: str
    where: str
    action: str
    acknowledged_ns: int | None = None
    acknowledged_by: str = ""
    kind: str = ""

    @property
    def identity(self) -> str:
        """Identity in acknowledgements; alarms of the same time share it."""
        return str(self.time_ns)

    @property
    def acknowledged(self) -> bool:
        """Whether a person has acknowledged it."""
        return self.acknowledged_ns is not None

    @property
    def level(self) -> AlarmLevel:
        """Urgency, from the kind of the fault; an alarm of unknown kind is a danger."""
        return AlarmLevel.ATTENTION if self.kind in RESULT_FAULTS else AlarmLevel.DANGER

    @property
    def disobeyed(self) -> bool:
        """Whether the machine continues to move after the stop commands."""
        return self.code == FaultCode.STOP_NOT_OBEYED


@dataclass(frozen=True, slots=True)
class Alarms:
    """Alarms of a run so far.

    Attributes:
        listed: alarms in order of time. If there are too many, acknowledged ones are removed first, then the oldest.
        forgotten: number of alarms that were removed from `listed`.
        provisional: the last alarm was derived from a transition; a `/fault` message about the same event replaces it.
        lacks_text: the text of that transition has not been logged yet.
    """

    listed: tuple[Alarm, ...] = ()
    forgotten: int = 0
    provisional: bool = False
    lacks_text: bool = False

    @property
    def open(self) -> tuple[Alarm, ...]:
        """Alarms without an acknowledgement."""
        return tuple(alarm for alarm in self.listed if not alarm.acknowledged)


@dataclass(frozen=True, slots=True)
class AcknowledgeAll:
    """Command of the operator that acknowledges every alarm."""

    by: str = ""


def acknowledgements(alarms: Alarms, identity: str | None, by: str, time_ns: int) -> tuple[OperatorMessage, ...]:
    """Return the messages that acknowledge one or all open alarms; empty if there is no open alarm.

    Args:
        alarms: alarms of the run so far.
        identity: identity of the alarm; None for all.
        by: origin of the request.
        time_ns: experiment time.
    """
    identities = dict.fromkeys(alarm.identity for alarm in alarms.open if identity in (None, alarm.identity))
    source: dict[str, JsonValue] = {"by": by} if by else {}
    return tuple(OperatorMessage(time_ns=time_ns, what=ACKNOWLEDGE, args={"alarm": alarm, **source}) for alarm in identities)


def after(alarms: Alarms, payload: BaseModel) -> Alarms:
    """Return the alarms after one more message; the same object if the message changes nothing."""
    match payload:
        case FaultMessage():
            return _fault(alarms, payload)
        case StateMessage(before=before, after=entered) if entered in _TROUBLE and before != entered:
            return _transition(alarms, payload)
        case LogLineMessage(level="info") if alarms.lacks_text and payload.time_ns - alarms.listed[-1].time_ns <= _SOON_NS:
            return replace(_last(alarms, replace(alarms.listed[-1], text=printable(payload.text))), lacks_text=False)
        case OperatorMessage(what="acknowledge"):
            return _acknowledge(alarms, payload)
    return alarms


def after_message(alarms: Alarms, message: LogMessage) -> Alarms:
    """Return the alarms after one more message of a log.

    Raises:
        BadLog: the message does not agree with its topic.
    """
    return after(alarms, from_json(message.topic, message.payload)) if message.topic in TOPICS else alarms


def _fault(alarms: Alarms, message: FaultMessage) -> Alarms:
    alarm = Alarm(
        message.time_ns,
        message.code or _code_of(message.where),
        printable(message.what),
        printable(message.where),
        printable(message.action),
        kind=message.kind,
    )
    last = alarms.listed[-1] if alarms.listed else None
    late_ns = _SOON_NS if last is not None and last.code == message.code else _SAME_NS
    if last is not None and alarms.provisional and abs(message.time_ns - last.time_ns) <= late_ns:
        return replace(_last(alarms, alarm), provisional=False, lacks_text=False)
    if last is not None and _judged_twice(last, alarm):
        return alarms
    return _added(replace(alarms, provisional=False, lacks_text=False), alarm)


def _judged_twice(last: Alarm, alarm: Alarm) -> bool:
    """Merge limit alarms of link thread and protocol, which both check the same reading."""
    soon = abs(alarm.time_ns - last.time_ns) <= _SOON_NS
    return soon and last.code == alarm.code and not last.acknowledged and (last.where == _PROTOCOL) != (alarm.where == _PROTOCOL)


def _transition(alarms: Alarms, message: StateMessage) -> Alarms:
    code = FAULT_OF_CAUSE.get(message.cause, FaultCode.EMERGENCY_STOP if message.after == State.EMERGENCY_STOP else FaultCode.DEVICE_FAULT)
    last = alarms.listed[-1] if alarms.listed else None
    if last is not None and abs(message.time_ns - last.time_ns) <= _SAME_NS:
        # A device reported it; before faults had codes, only the transition shows that it was an emergency stop.
        vague = last.code in ("", FaultCode.DEVICE_FAULT) and code is FaultCode.EMERGENCY_STOP
        return _last(alarms, replace(last, code=code)) if vague else alarms
    text = "emergency stop or limit switch" if message.after == State.EMERGENCY_STOP else "fault"
    return replace(
        _added(alarms, Alarm(message.time_ns, code, f"{text} ({message.cause})", "run", _STOPPED, kind=FaultKind.RUN)),
        provisional=True,
        lacks_text=True,
    )


def _acknowledge(alarms: Alarms, message: OperatorMessage) -> Alarms:
    identity, by = message.args.get("alarm"), printable(str(message.args.get("by", "")))
    if not any(alarm.identity == identity for alarm in alarms.open):
        return alarms
    done = (
        replace(alarm, acknowledged_ns=message.time_ns, acknowledged_by=by)
        if alarm.identity == identity and not alarm.acknowledged
        else alarm
        for alarm in alarms.listed
    )
    return replace(alarms, listed=tuple(done))


def _last(alarms: Alarms, alarm: Alarm) -> Alarms:
    return replace(alarms, listed=(*alarms.listed[:-1], alarm))


def _added(alarms: Alarms, alarm: Alarm) -> Alarms:
    all_alarms = (*alarms.listed, alarm)
    if len(all_alarms) <= _MAX_ALARMS:
        return replace(alarms, listed=all_alarms)
    # An open alarm about a disobeyed stop is always retained.
    discarded = min(all_alarms, key=lambda item: (not item.acknowledged, item.disobeyed and not item.acknowledged, item.time_ns))
    return replace(alarms, listed=tuple(item for item in all_alarms if item is not discarded), forgotten=alarms.forgotten + 1)


def _code_of(where: str) -> str:
    """Return the code of a fault from its origin, for logs without fault codes."""
    if where in _DEVICES:
        return FaultCode.DEVICE_FAULT
    if where == "log":
        return FaultCode.LOG
    return FaultCode.ANALYSIS if where == "analysis" or where.startswith("pair ") else ""
