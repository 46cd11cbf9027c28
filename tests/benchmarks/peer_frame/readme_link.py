"""The independent frame's own list: links, starts, orders, second programs, and what concerns the daemon or the configuration."""

from __future__ import annotations

from dataclasses import replace

from semlive.data.faults import FaultCode as Code

from .scenario import Act, Ending, Expected, Group, Scenario, When

_LOST = Expected(stop_within_s=0.6, timed=True, codes=(Code.LINK_LOST, Code.DEVICE_FAULT, Code.ORDER_REFUSED))
_NO_STOP = replace(_LOST, stop_within_s=None, timed=False, message="own (emergency )?stop|emergency stop")
_COMPLETE = Expected(Ending.COMPLETE, stop_within_s=None, loaded_pairs=1, no_orders=False)
_REFUSED = Expected(Ending.REFUSED, stop_within_s=None, loaded_pairs=None)
_AS_WRITTEN = Expected(Ending.SAFE, stop_within_s=None, loaded_pairs=None, no_orders=False, final_n=(0.0, 300.0))
_SECOND_REFUSED = replace(_COMPLETE, message="second run: exit status 2")
_BLIND = "write the stop first, on a new connection too, without waiting for replies"


def _link(name: str, must: str, expected: Expected, *commands: str, then: tuple[Act, ...] = (), short: bool = False) -> Scenario:
    """In the ramp under load at 60 N."""
    acts = (Act(When("ramping", force_n=60.0), commands), *then)
    what = "; then ".join(", ".join(act.commands) for act in acts)
    return Scenario(name, f"at 60 N: {what}", must, expected, acts, group=Group.README, short=short)


def _later(after_s: float, *commands: str) -> tuple[Act, ...]:
    return (Act(When("ramping", force_n=60.0, after_s=after_s), commands),)


def _refused(name: str, what: str, *text: tuple[str, str], **sections: dict[str, object]) -> Scenario:
    """A configuration that must be refused before the first motion."""
    item = Scenario(name, what, "refused with name and line, before any motion", _REFUSED, group=Group.README, text=text)
    return replace(item, **sections)


LINKS = (
    _link("writes-refused", "stop orders, repeated as long as it moves", replace(_LOST, repeats=True), "excw 6"),
    _link("reads-refused", "stop, fault", _LOST, "excr 6"),
    _link("reads-refused-shortly", "stop, fault", _LOST, "excr 5", then=_later(0.3, "excr 0")),
    _link("reply-250-ms-late", "the run completes", _COMPLETE, "delay 250"),
    _link("reply-500-ms-late", _BLIND, _LOST, "delay 500"),
    replace(
        _link(
            "reply-3-s-late",
            f"{_BLIND}; this device takes no request while it delays one, so 3 s more are allowed",
            replace(_LOST, stop_within_s=3.6, timed=False),
            "delay 3000",
        ),
        linger_s=4.0,
    ),
    _link("wrong-transaction-number", _BLIND, _LOST, "badtid 1", short=True),
    _link("reset", "stop, fault", _LOST, "rst 1"),
    _link("resets", "try again until a stop order is acknowledged", replace(_LOST, repeats=True), "rst 30"),
    _link("silence", "fault; name the machine's own stop", _NO_STOP, "hole 1"),
    _link(
        "silence-5-s",
        "stop when the link is back",
        replace(_LOST, stop_within_s=6.5, timed=False),
        "hole 1",
        then=_later(5.0, "hole 0"),
    ),
)

ORDERS = (
    Scenario(
        "loaded-at-start",
        "F = 350 N, E = 0.0175 mm before the start",
        "refuse or ask before the first unloaded pair",
        Expected(Ending.PROMPTED, stop_within_s=None, codes=(Code.LOADED_AT_START,)),
        (Act(When(), ("F 350", "E 0.0175")),),
        group=Group.README,
        short=True,
    ),
    Scenario(
        "neighbouring-registers",
        "16 bit; registers 11 and 13 belong to the maker's program",
        "write only registers that the map names",
        replace(_COMPLETE, registers={"r11": "777", "r13": "5000"}),
        map="map_i16.yaml",
        group=Group.README,
    ),
    replace(_refused("rate-rounded-to-0", "16 bit; ramp_rate_n_s 0.04", protocol={"ramp_rate_n_s": 0.04}), map="map_i16.yaml", short=True),
    replace(
        _refused(
            "beyond-number-range",
            "16 bit, at most 3276.7 N; loads 300, 1900, 3500 N",
            protocol={"loads_n": [300.0, 1900.0, 3500.0], "ramp_rate_n_s": 150},
            limits={"force_max_n": 4000.0, "force_step_max_n": 2000.0},
        ),
        expected=replace(_REFUSED, peak_n=None),
        map="map_i16.yaml",
    ),
)

MASTERS = (
    Scenario(
        "two-runs-ramping",
        "a second run with another name while the first ramps",
        "the second is refused, the first is not disturbed",
        _SECOND_REFUSED,
        (Act(When("ramping", force_n=60.0), ("!second 20",), is_fault=False),),
        group=Group.README,
        clients=8,
        short=True,
    ),
    Scenario(
        "two-runs-at-rest",
        "a second run with a step of 20 N while the first waits at 150 N",
        "the second is refused, the first is not disturbed",
        _SECOND_REFUSED,
        (Act(When("imaging", step=1, after_s=0.5), ("!second 20",), is_fault=False),),
        group=Group.README,
        clients=8,
        protocol={"loads_n": [150.0]},
        frames_after_s=8.0,
    ),
    Scenario(
        "run-folder-deleted",
        "in the ramp the run's folder is deleted and the same configuration is started again",
        "the second is refused; the first stops",
        Expected(Ending.STOPPED, stop_within_s=2.0, message="second run: exit status 2"),
        (Act(When("ramping", force_n=60.0), ("!delete",)),),
        group=Group.README,
        clients=8,
    ),
    Scenario(
        "second-process-same-run",
        "in the ramp the same configuration is started with --resume",
        "the second is refused, the first is not disturbed",
        _SECOND_REFUSED,
        (Act(When("ramping", force_n=60.0), ("!same --resume",), is_fault=False),),
        group=Group.README,
        clients=8,
    ),
    Scenario(
        "control-killed",
        "in the ramp: wdog 2, kill -9 of control; then --resume",
        "the device's own watchdog stops it; nothing moves before the operator resumes",
        Expected(Ending.PROMPTED, stop_within_s=None),
        (
            Act(When("ramping", force_n=30.0), ("wdog 2",), is_fault=False),
            Act(When("ramping", force_n=60.0), ("!signal KILL", "!restart --resume")),
        ),
        group=Group.README,
        watch_s=12.0,
    ),
    Scenario(
        "control-suspended",
        "in the ramp: wdog 2, SIGSTOP of control for 4 s",
        "the device's own watchdog stops it; fault when control continues",
        Expected(stop_within_s=6.0),
        (
            Act(When("ramping", force_n=30.0), ("wdog 2",), is_fault=False),
            Act(When("ramping", force_n=60.0), ("!signal STOP",)),
            Act(When("ramping", force_n=60.0, after_s=4.0), ("!signal CONT",)),
        ),
        group=Group.README,
    ),
)

_DEEP = "[" * 5000 + "]" * 5000
CONFIGURATIONS = (
    _refused("config-key-twice", "force_max_n twice, 400 and 40000", ("force_max_n: 400.0", "force_max_n: 400.0\n  force_max_n: 40000.0")),
    _refused("config-section-twice", "limits twice", ("dic:", "limits:\n  force_max_n: 40000.0\ndic:")),
    _refused("config-infinite-limit", "force_max_n .inf", ("force_max_n: 400.0", "force_max_n: .inf")),
    _refused("config-infinite-time", "hold_s .inf", ("hold_s: 1.0", "hold_s: .inf")),
    _refused("config-infinite-tolerance", "load_tolerance_n .inf", ("load_tolerance_n: 3.0", "load_tolerance_n: .inf")),
    replace(
        _refused("config-octal", "loads_n [0300], 192 in YAML 1.1", ("loads_n:\n  - 300", "loads_n: [0300]")),
        must="refused, or 300 N as written",
        expected=_AS_WRITTEN,
    ),
    _refused("config-underscore", "ramp_rate_n_s 3_0", ("ramp_rate_n_s: 30", "ramp_rate_n_s: 3_0")),
    _refused("config-sexagesimal", "loads_n [1:30]", ("loads_n:\n  - 300", "loads_n: [1:30]")),
    _refused("config-tolerance", "load_tolerance_n 1e6", protocol={"load_tolerance_n": 1e6}),
    _refused("config-rate", "ramp_rate_n_s 1e-12", protocol={"ramp_rate_n_s": 1e-12}),
    _refused("config-lost-below-stale", "lost_after_s 0.2", limits={"lost_after_s": 0.2}),
    _refused("config-extension-inverted", "extension limits 2 to -0.5", limits={"extension_min_mm": 2.0, "extension_max_mm": -0.5}),
    _refused("config-negative-drop", "force_drop_max_n -10", limits={"force_drop_max_n": -10.0}),
    _refused("config-nested", "lists nested 5000 deep", ("name: sheet", f"name: {_DEEP}")),
    Scenario(
        "config-stiffness-kn",
        "displacement drive; stiffness 20 instead of 20000 N/mm",
        "no move can exceed the limits, whatever the stiffness",
        Expected(Ending.SAFE, stop_within_s=None, loaded_pairs=None, no_orders=False),
        map="map_disp.yaml",
        group=Group.README,
        settings={"approach": {"stiffness_n_mm": 20, "speed_max_mm_s": 1.5}},
        watch_s=30.0,
    ),
)

SCENARIOS = (*LINKS, *ORDERS, *MASTERS, *CONFIGURATIONS)
