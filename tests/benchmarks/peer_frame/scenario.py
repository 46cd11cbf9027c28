"""What a scenario is, what must happen in it, and what was observed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from semlive.data.faults import FaultCode

FORCE_MAX_N = 400.0
PEAK_MAX_N = max(1.05 * FORCE_MAX_N, FORCE_MAX_N + 20.0)
"""Bar: the true force never goes above this, N."""
STALE_AFTER_S = 0.5
"""Default of `limits.stale_after_s`."""
STOP_BAR_S = STALE_AFTER_S + 0.1
"""Bar: from a violation or a loss to the stop order on the wire, s."""
TOLERANCE_N = 3.0
"""`protocol.load_tolerance_n` of the scenarios."""
Settings = Mapping[str, object]


class Ending(StrEnum):
    """How a run has to end."""

    COMPLETE = "complete"
    """Exit status 0, no fault."""
    FAULT = "fault"
    """Stop, then a fault that waits for the operator."""
    REFUSED = "refused"
    """Exit status 2 or a fault, before any motion was ordered."""
    PROMPTED = "asked"
    """No motion before the operator answered."""
    STOPPED = "stopped"
    """Stop, and an exit status that is not 0; where there is no log left to hold a fault."""
    RECOVERED = "recovered"
    """Stop and a fault; after the operator resumed, the run completes."""
    SAFE = "safe"
    """Any way, as long as the load stays within its bounds."""


class Group(StrEnum):
    """Where a scenario comes from."""

    README = "list of the independent frame"
    OWN = "own"
    HEALTHY = "healthy"
    MAPS = "shipped maps and drivers"


class Peer(StrEnum):
    """Which load frame is on the other side."""

    C = "frame.c"
    SECOND = "second frame"
    MAP = "device of a shipped map"


@dataclass(frozen=True, slots=True)
class When:
    """An instant of a run; every condition that is given has to hold.

    Attributes:
        state: of the daemon; empty: before the daemon is started.
        step: index of the protocol's step in which the state counts; None: any.
        force_n: the true force is at or above this since the state was reached; None: not asked.
        after_s: so much later, s.
    """

    state: str = ""
    step: int | None = None
    force_n: float | None = None
    after_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Act:
    """What is done at an instant.

    Attributes:
        when: the instant, looked for after the acts before.
        commands: fault switches of the device, or actions on the daemon (`laboratory.ACTIONS`), which begin with ``!``.
        is_fault: times are measured from the first act for which this is True.
    """

    when: When
    commands: tuple[str, ...]
    is_fault: bool = True


@dataclass(frozen=True, slots=True)
class Expected:
    """The required reaction.

    Attributes:
        ending: how the run ends.
        stop_within_s: longest time from the instant to the first stop order on the wire, s; None: no stop is needed or possible.
        since_force_n: the instant is when the true force passes this after the fault, N; None: the fault itself.
        timed: the time to the stop counts in the bar for a violation or a loss.
        codes: fault codes that fit; others are noted, not failed.
        peak_n: largest true force, N; None: the device does not obey, so the force is not bounded by any order.
        repeats: stop orders have to continue as long as it moves.
        message: required message to the operator, as a regular expression; empty: any message.
        loaded_pairs: pairs under load that are accepted.
        unloads: the plan takes load off.
        no_orders: no motion may be ordered after the fault.
        final_n: loads at which it may be at the end, within `TOLERANCE_N`; empty: anywhere.
        registers: values that the device must report at the end, such as ``r11``.
    """

    ending: Ending = Ending.FAULT
    stop_within_s: float | None = 2.0
    since_force_n: float | None = None
    timed: bool = False
    codes: tuple[FaultCode, ...] = ()
    peak_n: float | None = PEAK_MAX_N
    repeats: bool = False
    message: str = ""
    loaded_pairs: int | None = 0
    unloads: bool = False
    no_orders: bool = True
    final_n: tuple[float, ...] = ()
    registers: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Scenario:
    """One trial.

    Attributes:
        name: unique, with dashes.
        what: what the device or its surroundings do, for the table.
        must: the required reaction, as a text.
        expected: the same, to be checked.
        acts: what is done, in order.
        map: description of the device: a file of the peer's folder, or one of this package.
        group: where it comes from.
        peer: which device.
        clients: how many connections the independent frame takes at the same time.
        device: options of the second frame, or of the device of a shipped map.
        settings: more settings of the driver.
        protocol: changes to `protocol`.
        limits: changes to `limits`.
        text: replacements in the text of the configuration, for what a YAML writer would not write.
        unloaded: unloaded pairs before the loads.
        frames_after_s: from the begin of imaging to the first frame, s.
        watch_s: how long it is watched after the last act if no fault comes, s.
        linger_s: how long it is watched after a fault, s.
        short: whether the short campaign runs it.
        ends_within_s: longest time from SIGTERM to the end of the daemon, s.
        driver: of the load frame.
        kind: which device of a shipped map (`KINDS` in map_device.py).
        frame: settings of the driver in place of those of a Modbus frame; ``{port}`` and ``{folder}`` are replaced.
        hand: a person moves the machine as the daemon requests, and types the load if ``types``.
    """

    name: str
    what: str
    must: str
    expected: Expected
    acts: tuple[Act, ...] = ()
    map: str = "map_f32.yaml"
    group: Group = Group.OWN
    peer: Peer = Peer.C
    clients: int = 1
    device: Settings = field(default_factory=dict)
    settings: Settings = field(default_factory=dict)
    protocol: Settings = field(default_factory=dict)
    limits: Settings = field(default_factory=dict)
    text: tuple[tuple[str, str], ...] = ()
    unloaded: int = 1
    frames_after_s: float = 0.3
    watch_s: float = 20.0
    linger_s: float = 2.0
    short: bool = False
    ends_within_s: float = 25.0
    driver: str = "modbus"
    kind: str = ""
    frame: Settings = field(default_factory=dict)
    hand: str = ""

    @property
    def is_healthy(self) -> bool:
        """Nothing is wrong, and nothing may be stopped."""
        return self.group is Group.HEALTHY or (self.group is Group.MAPS and self.expected.ending is Ending.COMPLETE and not self.acts)

    @property
    def is_displacement(self) -> bool:
        """The machine is brought to a load by short travels."""
        return self.map.startswith("map_disp") or "approach" in self.frame


@dataclass(frozen=True, slots=True)
class Fault:
    """A `/fault` message: experiment time is wall time here."""

    time_ns: int
    code: str
    what: str
    action: str


@dataclass(frozen=True, slots=True)
class Observed:
    """Observation of a scenario; instants are CLOCK_MONOTONIC in s.

    Attributes:
        fault_s: when the fault was injected; None: none was.
        ended_s: when the trial ended it from outside, or it had ended by itself.
        by_itself: the daemon ended without a request.
        exit_code: of the daemon; None if it had to be killed.
        said: its output, on one line.
        faults: `/fault` messages.
        states: states in order.
        loaded_pairs: accepted pairs under load.
        peak_n: largest true force until the end, N.
        final_n: true force at the end, N.
        instant_s: from when the time to the stop counts; None if it never came.
        stops_s: stop orders on the wire after that instant.
        silence_s: longest time without a further stop order while it moved, s.
        rested: it rested at the end.
        unloadings: orders that would take load off, as texts.
        orders: motions ordered after the fault.
        moved: any motion was ordered at all.
        registers: values of registers that the device reported at the end.
        second: exit code and text of a second daemon, if there was one.
        asked: the run waited for the operator, paused or in recover, after the fault.
        wall_s: how long the trial took, s.
        start_s: from the start of the process to its first state, s.
    """

    fault_s: float | None
    ended_s: float
    by_itself: bool
    exit_code: int | None
    said: str
    faults: tuple[Fault, ...]
    states: tuple[str, ...]
    loaded_pairs: int
    peak_n: float
    final_n: float
    instant_s: float | None
    stops_s: tuple[float, ...]
    silence_s: float
    rested: bool
    unloadings: tuple[str, ...]
    orders: int
    moved: bool
    registers: Mapping[str, str]
    second: str
    asked: bool
    wall_s: float
    start_s: float

    @property
    def stop_after_s(self) -> float | None:
        """From the instant to the first stop order on the wire, s; None if none came."""
        return self.stops_s[0] - self.instant_s if self.stops_s and self.instant_s is not None else None
