"""A run and its own record of everything: accepted pairs are judged from that record alone."""

from __future__ import annotations

from semlive.data.experiment import HoldRule, Limits, Phase, Plan, Recentre, Step
from semlive.data.frame import FrameInfo
from semlive.data.loading import DeviceIdentity, LoadSample, MotionState, StageSample, StopOnLinkLoss
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.engine import (
    AcceptPair,
    Cause,
    CommandAcknowledged,
    Device,
    EngineState,
    Event,
    FinishRun,
    FrameScanned,
    LoadReading,
    MoveStage,
    RampTo,
    RejectFrame,
    StageReading,
    State,
    StopMotion,
    Transition,
    start,
    step,
)

S = 1_000_000_000
LIMITS = Limits(-50.0, 450.0, -1.0, 1.0, 60.0, 250.0, 30.0)
HOLD = HoldRule(hold_s=30.0, settle_s=3.0, load_tolerance_n=5.0, stage_tolerance_um=2.0, motion_timeout_s=200.0, frame_timeout_s=200.0)
STOPS = (((0.0, 0.0), 0.0), ((10.0, 0.0), 0.0), ((0.0, 0.0), 200.0), ((0.0, 0.0), 400.0))
STEPS = tuple(Step(i, Phase.TENSION, s, s, n) for i, (s, n) in enumerate(STOPS))
PLAN = Plan(STEPS, HOLD, LIMITS, ramp_rate_n_s=50.0, recentring=Recentre(2.0, 1.0))
IDENTITY = DeviceIdentity("bench", True, StopOnLinkLoss.VERIFIED)
FRAME_S = 20.0


class Record:
    """Devices of a few lines, the engine, and what they did."""

    def __init__(self, plan: Plan = PLAN) -> None:
        self.state: EngineState = start(plan, 0)
        self.warm = plan.warm_up is None
        self.now_ns = 0
        self.force_n, self.load_goal_n = 0.0, None
        self.xy_um, self.stage_goal_um = (0.0, 0.0), None
        self.samples: list[tuple[int, float, MotionState]] = []
        self.entered: list[tuple[int, State]] = []
        self.pairs: list[AcceptPair] = []
        self.judged: list[int] = []
        self.exported: list[int] = []
        self.finished = 0

    def send(self, event: Event) -> None:
        before = self.state
        self.state, given = step(self.state, event)
        assert before is self.state or before.state not in {State.COMPLETE, State.ABORTED}
        at = before.state
        for command in given:
            match command:
                case Transition():
                    assert command.before is at
                    at = command.after
                    self.check_waiting(command)
                    self.entered.append((command.time_ns, at))
                case RampTo(force_n=force_n, rate_n_s=rate):
                    assert at is State.RAMPING
                    assert LIMITS.force_min_n <= force_n <= LIMITS.force_max_n
                    assert 0 < rate <= LIMITS.force_rate_max_n_s
                    assert self.stage_goal_um is None, "both at once"
                    assert self.warm, "a load before the warm-up gate was passed"
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
                case RejectFrame(export=export, reason=reason):
                    assert reason
                    self.judged.append(export)
                case FinishRun():
                    self.finished += 1
        assert at is self.state.state
        for command in given:
            if isinstance(command, RampTo | MoveStage):
                device = Device.LOAD_FRAME if isinstance(command, RampTo) else Device.STAGE
                self.send(CommandAcknowledged(self.now_ns, device))

    def check_waiting(self, transition: Transition) -> None:
        """A hold is never shorter than it must be nor longer than it may; the gate opens by the forecast or by the operator's command."""
        rule, gate = self.state.plan.adaptive_hold, self.state.plan.warm_up
        if transition.cause is Cause.HOLD_COMPLETE:
            held_s = (transition.time_ns - [t for t, state in self.entered if state is State.HOLDING][-1]) / S
            assert HOLD.hold_s <= held_s
            # Readings come twice a second, and a stale one is not decided on.
            assert rule is None or held_s <= rule.max_hold_s + 1.0
        if transition.cause is Cause.WARMED_UP and gate is not None:
            guards = dict(transition.details)
            assert gate.max_rate_px_s is not None
            assert float(guards["rate_px_s"]) + float(guards["sigma_px_s"]) <= gate.max_rate_px_s
            self.warm = True
        if transition.before is State.PAUSED and transition.cause is Cause.RESUME:
            self.warm = self.warm or not self.state.step.warm_up

    def check_pair(self, accepted: AcceptPair) -> None:
        decision = accepted.decision
        assert decision.pair == len(self.pairs) == decision.step.step
        held_ns = [t for t, state in self.entered if state is State.HOLDING][-1]
        end_ns = decision.second.end_time_ns
        for info in (decision.first, decision.second):
            assert info.start_time_ns.value - 3 * info.start_sigma_s * S >= held_ns + HOLD.hold_s * S
        assert decision.second.start_time_ns.value >= decision.first.end_time_ns - 2 * 3 * 0.3 * S
        during = [(n, m) for t, n, m in self.samples if held_ns <= t <= end_ns]
        assert during
        target_n = during[0][0] if decision.step.warm_up else decision.step.load_n or 0.0
        assert all(abs(n - target_n) <= HOLD.load_tolerance(target_n) and m is MotionState.STOPPED for n, m in during)
        assert decision.loads is not None
        self.judged += [decision.first.export, decision.second.export]
        self.pairs.append(accepted)

    def readings(self) -> None:
        motion = MotionState.STOPPED if self.load_goal_n is None else MotionState.MOVING
        self.samples.append((self.now_ns, self.force_n, motion))
        self.send(LoadReading(self.now_ns, LoadSample(0, self.now_ns, 0, self.force_n, 0.0, motion, 0.0)))
        motion = MotionState.STOPPED if self.stage_goal_um is None else MotionState.MOVING
        self.send(StageReading(self.now_ns, StageSample(0, self.now_ns, 0, *self.xy_um, motion)))

    def pass_time(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.5)):
            self.now_ns += S // 2
            if self.load_goal_n is not None:
                self.force_n += max(-25.0, min(25.0, self.load_goal_n - self.force_n))
                self.load_goal_n = None if self.force_n == self.load_goal_n else self.load_goal_n
            elif self.stage_goal_um is not None:
                self.xy_um, self.stage_goal_um = self.stage_goal_um, None
            self.readings()

    def scan(self, gap_s: float, count: int) -> None:
        for _ in range(count):
            self.pass_time(gap_s)
            began_ns = self.now_ns
            self.pass_time(FRAME_S + 1.0)
            self.export(began_ns)
            self.pass_time(0.5)

    def export(self, began_ns: int) -> None:
        source = Provenance.FILE
        timing = ScanTiming(Sourced(1e-4, source), Sourced(FRAME_S / 884, source), Sourced(FRAME_S, source), Sourced(1, source))
        number = len(self.exported)
        self.exported.append(number)
        pixel = Sourced(1e-6, source)
        info = FrameInfo(number, f"{number}.tif", "fei", 1024, 884, 0, timing, Sourced(began_ns, source), 0.3, pixel)
        self.send(FrameScanned(self.now_ns, info))
