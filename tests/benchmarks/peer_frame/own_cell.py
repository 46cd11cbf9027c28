"""Own scenarios: cells, extensometers, states and counters of the second frame with wrong values, in a ramp."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from semlive.data.faults import FaultCode as Code

from .scenario import Act, Ending, Expected, Peer, Scenario, When

_STANDS = (Code.NO_RESPONSE, Code.FROZEN_READING, Code.TRAVEL_WITHOUT_LOAD, Code.SENSOR_RANGE, Code.RATE_NOT_KEPT)
_FLAT = Expected(stop_within_s=2.0, codes=_STANDS)
_AT_ONCE = Expected(
    stop_within_s=0.6, timed=True, codes=(Code.LIMIT, Code.LOAD_JUMP, Code.SENSOR_RANGE, Code.WRONG_DIRECTION, Code.LINK_LOST)
)
_BOUNDED = "stop after a bounded travel without a change of load"
_WITHIN_2 = "stop within 2 s, fault"
_SAFE = Expected(Ending.SAFE, stop_within_s=None, loaded_pairs=None, no_orders=False)
LOAD, COUNT, DISP = "second_load.yaml", "second_count.yaml", "map_disp_second.yaml"


def second(
    name: str,
    must: str,
    expected: Expected,
    *commands: str,
    force_n: float = 60.0,
    map: str = LOAD,
    device: Mapping[str, object] | None = None,
    short: bool = False,
) -> Scenario:
    """In a ramp of the second frame, from a true force on."""
    acts = (Act(When("ramping", force_n=force_n), commands),)
    given = dict(device or {})
    what = f"at {force_n:g} N: {', '.join(commands)}{'; ' if given else ''}{', '.join(f'{key} {value}' for key, value in given.items())}"
    return Scenario(name, what, must, expected, acts, map, peer=Peer.SECOND, device=given, unloaded=0, short=short)


_SENSED: Mapping[str, object] = {"sensed": 1}
"""The machine's own loop acts on the faulty reading, so that it runs away."""

_LATE_ORDERS = tuple(
    Act(When("ramping", force_n=60.0, after_s=second_s + offset_s), (f"!signal {name}",), is_fault=False)
    for second_s in range(1, 16)
    for name, offset_s in (("STOP", 0.0), ("CONT", 0.7))
)
"""The travel of a displacement drive is ordered 0.5 s ahead, so the drive rests before the next order."""

FORCE = (
    second("cell-freeze-in-loop", _WITHIN_2, _FLAT, "freeze 1", device=_SENSED, short=True),
    second("cell-freeze-in-loop-early", _WITHIN_2, _FLAT, "freeze 1", device=_SENSED, force_n=8.0),
    second("cell-freeze-with-noise", _WITHIN_2, _FLAT, "noisyfreeze 1", device={"sensed": 1, "noise_n": 0.3}),
    second("cell-freeze-with-noise-counter", _WITHIN_2, _FLAT, "noisyfreeze 1", device={"sensed": 1, "noise_n": 0.3}, map=COUNT),
    second("cell-freeze-delayed", _WITHIN_2, replace(_FLAT, since_force_n=200.0), "freezeat 200", device=_SENSED),
    second("cell-freeze-runaway", _WITHIN_2, _FLAT, "freeze 1", "runaway 1"),
    second("cell-clipped-with-noise", _WITHIN_2, replace(_FLAT, since_force_n=200.0), "clip 200", device={"sensed": 1, "noise_n": 0.4}),
    second("cell-clipped-runaway", _WITHIN_2, replace(_FLAT, since_force_n=250.0), "clip 250", "runaway 1"),
    second("cell-sticky-50", "true load within its bounds", _SAFE, "sticky 50", device=_SENSED),
    second("cell-sticky-200", _WITHIN_2, replace(_FLAT, stop_within_s=2.5), "sticky 200", device=_SENSED),
    second(
        "cell-sign-turns-within-5-s", "stop, fault", replace(_FLAT, stop_within_s=3.0, codes=()), "flip 5", device=_SENSED, force_n=120.0
    ),
    second(
        "cell-sign-turns-within-1-s", "stop, fault", replace(_FLAT, stop_within_s=1.5, codes=()), "flip 1", device=_SENSED, force_n=120.0
    ),
    second("cell-fades-within-4-s", "stop, fault", replace(_FLAT, stop_within_s=3.0), "fade 4", device=_SENSED, force_n=120.0),
    second("cell-half-gain", "stop at the jump of the reading", replace(_FLAT, codes=()), "gain 0.5", device=_SENSED, force_n=150.0),
    second("cell-jumps-up", "stop at the jump of the reading", replace(_FLAT, codes=(Code.LOAD_JUMP, Code.LIMIT)), "jump 150"),
    second(
        "cell-jumps-down", "stop at the jump of the reading", replace(_FLAT, codes=(Code.LOAD_JUMP, Code.LIMIT)), "jump -100", force_n=150.0
    ),
    second("cell-one-spike", "stop at the reading beyond the limit", _AT_ONCE, "spike 1"),
    second("cell-not-a-number", "stop, fault", _AT_ONCE, "nan 1"),
    second("cell-infinite", "stop, fault", _AT_ONCE, "inf 1"),
    second("cell-2-s-late", "true load within its bounds", _SAFE, "late 2"),
    second(
        "cell-2-s-late-runaway", "stop", Expected(since_force_n=303.0, stop_within_s=2.7, codes=()), "late 2", "runaway 1", force_n=10.0
    ),
    second("cell-tenth-gain", "stop, fault", replace(_FLAT, stop_within_s=2.5), "gain 0.1", device=_SENSED, force_n=2.0),
    replace(
        second("cell-tenth-gain-stiffness", "stop, fault", replace(_FLAT, stop_within_s=2.5), "gain 0.1", device=_SENSED, force_n=2.0),
        what="at 2 N: gain 0.1; sensed 1; stiffness_min_n_mm 10000, half of the true stiffness",
        limits={"stiffness_min_n_mm": 10_000},
    ),
    replace(
        second("disp-tenth-gain-stiffness", "stop, fault", replace(_FLAT, stop_within_s=2.5), "gain 0.1", map=DISP, force_n=2.0),
        what="at 2 N: gain 0.1; stiffness_min_n_mm 10000, half of the true stiffness",
        limits={"stiffness_min_n_mm": 10_000},
    ),
    second("cell-tenfold-gain", "true load within its bounds", _SAFE, "gain 10", device=_SENSED, force_n=2.0),
    second("specimen-breaks", "stop, fault", replace(_FLAT, codes=(Code.LOAD_JUMP, Code.LIMIT, *_STANDS)), "break 1", force_n=200.0),
    second("specimen-slips-100-n", "true load within its bounds", _SAFE, "slip 100", force_n=200.0),
)

STATES = (
    second("extension-freezes", "stop, fault", replace(_FLAT, stop_within_s=3.0), "efreeze 1"),
    second("extension-and-force-freeze", _WITHIN_2, _FLAT, "efreeze 1", "freeze 1", device=_SENSED),
    second("extension-and-force-freeze-counter", _WITHIN_2, _FLAT, "efreeze 1", "freeze 1", device=_SENSED, map=COUNT),
    second("extension-jumps", "stop at the extension beyond its limit", _AT_ONCE, "ejump 5"),
    second(
        "state-stuck-at-moving",
        "fault: the motion does not end",
        Expected(stop_within_s=15.0, since_force_n=297.0, codes=(Code.MOTION_OVERDUE, Code.MOTION_TIMEOUT)),
        "stuckmoving 1",
    ),
    second(
        "state-stuck-at-still",
        "fault: the load changes although the device reports rest",
        replace(_FLAT, codes=()),
        "stuckstill 1",
    ),
    second("state-stuck-at-still-runaway", "stop, fault", replace(_FLAT, codes=()), "stuckstill 1", "runaway 1"),
    second("machine-in-fault", "stop, fault", replace(_FLAT, codes=(Code.DEVICE_FAULT,), stop_within_s=0.6), "trip 1"),
    second(
        "counter-runs-backwards",
        "stop, fault",
        replace(_FLAT, codes=(Code.DEVICE_RESTARTED, Code.FROZEN_READING)),
        "countback 1",
        map=COUNT,
    ),
    second("counter-stops", "stop, fault", replace(_FLAT, codes=(Code.FROZEN_READING,)), "countstop 1", map=COUNT),
    second("words-swapped-in-ramp", "stop, fault", _AT_ONCE, "swap 1"),
    second(
        "restart-with-swapped-words",
        "stop, fault",
        replace(_FLAT, codes=(Code.DEVICE_RESTARTED, Code.LIMIT)),
        "reboot 0",
        "swap 1",
        map=COUNT,
    ),
    second("restart-second-frame", "stop, fault", replace(_FLAT, codes=(Code.DEVICE_RESTARTED, Code.FOREIGN_ORDER)), "reboot 0"),
    second("stop-button-in-ramp", "no motion of its own; fault", replace(_FLAT, codes=()), "press 1", force_n=150.0),
)

DISPLACEMENT = (
    second("disp-cell-freezes", _BOUNDED, replace(_FLAT, stop_within_s=15.0), "freeze 1", map=DISP),
    second("disp-cell-freezes-late", _BOUNDED, replace(_FLAT, stop_within_s=15.0), "freeze 1", map=DISP, force_n=270.0),
    second(
        "disp-cell-freezes-with-noise", _BOUNDED, replace(_FLAT, stop_within_s=15.0), "noisyfreeze 1", map=DISP, device={"noise_n": 0.5}
    ),
    Scenario(
        "disp-cell-freezes-with-noise-orders-late",
        "at 60 N: noisyfreeze 1; noise_n 0.5; control is suspended for 0.7 s in each second, so that the drive rests between its orders",
        _BOUNDED,
        replace(_FLAT, stop_within_s=15.0, no_orders=False),
        (Act(When("ramping", force_n=60.0), ("noisyfreeze 1",)), *_LATE_ORDERS),
        DISP,
        peer=Peer.SECOND,
        device={"noise_n": 0.5},
        limits={"stale_after_s": 1.5},
        unloaded=0,
    ),
    second("disp-cell-clipped", _BOUNDED, replace(_FLAT, since_force_n=250.0, stop_within_s=15.0), "clip 250", map=DISP),
    second("disp-sign-turns", "stop, fault", replace(_FLAT, stop_within_s=3.0, codes=()), "flip 3", map=DISP, force_n=120.0),
    second("disp-cell-fades", "stop, fault", replace(_FLAT, stop_within_s=15.0), "fade 4", map=DISP, force_n=120.0),
    second("disp-half-gain", "stop at the jump of the reading", replace(_FLAT, codes=()), "gain 0.5", map=DISP, force_n=150.0),
    second("disp-2-s-late", "true load within its bounds", _SAFE, "late 2", map=DISP),
    second("disp-extension-freezes", "true load within its bounds", _SAFE, "efreeze 1", map=DISP),
    second("disp-both-freeze", _BOUNDED, replace(_FLAT, stop_within_s=15.0), "efreeze 1", "freeze 1", map=DISP),
    second("disp-jammed", "stop, fault", replace(_FLAT, stop_within_s=6.0, codes=()), "jam 1", map=DISP),
    second("disp-3-times-as-fast", "true load within its bounds", _SAFE, "ratex 3", map=DISP),
    # Each travel is replaced by the next before it ends, and a stop ends the last: the fault changes no motion, so nothing shows it.
    second("disp-travel-does-not-end", "true load within its bounds", _SAFE, "runaway 1", map=DISP),
    second("disp-wrong-direction", "stop, fault", replace(_FLAT, codes=(Code.WRONG_DIRECTION,)), "wrongway 1", map=DISP),
    second("disp-not-a-number", "stop, fault", _AT_ONCE, "nan 1", map=DISP),
    second("disp-specimen-breaks", "stop, fault", replace(_FLAT, codes=(), stop_within_s=15.0), "break 1", map=DISP, force_n=200.0),
    second("disp-3-times-as-stiff", "true load within its bounds", _SAFE, "ratex 1", map=DISP, device={"stiffness_n_mm": 60000}),
    second("disp-6-times-as-stiff", "true load within its bounds", _SAFE, "ratex 1", map=DISP, device={"stiffness_n_mm": 120000}),
)

SCENARIOS = (*FORCE, *STATES, *DISPLACEMENT)
