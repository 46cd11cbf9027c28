"""Own scenarios: starts, resumes, stops by the operator, other masters, slow changes at rest, and configurations."""

from __future__ import annotations

from dataclasses import replace

from semlive.data.faults import FaultCode as Code

from .own_cell import DISP, LOAD
from .scenario import Act, Ending, Expected, Peer, Scenario, When

_PROMPTED = Expected(Ending.PROMPTED, stop_within_s=None, codes=(Code.LOADED_AT_START, Code.UNORDERED_MOTION))
_INTERRUPTED = Expected(stop_within_s=None)
_COMPLETE = Expected(Ending.COMPLETE, stop_within_s=None, loaded_pairs=1, no_orders=False)
_STOPPED = Expected(Ending.STOPPED, stop_within_s=0.6, timed=True)
_RECOVERED = Expected(Ending.RECOVERED, stop_within_s=2.0, loaded_pairs=1, no_orders=False)
_FOREIGN = Expected(stop_within_s=2.0, codes=(Code.FOREIGN_ORDER, Code.UNORDERED_MOTION, Code.MOVED_AT_REST))
_MOVED = Expected(stop_within_s=None, codes=(Code.MOVED_AT_REST,))
_REFUSED = Expected(Ending.REFUSED, stop_within_s=None, loaded_pairs=None)
_SAFE = Expected(Ending.SAFE, stop_within_s=None, loaded_pairs=None, no_orders=False)
_ASK_FIRST = "refuse or ask before anything is ordered"
_IN_RAMP = When("ramping", force_n=60.0)
_RESUMES = (
    Act(When("fault", after_s=1.5), ("freeze 0", "runaway 0", "!type resume")),
    Act(When("recover", after_s=0.5), ("!type resume",)),
)


def _start(
    name: str, what: str, *commands: str, must: str = _ASK_FIRST, expected: Expected = _PROMPTED, map: str = "map_f32.yaml"
) -> Scenario:
    """Something is so before the run begins."""
    return Scenario(f"start-{name}", what, must, expected, (Act(When(), commands),), map, watch_s=12.0)


STARTS = (
    _start("at-60-n", "F = 60 N at the start", "F 60", "E 0.003"),
    _start("at-minus-40-n", "F = -40 N at the start", "F -40", "E -0.002"),
    _start("disp-at-150-n", "F = 150 N at the start", "F 150", "E 0.0075", map="map_disp.yaml"),
    _start("at-1-n", "F = 1 N at the start, within the tolerance", "F 1", "E 0.00005", must="the run completes", expected=_COMPLETE),
    _start(
        "moving",
        "somebody drives it to 395 N while the run begins",
        "K 20000",
        must="stop, and no motion of its own",
        expected=replace(_PROMPTED, peak_n=420.0),
    ),
    _start("beyond-limit", "F = 410 N at the start", "F 410", "E 0.0205", expected=_PROMPTED),
)
_MOVING = replace(STARTS[4], acts=(Act(When(), ("goto 395",)), Act(When("connecting"), ("F 0", "goto 395"), is_fault=False)), clients=1)

COURSES = (
    Scenario(
        "resume-after-freeze",
        "freeze 1 at 60 N; after the fault the reading is right again, and the operator resumes",
        "stop, fault; after the resume the run completes",
        _RECOVERED,
        (Act(_IN_RAMP, ("freeze 1",)), *_RESUMES),
        unloaded=0,
    ),
    Scenario(
        "resume-beyond-target",
        "runaway to beyond the target; the operator resumes",
        "never unloaded: fault or question",
        Expected(since_force_n=303.0, stop_within_s=0.6, timed=True, codes=(Code.OVERSHOOT,), loaded_pairs=None, no_orders=False),
        (Act(_IN_RAMP, ("runaway 1",)), *_RESUMES),
        unloaded=0,
        linger_s=4.0,
    ),
    Scenario(
        "resume-still-frozen",
        "freeze 1 at 60 N; the operator resumes twice although the reading is still constant",
        "stop each time; the true load within its bounds",
        Expected(stop_within_s=2.0, no_orders=False),
        (
            Act(_IN_RAMP, ("freeze 1", "runaway 1")),
            Act(When("fault", after_s=1.0), ("!type resume",)),
            Act(When("recover", after_s=0.5), ("!type resume",)),
        ),
        unloaded=0,
        linger_s=6.0,
    ),
    Scenario(
        "resume-after-panel",
        "in the hold somebody drives it to 380 N; the operator resumes",
        "never unloaded: fault or question",
        Expected(stop_within_s=2.0, no_orders=False, loaded_pairs=None),
        (
            Act(When("holding", after_s=0.5), ("goto 380",)),
            Act(When("fault", after_s=3.5), ("!type resume",)),
            Act(When("recover", after_s=0.5), ("!type resume",)),
        ),
        unloaded=0,
        protocol={"hold_s": 5.0},
        linger_s=4.0,
    ),
    Scenario(
        "killed-and-moved",
        "in the hold control is killed, and somebody drives it to 380 N; then --resume --yes",
        "ask, order nothing",
        replace(_INTERRUPTED, codes=(Code.MOVED_AT_REST,)),
        (Act(When("holding", after_s=0.5), ("!signal KILL", "F 380", "E 0.019", "!restart --resume --yes")),),
        unloaded=0,
        protocol={"hold_s": 8.0},
        watch_s=12.0,
    ),
    Scenario(
        "killed-and-restarted",
        "in the ramp control is killed and the device restarts; then --resume --yes",
        "ask, order nothing",
        replace(_INTERRUPTED, codes=(Code.DEVICE_RESTARTED,)),
        (Act(_IN_RAMP, ("!signal KILL", "reboot 0", "!restart --resume --yes")),),
        unloaded=0,
        watch_s=12.0,
    ),
    Scenario(
        "killed-while-moving",
        "in the ramp control is killed, and the device moves on; then --resume --yes",
        "stop the device when it is read first; ask, order nothing",
        Expected(Ending.PROMPTED, stop_within_s=None),
        (Act(_IN_RAMP, ("!signal KILL", "!restart --resume --yes")),),
        unloaded=0,
        protocol={"ramp_rate_n_s": 10},
        watch_s=12.0,
    ),
    Scenario("operator-stops", "the operator types stop in the ramp", "stop", _STOPPED, (Act(_IN_RAMP, ("!type stop",)),), unloaded=0),
    Scenario("operator-aborts", "the operator types abort in the ramp", "stop", _STOPPED, (Act(_IN_RAMP, ("!type abort",)),), unloaded=0),
    Scenario(
        "operator-pauses",
        "the operator types pause in the ramp; the device ignores three stops",
        "stop orders as long as it moves",
        replace(_STOPPED, repeats=True),
        (Act(_IN_RAMP, ("ignorestop 3", "!type pause")),),
        unloaded=0,
        watch_s=6.0,
    ),
    Scenario(
        "terminated",
        "SIGTERM in the ramp; the device ignores three stops",
        "stop orders as long as it moves",
        replace(_STOPPED, repeats=True),
        (Act(_IN_RAMP, ("ignorestop 3", "!signal TERM")),),
        unloaded=0,
    ),
    Scenario(
        "interrupted-with-late-answers",
        "Ctrl-C in the ramp; the answers come 500 ms late",
        "write the stop first",
        _STOPPED,
        (Act(_IN_RAMP, ("delay 500", "!signal INT")),),
        unloaded=0,
    ),
    Scenario(
        "interrupted-unobeyed",
        "Ctrl-C in the ramp; the device obeys no stop and runs away",
        "stop orders as long as it moves, and report it",
        replace(
            _STOPPED, repeats=True, peak_n=None, message="does not (obey|stop)|moves on|own (emergency )?stop|emergency stop|not confirm"
        ),
        (Act(_IN_RAMP, ("runaway 1", "ignorestop 100000", "!signal INT")),),
        unloaded=0,
        watch_s=30.0,
    ),
)


def _master(name: str, what: str, when: When, *commands: str, **changes: object) -> Scenario:
    """Another master on another computer orders the independent frame."""
    item = Scenario(
        f"master-{name}", what, "stop, fault, nothing ordered again", _FOREIGN, (Act(when, commands),), unloaded=0, clients=8, watch_s=9.0
    )
    return replace(item, **changes)


MASTERS = (
    _master("target-in-ramp", "another master orders 390 N in the ramp", _IN_RAMP, "!order 1 390 30"),
    _master("rate-in-ramp", "another master orders the same load at 150 N/s", _IN_RAMP, "!order 1 300 150"),
    _master("down-in-ramp", "another master orders 20 N in the ramp", _IN_RAMP, "!order 1 20 30"),
    _master("stops-the-ramp", "another master stops the ramp", _IN_RAMP, "!order 2"),
    _master(
        "target-in-hold",
        "another master orders 150 N in the hold",
        When("holding", after_s=0.5),
        "!order 1 150 30",
        protocol={"hold_s": 5.0},
    ),
    _master(
        "target-in-imaging",
        "another master orders 380 N while frames are waited for",
        When("imaging", after_s=0.5),
        "!order 1 380 30",
        frames_after_s=6.0,
    ),
)


def _creeping(name: str, what: str, *commands: str, map: str = LOAD) -> Scenario:
    """A slow change at rest, on the second frame."""
    acts = (Act(When("holding", after_s=0.3), commands),)
    return Scenario(
        f"rest-{name}",
        what,
        "fault, never driven back",
        _MOVED,
        acts,
        map,
        peer=Peer.SECOND,
        unloaded=0,
        protocol={"hold_s": 8.0},
        watch_s=12.0,
    )


RESTS = (
    _creeping("creeps-up", "the load rises by 2 N/s in the hold, without motion", "creep 2"),
    _creeping("creeps-down", "the load falls by 2 N/s in the hold", "creep -2"),
    _creeping("disp-creeps-up", "the load rises by 2 N/s in the hold, displacement drive", "creep 2", map=DISP),
    replace(
        _creeping("moved-with-frozen-force", "freeze 1, and somebody drives it to 395 N", "freeze 1", "goto 395"),
        expected=replace(_MOVED, stop_within_s=2.0, codes=()),
    ),
    replace(
        _creeping("moved-with-state-still", "the state remains at rest, and somebody drives it to 395 N", "stuckstill 1", "goto 395"),
        expected=replace(_MOVED, stop_within_s=2.0, codes=()),
    ),
    _creeping("specimen-breaks", "the specimen breaks in the hold", "break 1"),
    replace(_creeping("trips", "the machine goes into fault in the hold", "trip 1"), expected=replace(_MOVED, codes=(Code.DEVICE_FAULT,))),
)


def _config(name: str, what: str, *text: tuple[str, str], **changes: object) -> Scenario:
    item = Scenario(f"config-{name}", what, "refused before any motion", _REFUSED, text=text)
    return replace(item, **changes)


CONFIGURATIONS = (
    _config("nan-limit", "force_max_n .nan", ("force_max_n: 400.0", "force_max_n: .nan")),
    _config("negative-rate", "ramp_rate_n_s -30", protocol={"ramp_rate_n_s": -30}),
    _config("rate-beyond-limit", "ramp_rate_n_s 500, limit 200", protocol={"ramp_rate_n_s": 500}),
    _config("load-beyond-limit", "loads_n [300, 500], limit 400", protocol={"loads_n": [300.0, 500.0]}),
    replace(
        _config("hex", "loads_n [0x12C], which is 300", ("loads_n:\n  - 300", "loads_n: [0x12C]")),
        must="refused, or 300 N as written",
        expected=replace(_SAFE, final_n=(0.0, 300.0)),
    ),
    _config("tolerance-fraction", "load_tolerance_fraction 2", protocol={"load_tolerance_fraction": 2.0}),
    _config("limits-inverted", "force_min_n 500", limits={"force_min_n": 500.0}),
    _config("poll-key-twice", "poll_s twice", ("poll_s: 0.05\n  settings", "poll_s: 0.05\n  poll_s: 5.0\n  settings")),
    _config("infinite-rate", "ramp_rate_n_s .inf", ("ramp_rate_n_s: 30", "ramp_rate_n_s: .inf")),
    _config("number-with-comma", "force_max_n '400,0'", ("force_max_n: 400.0", "force_max_n: 400,0")),
    Scenario(
        "i16-slow-ramp",
        "16 bit; rate 0.3 N/s, three steps of 0.1",
        "complete or refuse; never at another rate",
        replace(_SAFE, peak_n=25.0),
        map="map_i16.yaml",
        protocol={"loads_n": [5.0], "ramp_rate_n_s": 0.3, "load_tolerance_n": 1.0},
        unloaded=0,
    ),
    _config("i16-rate-between-steps", "16 bit; rate 0.14 N/s is sent as 0.1", map="map_i16.yaml", protocol={"ramp_rate_n_s": 0.14}),
)

SCENARIOS = (*STARTS[:4], _MOVING, STARTS[5], *COURSES, *MASTERS, *RESTS, *CONFIGURATIONS)
