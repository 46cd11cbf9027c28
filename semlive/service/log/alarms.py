"""Alarms of a run: a pure function of the messages of its log, the same for control, live page, terminal and report.

Every `/fault` message is an alarm. Logs of earlier versions have none for a transition to FAULT or ESTOPPED that no device reported (an
exceeded limit, a time-out): there the transition is the alarm. An alarm is open until an `/operator` message acknowledges it, which moves
and resumes nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from pydantic import BaseModel, JsonValue

from semlive.data.faults import FaultCode
from semlive.data.text import printable
from semlive.engine import Device, State
from semlive.engine.state import FAULT_OF_CAUSE
from semlive.formats.log.messages import FaultMessage, LogLineMessage, OperatorMessage, StateMessage, from_json
from semlive.formats.log.writer import LogMessage

ACKNOWLEDGE = "acknowledge"
"""`what` of the `/operator` message that acknowledges an alarm; its `args` are `alarm` (identity) and `by`."""
TOPICS = frozenset({"/fault", "/state", "/operator", "/log"})
"""The topics that alarms are derived from."""
PRESS_STOP = "THE MACHINE DOES NOT OBEY ITS STOP: press the machine's own emergency stop now"
_KEPT = 500
# A transition and a fault that led to it carry the same time.
_SAME_NS = 50_000_000
# What control writes about a transition right after it; a simulated clock can be 40 times as fast as the computer's.
_SOON_NS = 5_000_000_000
_PROTOCOL = "protocol"
_TROUBLE = (State.FAULT, State.EMERGENCY_STOP)
_DEVICES = frozenset(device.words for device in Device)
_STOPPED = "motion was stopped and is held"


@dataclass(frozen=True, slots=True)
class Alarm:
    """Something that went wrong.

    Attributes:
        time_ns: experiment time, UTC ns.
        code: a `FaultCode`; empty if the log has none.
        text: what went wrong.
        where: the part that it concerns.
        action: what semlive did about it.
        acknowledged_ns: when it was acknowledged, None as long as it is open.
        acknowledged_by: where that request came from.
    """

    time_ns: int
    code: str
    text: str
    where: str
    action: str
    acknowledged_ns: int | None = None
    acknowledged_by: str = ""

    @property
    def identity(self) -> str:
        """By which it is acknowledged; alarms of the same instant share it."""
        return str(self.time_ns)

    @property
    def acknowledged(self) -> bool:
        """Whether a person has acknowledged it."""
        return self.acknowledged_ns is not None

    @property
    def disobeyed(self) -> bool:
        """The machine moves on after every stop that was ordered."""
        return self.code == FaultCode.STOP_NOT_OBEYED


@dataclass(frozen=True, slots=True)
class Alarms:
    """The alarms of a run so far.

    Attributes:
        known: in order. Of very many the acknowledged ones are forgotten first, then the oldest.
        forgotten: how many are not in `known` any more.
        provisional: the last one was derived from a transition; a `/fault` message about the same takes its place.
        wordless: the sentence of that transition has not come yet.
    """

    known: tuple[Alarm, ...] = ()
    forgotten: int = 0
    provisional: bool = False
    wordless: bool = False

    @property
    def open(self) -> tuple[Alarm, ...]:
        """Those that nobody has acknowledged."""
        return tuple(alarm for alarm in self.known if not alarm.acknowledged)


@dataclass(frozen=True, slots=True)
class AcknowledgeAll:
    """The operator has read every alarm."""

    by: str = ""


def acknowledgements(alarms: Alarms, identity: str | None, by: str, time_ns: int) -> tuple[OperatorMessage, ...]:
    """The messages that acknowledge an open alarm, or every open alarm; none if there is none to acknowledge.

    Args:
        alarms: of the run so far.
        identity: of the alarm; None for all.
        by: where the request came from.
        time_ns: experiment time.
    """
    found = dict.fromkeys(one.identity for one in alarms.open if identity in (None, one.identity))
    source: dict[str, JsonValue] = {"by": by} if by else {}
    return tuple(OperatorMessage(time_ns=time_ns, what=ACKNOWLEDGE, args={"alarm": one, **source}) for one in found)


def after(alarms: Alarms, payload: BaseModel) -> Alarms:
    """The alarms after one message more; the same object if it changes nothing."""
    match payload:
        case FaultMessage():
            return _fault(alarms, payload)
        case StateMessage(before=before, after=entered) if entered in _TROUBLE and before != entered:
            return _transition(alarms, payload)
        case LogLineMessage(level="info") if alarms.wordless and payload.time_ns - alarms.known[-1].time_ns <= _SOON_NS:
            return replace(_last(alarms, replace(alarms.known[-1], text=printable(payload.text))), wordless=False)
        case OperatorMessage(what="acknowledge"):
            return _acknowledge(alarms, payload)
    return alarms


def after_message(alarms: Alarms, message: LogMessage) -> Alarms:
    """The alarms after one message of a log more.

    Raises:
        BadLog: the message is not what its topic promises.
    """
    return after(alarms, from_json(message.topic, message.payload)) if message.topic in TOPICS else alarms


def _fault(alarms: Alarms, told: FaultMessage) -> Alarms:
    alarm = Alarm(told.time_ns, told.code or _code_of(told.where), printable(told.what), printable(told.where), printable(told.action))
    last = alarms.known[-1] if alarms.known else None
    late_ns = _SOON_NS if last is not None and last.code == told.code else _SAME_NS
    if last is not None and alarms.provisional and abs(told.time_ns - last.time_ns) <= late_ns:
        return replace(_last(alarms, alarm), provisional=False, wordless=False)
    if last is not None and _judged_twice(last, alarm):
        return alarms
    return _added(replace(alarms, provisional=False, wordless=False), alarm)


def _judged_twice(last: Alarm, alarm: Alarm) -> bool:
    """Limits are judged by the link thread and by the protocol, from the same reading: that is one alarm."""
    soon = abs(alarm.time_ns - last.time_ns) <= _SOON_NS
    return soon and last.code == alarm.code and not last.acknowledged and (last.where == _PROTOCOL) != (alarm.where == _PROTOCOL)


def _transition(alarms: Alarms, told: StateMessage) -> Alarms:
    code = FAULT_OF_CAUSE.get(told.cause, FaultCode.EMERGENCY_STOP if told.after == State.EMERGENCY_STOP else FaultCode.DEVICE_FAULT)
    last = alarms.known[-1] if alarms.known else None
    if last is not None and abs(told.time_ns - last.time_ns) <= _SAME_NS:
        # A device reported it; before faults had codes, only the transition says that it was an emergency stop.
        vague = last.code in ("", FaultCode.DEVICE_FAULT) and code is FaultCode.EMERGENCY_STOP
        return _last(alarms, replace(last, code=code)) if vague else alarms
    words = "emergency stop or limit switch" if told.after == State.EMERGENCY_STOP else "fault"
    return replace(_added(alarms, Alarm(told.time_ns, code, f"{words} ({told.cause})", "run", _STOPPED)), provisional=True, wordless=True)


def _acknowledge(alarms: Alarms, told: OperatorMessage) -> Alarms:
    identity, by = told.args.get("alarm"), printable(str(told.args.get("by", "")))
    if not any(alarm.identity == identity for alarm in alarms.open):
        return alarms
    done = (
        replace(alarm, acknowledged_ns=told.time_ns, acknowledged_by=by) if alarm.identity == identity and not alarm.acknowledged else alarm
        for alarm in alarms.known
    )
    return replace(alarms, known=tuple(done))


def _last(alarms: Alarms, alarm: Alarm) -> Alarms:
    return replace(alarms, known=(*alarms.known[:-1], alarm))


def _added(alarms: Alarms, alarm: Alarm) -> Alarms:
    known = (*alarms.known, alarm)
    if len(known) <= _KEPT:
        return replace(alarms, known=known)
    # An open alarm that the machine does not obey is kept in any case.
    least = min(known, key=lambda one: (not one.acknowledged, one.disobeyed and not one.acknowledged, one.time_ns))
    return replace(alarms, known=tuple(one for one in known if one is not least), forgotten=alarms.forgotten + 1)


def _code_of(where: str) -> str:
    """The code of a fault of a log whose faults have none, as far as its place says."""
    if where in _DEVICES:
        return FaultCode.DEVICE_FAULT
    if where == "log":
        return FaultCode.LOG
    return FaultCode.ANALYSIS if where == "analysis" or where.startswith("pair ") else ""
