"""The independent frame's own list: readings, motion and orders that go wrong in a ramp or a hold."""

from __future__ import annotations

from dataclasses import replace

from semlive.data.faults import FaultCode as Code

from .scenario import Act, Ending, Expected, Group, Scenario, When

_STANDS = (Code.NO_RESPONSE, Code.FROZEN_READING, Code.TRAVEL_WITHOUT_LOAD, Code.SENSOR_RANGE)
_BEYOND = Expected(since_force_n=303.0, stop_within_s=0.6, timed=True, codes=(Code.OVERSHOOT,), peak_n=340.0)
_SIGN = Expected(stop_within_s=0.6, timed=True, codes=(Code.LOAD_JUMP, Code.WRONG_DIRECTION, Code.LIMIT, Code.SENSOR_RANGE))
_RATE = Expected(stop_within_s=1.0, codes=(Code.RATE_NOT_KEPT,))
_RESTART = Expected(stop_within_s=2.0, codes=(Code.DEVICE_RESTARTED, Code.FOREIGN_ORDER, Code.UNORDERED_MOTION, Code.OVERSHOOT))
_COMPLETE = Expected(Ending.COMPLETE, stop_within_s=None, loaded_pairs=1, no_orders=False)
_UNBOUNDED = replace(_BEYOND, peak_n=None, repeats=True, message="does not (obey|stop)|moves on|own (emergency )?stop|emergency stop")
_FLAT = "stop within 2 s: the load does not change although the frame moves"
_SOON = "stop as soon as the load passes the target by more than the tolerance"


def _ramp(
    name: str, must: str, expected: Expected, *commands: str, force_n: float = 60.0, map: str = "map_f32.yaml", short: bool = False
) -> Scenario:
    """In the ramp under load, from a true force on, these switches."""
    acts = (Act(When("ramping", force_n=force_n), commands),)
    return Scenario(name, f"at {force_n:g} N: {', '.join(commands)}", must, expected, acts, map, Group.README, short=short)


_DISP = _ramp(
    "disp-freeze",
    "stop after a bounded travel without a change of load, by default",
    Expected(stop_within_s=15.0, codes=_STANDS),
    "freeze 1",
    map="map_disp.yaml",
    short=True,
)
_TOO_FAST = _ramp(
    "too-fast", "stop: the measured rate is far above the ordered one, by default", _RATE, "ratex 20", force_n=2.0, short=True
)
_NEGATIVE = _ramp("wrong-sign-30", "stop at the jump of the reading", _SIGN, "neg 1", "runaway 1", force_n=30.0)

SCENARIOS = (
    Scenario("base", "nothing is wrong", "the run completes", _COMPLETE, group=Group.README),
    _ramp("freeze", _FLAT, Expected(codes=_STANDS), "freeze 1", "runaway 1", short=True),
    _ramp("freeze-counter-goes-on", _FLAT, Expected(codes=_STANDS), "freeze 1", "runaway 1", map="map_f32c.yaml"),
    _ramp("freeze-counter-stops", _FLAT, Expected(codes=_STANDS), "freeze 1", "nocount 1", map="map_f32c.yaml"),
    _DISP,
    replace(_DISP, name="disp-freeze-slack-limit", what=f"{_DISP.what}; slack_max_mm 0.005", limits={"slack_max_mm": 0.005}, short=False),
    Scenario(
        "freeze-in-hold",
        "in the hold: freeze 1, then goto 395",
        "fault: a reading without any noise, or an extension that changes in a hold",
        Expected(stop_within_s=2.0, codes=(*_STANDS, Code.MOVED_AT_REST, Code.UNORDERED_MOTION, Code.FOREIGN_ORDER)),
        (Act(When("holding", step=1, after_s=0.5), ("freeze 1", "goto 395")),),
        group=Group.README,
        protocol={"hold_s": 4.0},
    ),
    _ramp(
        "saturated",
        _FLAT.replace("within 2 s", "within 2 s of saturation"),
        Expected(since_force_n=250.0, codes=_STANDS),
        "sat 250",
        "runaway 1",
    ),
    _ramp("runaway", _SOON, _BEYOND, "runaway 1", short=True),
    _ramp("overshoot", _SOON, _BEYOND, "targx 1.25"),
    _TOO_FAST,
    replace(
        _TOO_FAST,
        name="too-fast-with-limit",
        short=False,
        what=f"{_TOO_FAST.what}; force_slope_max_n_s 100",
        limits={"force_slope_max_n_s": 100.0},
    ),
    _ramp("stop-ignored-once", f"{_SOON}; a second stop order", _BEYOND, "runaway 1", "ignorestop 1"),
    replace(
        _ramp("every-stop-ignored", "stop orders as long as it moves; report it at once", _UNBOUNDED, "runaway 1", "ignorestop 100000"),
        linger_s=8.0,
        short=True,
    ),
    replace(
        _ramp("stop-refused", "stop orders as long as it moves; report it at once", _UNBOUNDED, "runaway 1", "excstop 6"), linger_s=6.0
    ),
    _ramp("not-a-number", "stop, fault", replace(_SIGN, codes=()), "nan 1"),
    _ramp("wrong-sign-120", "stop at the jump of the reading", _SIGN, "neg 1", force_n=120.0),
    _NEGATIVE,
    replace(_NEGATIVE, name="wrong-sign-symmetrical-limits", what=f"{_NEGATIVE.what}; force_min_n -400", limits={"force_min_n": -400.0}),
    _ramp("wrong-sign-above-250", "stop at the jump of the reading", replace(_SIGN, since_force_n=250.0), "fneglim 250"),
    _ramp("restart", "fault: motion ended before the target and the registers were cleared", _RESTART, "reboot 0", short=True),
    _ramp("restart-drives", "stop, fault", _RESTART, "reboot 380"),
    _ramp("restart-counter", "stop, fault", _RESTART, "reboot 380", map="map_f32c.yaml"),
    Scenario(
        "counter-wraps",
        "cnt 4294960000 before the start",
        "the run completes",
        _COMPLETE,
        (Act(When(), ("cnt 4294960000",), is_fault=False),),
        "map_f32c.yaml",
        Group.README,
    ),
    Scenario(
        "moved-at-panel",
        "in the hold: goto 395",
        "no motion of its own; fault, ask the operator",
        Expected(stop_within_s=2.0, codes=(Code.MOVED_AT_REST, Code.UNORDERED_MOTION, Code.FOREIGN_ORDER)),
        (Act(When("holding", step=1, after_s=0.5), ("goto 395",)),),
        group=Group.README,
        protocol={"hold_s": 4.0},
        short=True,
    ),
)
