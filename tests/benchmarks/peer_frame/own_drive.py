"""Own scenarios: drives that do not do what was ordered, and links that execute but answer badly; second frame, in a ramp."""

from __future__ import annotations

from dataclasses import replace

from semlive.data.faults import FaultCode as Code

from .own_cell import COUNT, DISP, second
from .scenario import Act, Ending, Expected, Scenario, When

_BEYOND = Expected(since_force_n=303.0, stop_within_s=0.6, timed=True, codes=(Code.OVERSHOOT,), peak_n=345.0)
_RATE = Expected(stop_within_s=1.5, codes=(Code.RATE_NOT_KEPT,))
_LOST = Expected(stop_within_s=0.6, timed=True, codes=(Code.LINK_LOST, Code.DEVICE_FAULT))
_FOREIGN = Expected(stop_within_s=1.0, codes=(Code.FOREIGN_ORDER, Code.OVERSHOOT, Code.UNORDERED_MOTION))
_SAFE = Expected(Ending.SAFE, stop_within_s=None, loaded_pairs=None, no_orders=False)
_COMPLETE = Expected(Ending.COMPLETE, stop_within_s=None, loaded_pairs=1, no_orders=False)
_OBEYS_NOT = "does not (obey|stop)|moves on|own (emergency )?stop|emergency stop"
_RATE_MUST = "stop: the measured rate is not the ordered one"


def _near_limit(one: Scenario, name: str, load_n: float = 390.0) -> Scenario:
    """The same with a target close to the limit of 400 N."""
    return replace(
        one, name=name, what=f"{one.what}; target {load_n:g} N", protocol={"loads_n": [load_n]}, limits={"force_step_max_n": 400}
    )


_RUNAWAY = second("drive-runs-away", "stop beyond the target", _BEYOND, "runaway 1")

DRIVES = (
    _RUNAWAY,
    replace(
        _near_limit(_RUNAWAY, "drive-runs-away-near-limit"), expected=Expected(since_force_n=393.0, stop_within_s=0.6, timed=True, codes=())
    ),
    second("drive-goes-beyond-target", "stop beyond the target", _BEYOND, "targetx 1.2"),
    second("drive-goes-slightly-beyond", "fault; never driven back", replace(_BEYOND, timed=False, stop_within_s=2.0), "targetx 1.03"),
    second("drive-3-times-as-fast", _RATE_MUST, _RATE, "ratex 3"),
    second("drive-10-times-as-fast", _RATE_MUST, _RATE, "ratex 10", force_n=5.0),
    second("drive-at-tenth-rate", "stop or complete: the load stays within its bounds", _SAFE, "ratex 0.5"),
    second("drive-hangs", "stop, fault", Expected(stop_within_s=3.0, codes=(Code.NO_RESPONSE, Code.RATE_NOT_KEPT)), "jam 1"),
    replace(
        second("drive-hangs-then-jumps", "stop, fault", Expected(stop_within_s=3.0, codes=(Code.NO_RESPONSE, Code.RATE_NOT_KEPT)), "jam 1"),
        what="at 60 N: jam 1; 4 s later jam 0, and the servo catches up",
        acts=(Act(When("ramping", force_n=60.0), ("jam 1",)), Act(When("ramping", force_n=60.0, after_s=4.0), ("jam 0",))),
    ),
    second("drive-wrong-direction", "stop, fault", Expected(stop_within_s=1.5, codes=(Code.WRONG_DIRECTION,)), "wrongway 1"),
    second("target-changed-in-ramp", "stop, fault", _FOREIGN, "settarget 380"),
    second("target-changed-down-in-ramp", "stop, fault", _FOREIGN, "settarget 20", force_n=150.0),
    second("target-changed-hidden", "stop beyond the target", _BEYOND, "hiddentarget 390"),
    second("stop-3-s-late", "stop orders as long as it moves", replace(_BEYOND, repeats=True, peak_n=430.0), "runaway 1", "stopdelay 3"),
    second("stop-coasts-1-s", "stop", replace(_BEYOND, peak_n=360.0), "runaway 1", "coast 1"),
    second(
        "stop-ignored-5-times", "stop orders as long as it moves", replace(_BEYOND, repeats=True, peak_n=400.0), "runaway 1", "ignorestop 5"
    ),
    second(
        "stop-never-obeyed",
        "stop orders as long as it moves; report it at once",
        replace(_BEYOND, repeats=True, peak_n=None, message=_OBEYS_NOT),
        "runaway 1",
        "ignorestop 100000",
    ),
    second(
        "stop-only-by-drive-off",
        "the next way to stop that the map offers",
        replace(_BEYOND, peak_n=420.0, repeats=True),
        "runaway 1",
        "enable 1",
        map="second_stops.yaml",
    ),
    second(
        "stop-writes-not-taken",
        "stop orders as long as it moves; report it",
        replace(_BEYOND, peak_n=None, message=_OBEYS_NOT),
        "runaway 1",
        "wignore 1",
    ),
)

START = (
    replace(
        second(
            "target-rounded", "refused or fault: the device takes another target", Expected(stop_within_s=None, no_orders=False), "ratex 1"
        ),
        acts=(Act(When(), ("roundtarget 40",)),),
        what="targets are rounded to 40 N",
    ),
    replace(
        second("writes-not-taken", "refused or fault: the order was not taken", Expected(stop_within_s=None, no_orders=False), "ratex 1"),
        acts=(Act(When(), ("wignore 1",)),),
        what="writes are acknowledged and not taken",
    ),
    replace(
        second("silent-at-start", "refused", Expected(Ending.REFUSED, stop_within_s=None), "ratex 1"),
        acts=(Act(When(), ("mute 1",)),),
        what="nothing is answered",
    ),
    replace(
        second("not-a-number-at-start", "refused", Expected(Ending.REFUSED, stop_within_s=None), "ratex 1"),
        acts=(Act(When(), ("nan 1",)),),
        what="force is NaN",
    ),
    replace(
        second(
            "frozen-from-start",
            "stop, fault",
            Expected(stop_within_s=2.0, since_force_n=5.0, codes=(Code.NO_RESPONSE,), no_orders=False),
            "ratex 1",
        ),
        acts=(Act(When(), ("freeze 1",)),),
        what="the reading is constant at 0 N from the start; the loop acts on it",
        device={"sensed": 1},
    ),
    replace(
        second(
            "wrong-sign-from-start",
            "stop, fault",
            Expected(stop_within_s=2.0, since_force_n=5.0, codes=(Code.WRONG_DIRECTION,), no_orders=False),
            "ratex 1",
        ),
        acts=(Act(When(), ("gain -1",)),),
        what="the cell is wired the wrong way",
    ),
    replace(
        second(
            "unit-kn-instead-of-n", "stop, fault", Expected(stop_within_s=2.0, since_force_n=10.0, codes=(), no_orders=False), "ratex 1"
        ),
        acts=(Act(When(), ("gain 0.001",)),),
        what="the cell reads in kN instead of N; the loop acts on it",
        device={"sensed": 1},
    ),
)

LINKS = (
    second("link-executes-without-answer", "write the stop without waiting for answers", _LOST, "mute 1"),
    second("link-1-s-late", "write the stop without waiting for answers", _LOST, "delay 1000"),
    second("link-200-ms-late", "the run completes", _COMPLETE, "delay 200"),
    second("link-wrong-unit", "stop, fault", _LOST, "wrongunit 1"),
    second("link-wrong-function", "stop, fault", _LOST, "wrongfunc 1"),
    second("link-short-answers", "stop, fault", _LOST, "trunc 1"),
    second("link-wrong-transaction", "stop, fault", _LOST, "badtid 1"),
    second("link-dropped-once", "stop, fault", _LOST, "drop 1"),
    second("link-busy-3-times", "stop, fault", _LOST, "busy 3"),
    second(
        "link-silent", "fault; name the machine's own stop", replace(_LOST, stop_within_s=None, timed=False, message=_OBEYS_NOT), "hole 1"
    ),
    second("link-1-s-late-counter", "write the stop without waiting for answers", _LOST, "delay 1000", map=COUNT),
    second("link-1-s-late-disp", "write the stop without waiting for answers", _LOST, "delay 1000", map=DISP),
    second("link-executes-without-answer-disp", "write the stop without waiting for answers", _LOST, "mute 1", map=DISP),
    second("link-executes-without-answer-runaway", "write the stop without waiting for answers", _LOST, "mute 1", "runaway 1"),
)

SCENARIOS = (*DRIVES, *START, *LINKS)
