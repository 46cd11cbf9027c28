"""A run without anything real: devices of a few lines, experiment time by hand. Commands go in, events come out."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from semlive.data.experiment import HoldRule, Limits, Phase, Plan, Step
from semlive.data.frame import FrameInfo
from semlive.data.loading import DeviceIdentity, LoadSample, MotionState, StageSample, StopOnLinkLoss
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.engine import (
    AcceptPair,
    Command,
    CommandAcknowledged,
    Device,
    EngineState,
    Event,
    FrameScanned,
    LinksOpening,
    LinksReady,
    LoadReading,
    MoveStage,
    OperatorAction,
    OperatorCommand,
    RampTo,
    RejectFrame,
    StageReading,
    State,
    StopMotion,
    Tick,
    Transition,
    start,
    step,
)

S = 1_000_000_000
T0 = 1_700_000_000 * S
LIMITS = Limits(
    force_min_n=-50.0,
    force_max_n=2300.0,
    extension_min_mm=-0.5,
    extension_max_mm=2.0,
    force_rate_max_n_s=100.0,
    force_step_max_n=500.0,
    stage_travel_um=100.0,
)
HOLD = HoldRule(hold_s=30.0, settle_s=5.0, motion_timeout_s=300.0, frame_timeout_s=400.0)
IDENTITY = DeviceIdentity("bench", simulated=True, stop_on_link_loss=StopOnLinkLoss.VERIFIED, force_max_n=4300.0)


def plan_of(*stops: tuple[tuple[float, float], float | None], hold: HoldRule = HOLD, triggered: bool = False) -> Plan:
    """A plan of (shift_um, load_n)."""
    steps = tuple(Step(i, Phase.TENSION, shift, shift, load) for i, (shift, load) in enumerate(stops))
    return Plan(steps, hold, LIMITS, ramp_rate_n_s=50.0, triggered=triggered)


def frame(
    export: int, start_ns: int, *, frame_s: float = 90.0, sigma_s: float = 0.3, width_px: int = 1024, dwell_s: float = 1e-4
) -> FrameInfo:
    """A frame that was scanned from `start_ns` on."""
    source = Provenance.FILE
    timing = ScanTiming(Sourced(dwell_s, source), Sourced(frame_s / 884, source), Sourced(frame_s, source), Sourced(1, source))
    pixel = Sourced(1.25e-6, source)
    return FrameInfo(export, f"frame{export:04}.tif", "fei", width_px, 884, 0, timing, Sourced(start_ns, source), sigma_s, pixel)


@dataclass
class Run:
    """An engine with devices that obey at once or after a while."""

    plan: Plan
    has_load: bool = True
    has_stage: bool = True
    poll_s: float = 0.5
    force_n: float = 0.0
    xy_um: tuple[float, float] = (7.0, -3.0)
    state: EngineState = field(init=False)
    now_ns: int = T0
    commands: list[Command] = field(default_factory=list)
    load_goal_n: float | None = None
    stage_goal_um: tuple[float, float] | None = None
    target_n: float = 0.0
    exports: int = 0
    unresponsive: bool = False
    crosshead_mm: float = 0.0
    """Moves with ordered ramps only: a force that is set by hand is a load that relaxed."""

    def __post_init__(self) -> None:
        self.state = start(self.plan, self.now_ns)

    def send(self, event: Event) -> tuple[Command, ...]:
        """One event; its commands are obeyed and kept."""
        self.state, given = step(self.state, event)
        self.commands.extend(given)
        for command in given:
            match command:
                case RampTo(force_n=force_n) if not self.unresponsive:
                    self.load_goal_n = self.target_n = force_n
                    self.send(CommandAcknowledged(self.now_ns, Device.LOAD_FRAME))
                case MoveStage(x_um=x_um, y_um=y_um) if not self.unresponsive:
                    self.stage_goal_um = (x_um, y_um)
                    self.send(CommandAcknowledged(self.now_ns, Device.STAGE))
                case StopMotion():
                    self.load_goal_n = self.stage_goal_um = None
        return given

    def begin(self) -> None:
        """Up to the first step."""
        self.send(LinksOpening(self.now_ns))
        self.readings()
        self.send(LinksReady(self.now_ns, IDENTITY if self.has_load else None, IDENTITY if self.has_stage else None))
        self.readings()
        self.send(OperatorAction(self.now_ns, OperatorCommand.START))

    def readings(self) -> None:
        """One sample of each device."""
        if self.has_load:
            self.send(LoadReading(self.now_ns, self.load_sample()))
        if self.has_stage:
            moving = MotionState.STOPPED if self.stage_goal_um is None else MotionState.MOVING
            self.send(StageReading(self.now_ns, StageSample(0, self.now_ns, 0, *self.xy_um, moving)))

    def load_sample(self) -> LoadSample:
        """The present state of the load frame."""
        moving = MotionState.STOPPED if self.load_goal_n is None else MotionState.MOVING
        return LoadSample(0, self.now_ns, 0, self.force_n, self.crosshead_mm, moving, self.target_n)

    def wait(self, seconds: float, until: State | None = None) -> None:
        """Let time pass (devices move at 50 N/s, the stage arrives at the next poll), or only until a state is reached."""
        end_ns = self.now_ns + round(seconds * S)
        while self.now_ns < end_ns and self.state.state is not until:
            self.now_ns += round(self.poll_s * S)
            if self.load_goal_n is not None:
                most = 50.0 * self.poll_s
                step_n = max(-most, min(most, self.load_goal_n - self.force_n))
                self.force_n, self.crosshead_mm = self.force_n + step_n, self.crosshead_mm + step_n / 5000
                if self.force_n == self.load_goal_n:
                    self.load_goal_n = None
            if self.stage_goal_um is not None:
                self.xy_um, self.stage_goal_um = self.stage_goal_um, None
            self.readings()
            self.send(Tick(self.now_ns))

    def reach(self, state: State, within_s: float = 200.0) -> None:
        """Let time pass until a state is reached."""
        self.wait(within_s, state)
        assert self.state.state is state, f"in {self.state.state} instead of {state}: {self.state.message}"

    def fail_and_resume(self) -> None:
        """A load beyond its limit for a while, a fault; then somebody acknowledges it and resumes."""
        self.force_n = -60.0
        self.wait(1.0)
        assert self.state.state is State.FAULT
        self.force_n = 0.0
        self.wait(1.0)
        for _ in range(2):
            self.send(OperatorAction(self.now_ns, OperatorCommand.RESUME))

    def scan(self, start_ns: int | None = None, **kwargs: float) -> FrameInfo:
        """Scan a frame from `start_ns` (now) on, let its time pass, and export it."""
        info = frame(self.exports, self.now_ns if start_ns is None else start_ns, **kwargs)  # type: ignore[arg-type]
        self.exports += 1
        if start_ns is None and self.state.state is State.IMAGING:
            self.wait(1.0)
            info = replace(info, start_time_ns=Sourced(self.now_ns, Provenance.FILE))
        self.wait((info.end_time_ns - self.now_ns) / 1e9 + 1.5)
        self.send(FrameScanned(self.now_ns, info))
        self.wait(2.0)
        return info

    def of(self, kind: type) -> list:
        """All commands of a kind so far."""
        return [c for c in self.commands if isinstance(c, kind)]

    @property
    def accepted(self) -> list[AcceptPair]:
        """Pairs so far."""
        return self.of(AcceptPair)

    @property
    def refusals(self) -> list[str]:
        """Reasons so far."""
        return [c.reason for c in self.commands if isinstance(c, RejectFrame)]

    @property
    def path(self) -> list[State]:
        """States entered so far."""
        return [c.after for c in self.commands if isinstance(c, Transition)]


def without_stage_tolerance(hold: HoldRule) -> HoldRule:
    """A rule that accepts any stage."""
    return replace(hold, stage_tolerance_um=1e9)
