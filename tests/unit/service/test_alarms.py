"""Alarms are a pure function of the log: every fault is one, in logs of any version, until somebody acknowledges it."""

from __future__ import annotations

from functools import reduce

import pytest

from semlive.data.faults import FaultCode
from semlive.formats.log.messages import FaultMessage, LogLineMessage, OperatorMessage, Payload, StateMessage
from semlive.service.log.alarms import AlarmLevel, Alarms, acknowledgements, after

START_NS = 1_800_000_000_000_000_000


def at(seconds: float) -> int:
    return START_NS + round(1e9 * seconds)


def fault(seconds: float, what: str = "it broke", where: str = "load frame", code: str = "") -> FaultMessage:
    return FaultMessage(time_ns=at(seconds), what=what, where=where, action="stopped", code=code)


def state(seconds: float, before: str, entered: str, cause: str) -> StateMessage:
    return StateMessage(time_ns=at(seconds), before=before, after=entered, cause=cause, step=0, guards={})


def line(seconds: float, text: str, level: str = "info") -> LogLineMessage:
    return LogLineMessage(time_ns=at(seconds), level=level, text=text)


def acknowledge(seconds: float, alarm: str) -> OperatorMessage:
    return OperatorMessage(time_ns=at(seconds), what="acknowledge", args={"alarm": alarm, "by": "page at 127.0.0.1"})


def alarms(*payloads: Payload) -> Alarms:
    return reduce(after, payloads, Alarms())


def found(*payloads: Payload) -> list[tuple[str, str]]:
    return [(alarm.code, alarm.text) for alarm in alarms(*payloads).listed]


def test_every_fault_is_an_alarm() -> None:
    listed = alarms(fault(1, "it is full", "log"), fault(2, "no point converged", "pair 3"), fault(3, code="link_lost")).listed
    assert [(item.code, item.where) for item in listed] == [("log", "log"), ("analysis", "pair 3"), ("link_lost", "load frame")]
    assert not any(item.acknowledged for item in listed)


def test_a_transition_without_a_fault_message_is_an_alarm_with_the_text_that_follows() -> None:
    assert found(state(1, "ramping", "fault", "limit"), line(1.2, "the load is beyond its limit"), line(1.3, "frame 3 is not used")) == [
        (FaultCode.LIMIT, "the load is beyond its limit")
    ]
    assert found(state(1, "holding", "fault", "frame_timeout")) == [(FaultCode.FRAME_TIMEOUT, "fault (frame_timeout)")]


def test_an_emergency_stop_of_an_older_log_is_an_alarm() -> None:
    old = (fault(1, "emergency stop"), state(1, "ramping", "estopped", "emergency"), line(1, "emergency stop"))
    assert found(*old) == [(FaultCode.EMERGENCY_STOP, "emergency stop")]
    assert found(*old[1:]) == [(FaultCode.EMERGENCY_STOP, "emergency stop")]


def test_a_fault_and_its_transition_are_one_alarm_in_either_order() -> None:
    reported = fault(1, "limit switch", code="limit_switch")
    for order in ((reported, state(1, "ramping", "estopped", "emergency")), (state(1, "ramping", "estopped", "emergency"), reported)):
        assert found(*order, line(1.1, "limit switch")) == [("limit_switch", "limit switch")]
    late = fault(3, "the load is beyond its limit", code="limit")
    assert found(state(1, "ramping", "fault", "limit"), line(1, "beyond"), late) == [("limit", "the load is beyond its limit")]


def test_another_fault_soon_after_a_transition_is_an_alarm_of_its_own() -> None:
    reported_text = (state(1, "ramping", "fault", "limit"), line(1, "beyond"), fault(3, "it moves on", code="stop_not_obeyed"))
    assert found(*reported_text) == [(FaultCode.LIMIT, "beyond"), ("stop_not_obeyed", "it moves on")]
    reported_text = (state(1, "ramping", "fault", "limit"), state(2, "fault", "estopped", "emergency"))
    assert [code for code, _ in found(*reported_text)] == [FaultCode.LIMIT, FaultCode.EMERGENCY_STOP]


def test_staying_in_fault_and_leaving_it_are_no_alarms() -> None:
    assert not alarms(state(1, "fault", "recover", "resume"), state(2, "ramping", "paused", "pause"), line(3, "paused")).listed


@pytest.mark.parametrize("resumed", [False, True])
def test_an_alarm_is_open_until_it_is_acknowledged_whatever_the_run_does(resumed: bool) -> None:
    reported_text = [fault(1, code="link_lost"), fault(5, code="limit")]
    reported_text += [state(6, "fault", "recover", "resume"), state(7, "recover", "ramping", "resume")] if resumed else []
    listed = alarms(*reported_text)
    assert len(listed.open) == 2
    listed = reduce(after, (acknowledge(8, str(at(1))), acknowledge(9, "no alarm"), acknowledge(10, str(at(1)))), listed)
    assert [item.code for item in listed.open] == ["limit"]
    first = listed.listed[0]
    assert (first.acknowledged_ns, first.acknowledged_by) == (at(8), "page at 127.0.0.1")


def test_one_alarm_or_all_are_acknowledged_and_none_twice() -> None:
    listed = alarms(fault(1), fault(2, code="limit"), fault(2, code="link_lost"))
    assert [item.args for item in acknowledgements(listed, str(at(2)), "", at(3))] == [{"alarm": str(at(2))}]
    everything = acknowledgements(listed, None, "terminal", at(3))
    assert [item.args for item in everything] == [{"alarm": str(at(1)), "by": "terminal"}, {"alarm": str(at(2)), "by": "terminal"}]
    listed = reduce(after, everything, listed)
    assert not listed.open
    assert not acknowledgements(listed, None, "terminal", at(4))
    assert not acknowledgements(listed, "7", "terminal", at(4))


def test_text_from_outside_is_shown_without_control_characters() -> None:
    assert found(fault(1, "a\x1b[2J.tif\n", code="log"))[0][1] == "a\\x1b[2J.tif\\n"


def test_very_many_alarms_are_bounded_and_the_one_that_matters_stays() -> None:
    first = (fault(0, code="log"), acknowledge(0.5, str(at(0))), fault(1, "it moves on", code="stop_not_obeyed"))
    listed = alarms(*first, *(fault(2 + number, code="analysis") for number in range(600)))
    assert len(listed.listed) == 500
    assert listed.forgotten == 102
    assert listed.listed[0].disobeyed
    assert listed.listed[-1].time_ns == at(601)


def test_a_limit_that_link_thread_and_protocol_find_in_one_reading_is_one_alarm() -> None:
    listed = Alarms()
    for where, late_ns in (("protocol", 0), ("load frame", 3_000_000)):
        reported_text = FaultMessage(time_ns=1_000 + late_ns, what="the load is 950 N", where=where, action="stopped", code="limit")
        listed = after(listed, reported_text)
    assert len(listed.listed) == 1
    other = FaultMessage(time_ns=2_000, what="another", where="load frame", action="stopped", code="load_jump")
    assert len(after(listed, other).listed) == 2


@pytest.mark.parametrize(
    ("where", "level"),
    [
        ("load frame", AlarmLevel.DANGER),
        ("export folder", AlarmLevel.DANGER),
        ("log", AlarmLevel.DANGER),
        ("a part that is added later", AlarmLevel.DANGER),
        ("estimate with pair 4", AlarmLevel.ATTENTION),
        ("analysis of pair 3", AlarmLevel.ATTENTION),
    ],
)
def test_an_alarm_about_one_result_is_less_urgent_than_all_others(where: str, level: AlarmLevel) -> None:
    assert [alarm.level for alarm in alarms(fault(1.0, where=where)).listed] == [level]
