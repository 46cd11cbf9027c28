"""Own scenarios: the independent frame's faults in other phases of a run, and with other maps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from semlive.data.faults import FaultCode as Code

from .scenario import Act, Ending, Expected, Scenario, When

_STANDS = (Code.NO_RESPONSE, Code.FROZEN_READING, Code.TRAVEL_WITHOUT_LOAD, Code.SENSOR_RANGE)
_FLAT = Expected(stop_within_s=2.0, codes=_STANDS)
_BEYOND = Expected(since_force_n=303.0, stop_within_s=0.6, timed=True, codes=(Code.OVERSHOOT,), peak_n=340.0)
_AT_ONCE = Expected(stop_within_s=0.6, timed=True, codes=(Code.LOAD_JUMP, Code.WRONG_DIRECTION, Code.LIMIT, Code.SENSOR_RANGE))
_LOST = Expected(stop_within_s=0.6, timed=True, codes=(Code.LINK_LOST, Code.DEVICE_FAULT, Code.ORDER_REFUSED))
_MOVED = Expected(stop_within_s=2.5, codes=(Code.MOVED_AT_REST, Code.UNORDERED_MOTION, Code.FOREIGN_ORDER))
_FAULT = Expected(stop_within_s=None)
_RESTARTED = Expected(stop_within_s=None, codes=(Code.DEVICE_RESTARTED, Code.FOREIGN_ORDER))
_SAFE = Expected(Ending.SAFE, stop_within_s=None, loaded_pairs=None, no_orders=False)
F32, F32C, I16, DISP = "map_f32.yaml", "map_f32c.yaml", "map_i16.yaml", "map_disp.yaml"


def _ramp(
    name: str, must: str, expected: Expected, *commands: str, force_n: float, map: str = F32, load_n: float = 300.0, rate: float = 30.0
) -> Scenario:
    acts = (Act(When("ramping", force_n=force_n), commands),)
    what = f"at {force_n:g} N of {load_n:g} N, {rate:g} N/s: {', '.join(commands)}"
    return Scenario(name, what, must, expected, acts, map, unloaded=0, protocol={"loads_n": [load_n], "ramp_rate_n_s": rate})


_PHASES: Mapping[str, tuple[When, dict[str, object]]] = {
    "settling": (When("settling", after_s=0.2), {"protocol": {"settle_s": 3.0}}),
    "hold": (When("holding", after_s=0.5), {"protocol": {"hold_s": 5.0}}),
    "imaging": (When("imaging", after_s=0.5), {"frames_after_s": 6.0}),
}
_CALIBRATION = (When("holding", step=0, after_s=0.5), {"protocol": {"hold_s": 5.0}, "unloaded": 2})


def _rest(phase: str, name: str, must: str, expected: Expected, *commands: str, map: str = F32) -> Scenario:
    """At rest in a phase under load."""
    when, changes = _PHASES[phase]
    item = Scenario(
        f"{phase}-{name}", f"{phase}: {', '.join(commands)}", must, expected, (Act(when, commands),), map, unloaded=0, watch_s=9.0
    )
    return replace(item, **changes)


def _calibration(name: str, must: str, expected: Expected, *commands: str) -> Scenario:
    """In the hold of an unloaded pair."""
    when, changes = _CALIBRATION
    item = Scenario(f"calibration-{name}", f"unloaded hold: {', '.join(commands)}", must, expected, (Act(when, commands),), watch_s=9.0)
    return replace(item, **changes)


_AT_REST = "no motion of its own; fault"

RAMPS = (
    _ramp("early-freeze", "stop within 2 s", _FLAT, "freeze 1", "runaway 1", force_n=8.0),
    _ramp("late-freeze", "stop within 2 s", _FLAT, "freeze 1", "runaway 1", force_n=285.0),
    _ramp("near-limit-freeze", "true load within its bounds", _FLAT, "freeze 1", "runaway 1", force_n=375.0, load_n=390.0),
    _ramp("fast-freeze", "true load within its bounds", _FLAT, "freeze 1", "runaway 1", force_n=250.0, load_n=390.0, rate=100.0),
    _ramp(
        "slow-freeze", "stop within 20 N", replace(_FLAT, stop_within_s=10.0), "freeze 1", "runaway 1", force_n=10.0, rate=2.0, load_n=20.0
    ),
    _ramp(
        "near-limit-runaway",
        "stop beyond the target",
        replace(_BEYOND, since_force_n=393.0, peak_n=420.0),
        "runaway 1",
        force_n=370.0,
        load_n=390.0,
    ),
    _ramp("fast-runaway", "stop beyond the target", replace(_BEYOND, peak_n=370.0), "runaway 1", force_n=100.0, rate=100.0),
    _ramp(
        "near-limit-saturated",
        "true load within its bounds",
        replace(_FLAT, since_force_n=370.0),
        "sat 370",
        "runaway 1",
        force_n=300.0,
        load_n=390.0,
    ),
    _ramp("saturated-at-target", "true load within its bounds", replace(_FLAT, since_force_n=300.0), "sat 299", "runaway 1", force_n=200.0),
    _ramp("slightly-fast", "stop or complete: the load stays within its bounds", _SAFE, "ratex 1.3", force_n=20.0),
    _ramp("twice-as-fast", "stop: the rate is not kept", Expected(stop_within_s=3.0, codes=(Code.RATE_NOT_KEPT,)), "ratex 2", force_n=20.0),
    _ramp(
        "rate-falls-to-tenth",
        "stop: the rate is not kept",
        Expected(stop_within_s=6.0, codes=(Code.RATE_NOT_KEPT, Code.NO_RESPONSE)),
        "ratex 0.1",
        force_n=60.0,
    ),
    _ramp(
        "ramp-stands",
        "stop: nothing moves",
        Expected(stop_within_s=4.0, codes=(Code.NO_RESPONSE, Code.RATE_NOT_KEPT)),
        "ratex 0",
        force_n=60.0,
    ),
    _ramp("panel-down-in-ramp", "stop, fault, never ordered again", replace(_MOVED, codes=()), "goto 20", force_n=150.0),
    _ramp("panel-up-in-ramp", "stop, fault", replace(_MOVED, codes=(), since_force_n=303.0), "goto 395", force_n=150.0),
    _ramp("i16-freeze", "stop within 2 s", _FLAT, "freeze 1", "runaway 1", force_n=60.0, map=I16),
    _ramp("i16-runaway", "stop beyond the target", _BEYOND, "runaway 1", force_n=60.0, map=I16),
    _ramp("i16-saturated", "stop within 2 s", replace(_FLAT, since_force_n=250.0), "sat 250", "runaway 1", force_n=60.0, map=I16),
    _ramp("i16-restart", "fault", replace(_RESTARTED, stop_within_s=2.0), "reboot 0", force_n=60.0, map=I16),
    _ramp("i16-late-answers", "write the stop first", _LOST, "delay 500", force_n=60.0, map=I16),
    _ramp("i16-stop-ignored", "stop again", _BEYOND, "runaway 1", "ignorestop 2", force_n=60.0, map=I16),
    _ramp("f32c-runaway", "stop beyond the target", _BEYOND, "runaway 1", force_n=60.0, map=F32C),
    _ramp("f32c-saturated", "stop within 2 s", replace(_FLAT, since_force_n=250.0), "sat 250", "runaway 1", force_n=60.0, map=F32C),
    _ramp("disp-early-freeze", "bounded travel", replace(_FLAT, stop_within_s=15.0), "freeze 1", force_n=8.0, map=DISP),
    _ramp("disp-late-freeze", "bounded travel", replace(_FLAT, stop_within_s=15.0), "freeze 1", force_n=270.0, map=DISP),
    _ramp(
        "disp-near-limit-freeze",
        "true load within its bounds",
        replace(_FLAT, stop_within_s=15.0),
        "freeze 1",
        force_n=375.0,
        load_n=390.0,
        map=DISP,
    ),
    _ramp("disp-saturated", "bounded travel", replace(_FLAT, stop_within_s=15.0, since_force_n=250.0), "sat 250", force_n=200.0, map=DISP),
    _ramp("disp-wrong-sign", "stop at the jump of the reading", _AT_ONCE, "neg 1", force_n=120.0, map=DISP),
    _ramp("disp-wrong-sign-early", "stop at the jump of the reading", replace(_FLAT, codes=()), "neg 1", force_n=20.0, map=DISP),
    _ramp("disp-c-not-a-number", "stop, fault", _AT_ONCE, "nan 1", force_n=60.0, map=DISP),
    _ramp("disp-late-answers", "write the stop first", _LOST, "delay 500", force_n=60.0, map=DISP),
    _ramp("disp-wrong-transaction", "write the stop first", _LOST, "badtid 1", force_n=60.0, map=DISP),
    _ramp("disp-writes-refused", "stop, fault", replace(_LOST, repeats=True), "excw 6", force_n=60.0, map=DISP),
    _ramp("disp-restart-drives", "stop, fault", Expected(stop_within_s=2.5, codes=()), "reboot 380", force_n=60.0, map=DISP),
    _ramp("disp-resets", "stop, fault", _LOST, "rst 30", force_n=60.0, map=DISP),
    _ramp("disp-stops-refused", "stop, fault", _AT_ONCE, "nan 1", "excstop 6", force_n=60.0, map=DISP),
)

RESTS = (
    *(_rest(phase, "panel-up", _AT_REST, _MOVED, "goto 395") for phase in _PHASES),
    *(_rest(phase, "panel-down", _AT_REST, _MOVED, "goto 100") for phase in _PHASES),
    _rest("hold", "panel-slightly", _AT_REST, _MOVED, "goto 312"),
    _rest("hold", "freeze-panel-down", _AT_REST, replace(_MOVED, codes=()), "freeze 1", "goto 100"),
    _rest("imaging", "freeze-panel-up", _AT_REST, replace(_MOVED, codes=()), "freeze 1", "goto 395"),
    _rest("hold", "restart", "fault", _RESTARTED, "reboot 0"),
    _rest("hold", "restart-counter", "fault", _RESTARTED, "reboot 0", map=F32C),
    _rest("imaging", "restart-drives", _AT_REST, replace(_MOVED, codes=()), "reboot 380"),
    _rest("hold", "silence", "fault", replace(_FAULT, codes=(Code.LINK_LOST,)), "hole 1"),
    _rest("imaging", "wrong-transaction", "fault", _FAULT, "badtid 1"),
    _rest("hold", "not-a-number", "fault", _FAULT, "nan 1"),
    _rest("hold", "wrong-sign", "fault", _FAULT, "neg 1"),
    _rest("imaging", "load-lost", "fault, never driven back", replace(_FAULT, codes=(Code.MOVED_AT_REST, Code.LOAD_JUMP)), "F 200"),
    _rest("hold", "extension-changes", "fault", _FAULT, "E 0.1"),
    _rest("hold", "disp-panel-up", _AT_REST, _MOVED, "goto 395", map=DISP),
    _rest("imaging", "disp-panel-down", _AT_REST, _MOVED, "goto 100", map=DISP),
    _rest("hold", "i16-panel-up", _AT_REST, _MOVED, "goto 395", map=I16),
    _rest("hold", "reads-refused", "fault", _FAULT, "excr 6"),
    _calibration("panel-up", _AT_REST, _MOVED, "goto 100"),
    _calibration("loaded-at-once", _AT_REST, _FAULT, "F 80", "E 0.004"),
    _calibration("silence", "fault", _FAULT, "hole 1"),
    # Before the first order all registers are 0 anyway: a restart shows in the counter only.
    replace(_calibration("restart", "fault", _RESTARTED, "reboot 0"), map=F32C),
    _calibration("not-a-number", "fault", _FAULT, "nan 1"),
)

SCENARIOS = (*RAMPS, *RESTS)
