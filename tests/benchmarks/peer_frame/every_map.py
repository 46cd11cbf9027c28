"""The faults of every shipped map and every driver, one scenario for each setup and fault."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from semlive.data.faults import FaultCode as Code

from .map_setups import SETUPS, Setup
from .scenario import Act, Ending, Expected, Group, Peer, Scenario, When

_STANDS = (
    Code.NO_RESPONSE,
    Code.FROZEN_READING,
    Code.TRAVEL_WITHOUT_LOAD,
    Code.SENSOR_RANGE,
    Code.RATE_NOT_KEPT,
    Code.WRONG_DIRECTION,
    Code.LOAD_JUMP,
    Code.LINK_LOST,
)
_AT_ONCE = Expected(stop_within_s=0.6, timed=True)
_LOST = Expected(stop_within_s=0.6, timed=True, codes=(Code.LINK_LOST, Code.DEVICE_FAULT, Code.ORDER_REFUSED))
_OBEYS_NOT = "does not (obey|stop)|moves on|own (emergency )?stop|emergency stop|not confirm"
_SAFE = Expected(Ending.SAFE, stop_within_s=None, loaded_pairs=None, no_orders=False)
_MOVED = Expected(stop_within_s=2.5, no_orders=True)
_FILE_FROZEN_S = 3.0
"""Default of `frozen_after_s` of a load file: a file that does not grow for longer is no reading."""
SHORT = {
    "bench-rtu-link-executes-without-answer",
    "mark10-frozen-force",
    "laumas-leadshine-frozen-force",
    "flintec-pi-wrong-sign",
    "mantracourt-oriental-wago-wrong-sign",
    "csv-oriental-file-stands-still",
    "operator-csv-frozen-force",
}
"""Scenarios that the tests run."""


# A person has to restart the expired watchdog of a WAGO coupler, and to switch on the servo of a PI controller after a power failure. Until
# then the stop cannot be confirmed, so the daemon waits for `limits.stop_timeout_s` (20 s) and for 12 s more before it ends.
_RESTARTED_BY_A_PERSON = {"wago_watchdog", "pi_c863"}


def _scenario(setup: Setup, name: str, must: str, expected: Expected, *commands: str, force_n: float = 60.0) -> Scenario:
    """A fault in a ramp, from a true force in N on."""
    full = f"{setup.name}-{name}"
    return Scenario(
        full,
        f"at {force_n:g} N: {', '.join(commands)}",
        must,
        expected,
        (Act(When("ramping", force_n=force_n), commands),),
        " ".join(setup.maps) or "no map",
        Group.MAPS,
        Peer.MAP,
        device=setup.device,
        limits=setup.limits,
        unloaded=0,
        short=full in SHORT,
        driver=setup.driver,
        kind=setup.kind,
        frame=setup.frame,
        hand=setup.hand,
        ends_within_s=45.0 if _RESTARTED_BY_A_PERSON & {*setup.maps} else 25.0,
    )


def _from_start(one: Scenario, what: str) -> Scenario:
    """The same with its commands before the daemon is started."""
    return replace(one, what=what, acts=(Act(When(), one.acts[0].commands),))


def _at_rest(one: Scenario, what: str) -> Scenario:
    """The same in the hold under load."""
    acts = (Act(When("holding", after_s=0.5), one.acts[0].commands),)
    return replace(one, what=what, acts=acts, protocol={"hold_s": 6.0}, watch_s=9.0)


def _healthy(setup: Setup) -> Scenario:
    """A plan of one load."""
    expected = Expected(Ending.COMPLETE, stop_within_s=None, loaded_pairs=1, no_orders=False, final_n=())
    one = _scenario(setup, "healthy", "the run completes without a fault", expected)
    return replace(one, what="nothing is wrong", acts=())


def _flat(setup: Setup) -> Expected:
    """A reading that does not follow the motion; a displacement drive is stopped after a bounded travel without load, not after a time."""
    return Expected(stop_within_s=2.0 if setup.has_force_loop else 15.0, codes=_STANDS)


def _cell(setup: Setup) -> Iterator[Scenario]:
    """Faults of the cell."""
    flat, away = _flat(setup), ("runaway 1",) if setup.has_force_loop or setup.hand else ()
    everything = ("freeze 1", "efreeze 1", "stuckmoving 1", *(("countstop 1",) if setup.has_counter else ()))
    bounded = "stop before the load passes its limit, fault"
    yield _scenario(setup, "frozen-force", bounded, flat, "freeze 1", *away)
    if not setup.hand:
        yield _scenario(setup, "frozen-everything", bounded, flat, *everything, *away)
    yield _scenario(setup, "saturated", bounded, replace(flat, since_force_n=200.0), "clip 200", *away)
    wrong = replace(flat, since_force_n=1.0, no_orders=False)
    yield _from_start(_scenario(setup, "wrong-sign", "stop, fault", wrong, "gain -1"), "the cell is wired the wrong way")
    from_file = setup.kind in ("hand", "csv_oriental")
    at_once = replace(_AT_ONCE, stop_within_s=0.7) if from_file else _AT_ONCE
    yield _scenario(setup, "not-a-number", "stop, fault", at_once, "nan 1")
    yield _scenario(setup, "end-of-range", "stop, fault", at_once, "inf 1")
    if from_file:
        yield _scenario(setup, "lost-value", "stop, fault", replace(at_once, codes=(Code.LINK_LOST,)), "lost 1")


def _stop_ignored(setup: Setup, beyond: Expected) -> Scenario:
    """The machine runs away, acknowledges stops and does not obey them."""
    must, expected = "stop orders as long as it moves; report it", replace(beyond, repeats=True, peak_n=None, message=_OBEYS_NOT)
    if "oriental_az" in setup.maps:  # the drive obeys the further stop of its map
        must, expected = "the next way to stop that the map states; fault", Expected(stop_within_s=None)
    return _scenario(setup, "stop-ignored", must, expected, "runaway 1", "ignorestop 100000")


def _motion(setup: Setup) -> Iterator[Scenario]:
    """Faults of the motion."""
    beyond = Expected(since_force_n=303.0, stop_within_s=0.6, timed=True, codes=(Code.OVERSHOOT, Code.LIMIT))
    if setup.hand:  # a person may overshoot: the request to stop comes with the fault, or at the limit
        beyond = replace(beyond, stop_within_s=2.0, timed=False, codes=(Code.WOULD_UNLOAD, Code.LIMIT), no_orders=False)
    rate = Expected(stop_within_s=1.5, codes=(Code.RATE_NOT_KEPT, Code.LOAD_JUMP, Code.OVERSHOOT, Code.LIMIT))
    moved = replace(_MOVED, codes=(Code.MOVED_AT_REST, Code.UNORDERED_MOTION, Code.FOREIGN_ORDER, Code.OVERSHOOT))
    if setup.has_force_loop or setup.hand:
        yield _scenario(setup, "runs-away", "stop beyond the target", beyond, "runaway 1")
    else:  # the stop order at the target ends a travel that does not end by itself
        yield _scenario(setup, "travel-does-not-end", "true load within its bounds", _SAFE, "runaway 1")
        yield _scenario(setup, "stops-1-s-late", "true load within its bounds", _SAFE, "runaway 1", "stopdelay 1")
    fast = ("true load within its bounds", _SAFE) if setup.hand else ("stop, fault", rate)
    yield _scenario(setup, "20-times-as-fast", *fast, "ratex 20", force_n=2.0)
    yield _stop_ignored(setup, beyond)
    if setup.has_force_loop or setup.hand:
        yield _scenario(setup, "target-overshot", "stop beyond the target", beyond, "targetx 1.25")
    if setup.hand:
        moved = replace(moved, no_orders=False, codes=(Code.WOULD_UNLOAD, Code.LIMIT))
        yield _at_rest(_scenario(setup, "moved-at-rest", "fault", moved, "hand 390 30"), "in the hold a person drives it to 390 N")
        return
    yield _at_rest(_scenario(setup, "moved-at-rest", "fault", moved, "goto 390"), "in the hold somebody drives it to 390 N at the panel")
    restarted = Expected(stop_within_s=None, codes=(Code.DEVICE_RESTARTED, Code.FOREIGN_ORDER))
    must = "no motion of its own; fault" if setup.has_force_loop else "true load within its bounds"
    one = _scenario(setup, "restarts", must, restarted if setup.has_force_loop else _SAFE, "reboot 0")
    yield replace(one, what="at 60 N: power off and on; orders and counter are forgotten")


def _links(setup: Setup) -> Iterator[Scenario]:
    """Faults of the links."""
    if setup.kind in ("hand", "csv_oriental"):
        still = Expected(stop_within_s=_FILE_FROZEN_S + 0.6, codes=_STANDS)
        one = _scenario(setup, "file-stands-still", "stop before the load passes its limit, fault", still, "only 9", "hole 1")
        yield replace(one, what="at 60 N: the load file does not grow any more")
        return
    no_stop = replace(_LOST, stop_within_s=None, timed=False, message=_OBEYS_NOT)
    yield _scenario(setup, "link-silent", "fault; name the machine's own stop", no_stop, "hole 1")
    yield _scenario(setup, "link-executes-without-answer", "write the stop without waiting for answers", _LOST, "mute 1")
    yield _scenario(setup, "reply-1-s-late", "write the stop without waiting for answers", _LOST, "delay 1000")
    yield _scenario(setup, "reply-100-ms-late", "true load within its bounds", _SAFE, "delay 100")
    for part, link in setup.parts.items():
        lost = no_stop if part == "drive" else _LOST
        one = _scenario(setup, f"{part}-silent", "fault; name the machine's own stop" if part == "drive" else "stop, fault", lost, "hole 1")
        yield replace(one, acts=(Act(one.acts[0].when, (f"only {link}", "hole 1")),), what=f"at 60 N: the link of the {part} is silent")


def _typed(setup: Setup) -> Iterator[Scenario]:
    """What a person types; semlive has no other reading, so the true load is in the hands of the person."""
    yield _healthy(setup)
    asks = Expected(Ending.STOPPED, stop_within_s=None, peak_n=None, loaded_pairs=0, no_orders=False)
    one = _scenario(setup, "types-not-a-number", "the load is requested again; no pair is accepted", asks, "!type nan")
    yield replace(one, what="at 60 N the person types nan", expected=replace(asks, ending=Ending.SAFE, loaded_pairs=None, peak_n=420.0))
    one = _scenario(setup, "types-wrong-load", "the load is requested again", asks, "!type -300")
    yield replace(one, what="at 60 N the person types -300", expected=replace(asks, ending=Ending.SAFE, loaded_pairs=None, peak_n=420.0))


def _of(setup: Setup) -> tuple[Scenario, ...]:
    if setup.hand == "types":
        return tuple(_typed(setup))
    return (_healthy(setup), *_cell(setup), *_motion(setup), *_links(setup))


EVERY_MAP: tuple[Scenario, ...] = tuple(one for setup in SETUPS for one in _of(setup))
