"""Random event sequences: whatever happens, the engine keeps its promises.

The oracle keeps its own record of every sample and every command, and judges accepted pairs from it alone.
"""

from __future__ import annotations

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from semlive.data.experiment import HoldRule, Limits, Phase, Plan, Step
from semlive.data.frame import FrameInfo
from semlive.data.loading import DeviceIdentity, LoadSample, MotionState, StageSample, StopOnLinkLoss
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.engine import (
    AcceptPair,
    CommandTaken,
    Device,
    DeviceFault,
    DeviceStopped,
    EngineState,
    Event,
    Finish,
    FrameScanned,
    FrameUnreadable,
    LinkBack,
    LinkLost,
    LinkStale,
    LoadReading,
    MoveStage,
    Opening,
    Operator,
    RampTo,
    Ready,
    RefuseFrame,
    StageReading,
    State,
    StopMotion,
    Tick,
    Transition,
    Verb,
    start,
    step,
)

S = 1_000_000_000
LIMITS = Limits(-50.0, 450.0, -1.0, 1.0, 60.0, 250.0, 30.0)
HOLD = HoldRule(hold_s=30.0, settle_s=3.0, load_tolerance_n=5.0, stage_tolerance_um=2.0, motion_timeout_s=200.0, frame_timeout_s=200.0)
STOPS = (((0.0, 0.0), 0.0), ((10.0, 0.0), 0.0), ((0.0, 0.0), 200.0), ((0.0, 0.0), 400.0))
PLAN = Plan(tuple(Step(i, Phase.TENSION, s, s, n) for i, (s, n) in enumerate(STOPS)), HOLD, LIMITS, ramp_rate_n_s=50.0)
IDENTITY = DeviceIdentity("bench", True, StopOnLinkLoss.VERIFIED)
FRAME_S = 20.0


class Protocol(RuleBasedStateMachine):
    def __init__(self) -> None:
        super().__init__()
        self.state: EngineState = start(PLAN, 0)
        self.now_ns = 0
        self.force_n, self.load_goal_n = 0.0, None
        self.xy_um, self.stage_goal_um = (0.0, 0.0), None
        self.samples: list[tuple[int, float, MotionState]] = []
        self.entered: list[tuple[int, State]] = []
        self.pairs: list[AcceptPair] = []
        self.judged: list[int] = []
        self.exported: list[int] = []
        self.finished = 0

    def tell(self, event: Event) -> None:
        before = self.state
        self.state, given = step(self.state, event)
        assert before is self.state or before.at not in {State.COMPLETE, State.ABORTED}
        at = before.at
        for command in given:
            match command:
                case Transition():
                    assert command.before is at
                    at = command.after
                    self.entered.append((command.time_ns, at))
                case RampTo(force_n=force_n, rate_n_s=rate):
                    assert at is State.RAMPING
                    assert LIMITS.force_min_n <= force_n <= LIMITS.force_max_n
                    assert 0 < rate <= LIMITS.force_rate_max_n_s
                    assert self.stage_goal_um is None, "both at once"
                    self.load_goal_n = force_n
                case MoveStage(x_um=x, y_um=y):
                    assert at is State.RAMPING
                    assert max(abs(x), abs(y)) <= LIMITS.stage_travel_um
                    assert self.load_goal_n is None, "both at once"
                    self.stage_goal_um = (x, y)
                case StopMotion():
                    self.load_goal_n = self.stage_goal_um = None
                case AcceptPair():
                    self.check_pair(command)
                case RefuseFrame(export=export, reason=reason):
                    assert reason
                    self.judged.append(export)
                case Finish():
                    self.finished += 1
        assert at is self.state.at
        for command in given:
            if isinstance(command, RampTo | MoveStage):
                device = Device.LOAD_FRAME if isinstance(command, RampTo) else Device.STAGE
                self.tell(CommandTaken(self.now_ns, device))

    def check_pair(self, accepted: AcceptPair) -> None:
        decision = accepted.decision
        assert decision.pair == len(self.pairs) == decision.step.step
        held_ns = [t for t, state in self.entered if state is State.HOLDING][-1]
        end_ns = decision.second.end_time_ns
        for info in (decision.first, decision.second):
            assert info.start_time_ns.value - 3 * info.start_sigma_s * S >= held_ns + HOLD.hold_s * S
        assert decision.second.start_time_ns.value >= decision.first.end_time_ns - 2 * 3 * 0.3 * S
        during = [(n, m) for t, n, m in self.samples if held_ns <= t <= end_ns]
        target_n = decision.step.load_n or 0.0
        assert during
        assert all(abs(n - target_n) <= HOLD.load_tolerance(target_n) and m is MotionState.STOPPED for n, m in during)
        assert decision.loads is not None
        self.judged += [decision.first.export, decision.second.export]
        self.pairs.append(accepted)

    def readings(self) -> None:
        motion = MotionState.STOPPED if self.load_goal_n is None else MotionState.MOVING
        self.samples.append((self.now_ns, self.force_n, motion))
        self.tell(LoadReading(self.now_ns, LoadSample(0, self.now_ns, 0, self.force_n, 0.0, motion, 0.0)))
        motion = MotionState.STOPPED if self.stage_goal_um is None else MotionState.MOVING
        self.tell(StageReading(self.now_ns, StageSample(0, self.now_ns, 0, *self.xy_um, motion)))

    def pass_time(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.5)):
            self.now_ns += S // 2
            if self.load_goal_n is not None:
                self.force_n += max(-25.0, min(25.0, self.load_goal_n - self.force_n))
                self.load_goal_n = None if self.force_n == self.load_goal_n else self.load_goal_n
            elif self.stage_goal_um is not None:
                self.xy_um, self.stage_goal_um = self.stage_goal_um, None
            self.readings()

    @initialize()
    def begin(self) -> None:
        self.tell(Opening(0))
        self.readings()
        self.tell(Ready(0, IDENTITY, IDENTITY))
        self.tell(Operator(0, Verb.START))

    @rule(seconds=st.sampled_from([0.5, 2.0, 8.0, 40.0]))
    def wait(self, seconds: float) -> None:
        self.pass_time(seconds)

    @rule(gap_s=st.sampled_from([0.0, 1.0, 5.0]), count=st.integers(1, 2))
    def scan(self, gap_s: float, count: int) -> None:
        for _ in range(count):
            self.pass_time(gap_s)
            began_ns = self.now_ns
            self.pass_time(FRAME_S + 1.0)
            self.export(began_ns)
            self.pass_time(0.5)

    def export(self, began_ns: int) -> None:
        known = Provenance.FILE
        timing = ScanTiming(Sourced(1e-4, known), Sourced(FRAME_S / 884, known), Sourced(FRAME_S, known), Sourced(1, known))
        number = len(self.exported)
        self.exported.append(number)
        pixel = Sourced(1e-6, known)
        info = FrameInfo(number, f"{number}.tif", "fei", 1024, 884, 0, timing, Sourced(began_ns, known), 0.3, pixel)
        self.tell(FrameScanned(self.now_ns, info))

    @rule(count=st.integers(1, 3))
    def go_on_to_a_pair(self, count: int) -> None:
        if self.state.at in {State.PAUSED, State.FAULT, State.RECOVER}:
            self.tell(Operator(self.now_ns, Verb.RESUME))
            self.tell(Operator(self.now_ns, Verb.RESUME))
        for _ in range(60):
            if self.state.at is State.IMAGING:
                break
            self.pass_time(1.0)
        self.scan(1.0, count)

    @rule(off_s=st.sampled_from([-60.0, -25.0, -10.0, 3600.0]))
    def lie_about_a_scan(self, off_s: float) -> None:
        self.export(self.now_ns + round(off_s * S))

    @rule()
    def unreadable(self) -> None:
        number = len(self.exported)
        self.exported.append(number)
        self.tell(FrameUnreadable(self.now_ns, number, "cut off"))

    @rule(by_n=st.sampled_from([-20.0, -6.0, -2.0, 2.0, 6.0, 300.0]))
    def disturb_load(self, by_n: float) -> None:
        self.force_n += by_n
        self.readings()

    @rule(by_um=st.sampled_from([-5.0, 1.0]))
    def disturb_stage(self, by_um: float) -> None:
        self.xy_um = (self.xy_um[0] + by_um, self.xy_um[1])
        self.readings()

    @precondition(lambda self: self.force_n > LIMITS.force_max_n)
    @rule()
    def unload_by_hand(self) -> None:
        self.force_n = 100.0
        self.readings()

    @rule(
        device=st.sampled_from([Device.LOAD_FRAME, Device.STAGE]),
        what=st.sampled_from(["stale", "lost", "stopped", "fault", "back", "taken"]),
    )
    def trouble(self, device: Device, what: str) -> None:
        t = self.now_ns
        events: dict[str, Event] = {
            "stale": LinkStale(t, device),
            "lost": LinkLost(t, device, "x"),
            "stopped": DeviceStopped(t, device, "x"),
            "fault": DeviceFault(t, device, "x"),
            "back": LinkBack(t, device),
            "taken": CommandTaken(t, device),
        }
        self.tell(events[what])

    @rule(verb=st.sampled_from([Verb.START, Verb.PAUSE, Verb.RESUME, Verb.RESUME, Verb.RESUME]))
    def operator(self, verb: Verb) -> None:
        self.tell(Operator(self.now_ns, verb))

    @precondition(lambda self: len(self.exported) > 6)
    @rule(verb=st.sampled_from([Verb.STOP, Verb.ABORT]))
    def end(self, verb: Verb) -> None:
        self.tell(Operator(self.now_ns, verb))

    @rule()
    def old_tick(self) -> None:
        self.tell(Tick(self.now_ns - S))

    @invariant()
    def every_frame_is_judged_once(self) -> None:
        if self.finished:
            return
        pending = [s.info.export for s in self.state.waiting] + ([] if self.state.first is None else [self.state.first.export])
        assert sorted(self.judged + pending) == self.exported

    @invariant()
    def nothing_moves_at_rest(self) -> None:
        if self.state.at not in {State.RAMPING, State.SETTLING}:
            assert self.load_goal_n is None
            assert self.stage_goal_um is None

    @invariant()
    def an_end_is_told_once(self) -> None:
        assert self.finished == (self.state.at in {State.COMPLETE, State.ABORTED})


TestProtocol = Protocol.TestCase
TestProtocol.settings = settings(
    max_examples=100, stateful_step_count=30, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
