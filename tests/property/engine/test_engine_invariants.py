"""Random event sequences: whatever happens, the engine keeps its promises."""

from __future__ import annotations

from dataclasses import replace

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from semlive.data.experiment import AdaptiveHold, WarmUp
from semlive.engine import (
    CommandAcknowledged,
    Device,
    DeviceFault,
    DeviceStopped,
    DriftForecastUpdated,
    Event,
    FieldOfViewMeasured,
    FrameUnreadable,
    HoldDriftMeasured,
    LinkLost,
    LinkRestored,
    LinksOpening,
    LinksReady,
    LinkStale,
    OperatorAction,
    OperatorCommand,
    State,
    Tick,
)

from .record import IDENTITY, LIMITS, PLAN, Record, S


class Protocol(RuleBasedStateMachine):
    def __init__(self) -> None:
        super().__init__()
        self.run = Record()

    def _send(self, event: Event) -> None:
        self.run.send(event)

    @initialize()
    def begin(self) -> None:
        self._send(LinksOpening(0))
        self.run.readings()
        self._send(LinksReady(0, IDENTITY, IDENTITY))
        self._send(OperatorAction(0, OperatorCommand.START))

    @rule(seconds=st.sampled_from([-1.0, 0.5, 2.0, 8.0, 40.0]))
    def wait(self, seconds: float) -> None:
        if seconds < 0:
            self._send(Tick(self.run.now_ns - S))
        else:
            self.run.pass_time(seconds)

    @rule(gap_s=st.sampled_from([0.0, 1.0, 5.0]), count=st.integers(1, 2))
    def scan(self, gap_s: float, count: int) -> None:
        self.run.scan(gap_s, count)

    @rule(count=st.integers(1, 3))
    def go_on_to_a_pair(self, count: int) -> None:
        if self.run.state.state in {State.PAUSED, State.FAULT, State.RESUMING}:
            self._send(OperatorAction(self.run.now_ns, OperatorCommand.RESUME))
            self._send(OperatorAction(self.run.now_ns, OperatorCommand.RESUME))
        for _ in range(60):
            if self.run.state.state is State.IMAGING:
                break
            self.run.pass_time(1.0)
        self.run.scan(1.0, count)

    @rule(off_s=st.sampled_from([-60.0, -25.0, -10.0, 3600.0]))
    def lie_about_a_scan(self, off_s: float) -> None:
        self.run.export(self.run.now_ns + round(off_s * S))

    @rule(pair=st.integers(0, 5), x_px=st.sampled_from([0.0, 1.0, -7.5, 25.0, -1e9]), y_px=st.sampled_from([0.0, -3.0, 40.0]))
    def see_the_field(self, pair: int, x_px: float, y_px: float) -> None:
        self._send(FieldOfViewMeasured(self.run.now_ns, pair, (x_px, y_px)))

    @rule()
    def unreadable(self) -> None:
        number = len(self.run.exported)
        self.run.exported.append(number)
        self._send(FrameUnreadable(self.run.now_ns, number, "cut off"))

    @rule(by_n=st.sampled_from([0.0, -20.0, -6.0, -2.0, 2.0, 6.0, 300.0]), by_um=st.sampled_from([0.0, 0.0, 0.0, -5.0, 1.0]))
    def disturb(self, by_n: float, by_um: float) -> None:
        self.run.force_n += by_n
        self.run.xy_um = (self.run.xy_um[0] + by_um, self.run.xy_um[1])
        self.run.readings()

    @precondition(lambda self: self.run.force_n > LIMITS.force_max_n)
    @rule()
    def unload_by_hand(self) -> None:
        self.run.force_n = 100.0
        self.run.readings()

    @rule(
        device=st.sampled_from([Device.LOAD_FRAME, Device.STAGE]),
        what=st.sampled_from(["stale", "lost", "stopped", "fault", "back", "taken"]),
    )
    def trouble(self, device: Device, what: str) -> None:
        t = self.run.now_ns
        events: dict[str, Event] = {
            "stale": LinkStale(t, device),
            "lost": LinkLost(t, device, "x"),
            "stopped": DeviceStopped(t, device, "x"),
            "fault": DeviceFault(t, device, "x"),
            "back": LinkRestored(t, device),
            "taken": CommandAcknowledged(t, device),
        }
        self._send(events[what])

    @rule(
        verb=st.sampled_from(
            [
                OperatorCommand.START,
                OperatorCommand.PAUSE,
                OperatorCommand.RESUME,
                OperatorCommand.RESUME,
                OperatorCommand.RESUME,
                OperatorCommand.STOP,
                OperatorCommand.ABORT,
            ]
        )
    )
    def operator(self, verb: OperatorCommand) -> None:
        if verb not in (OperatorCommand.STOP, OperatorCommand.ABORT) or len(self.run.exported) > 10:
            self._send(OperatorAction(self.run.now_ns, verb))

    @invariant()
    def promises(self) -> None:
        """Every frame is judged once, nothing moves while stationary, an end is reported once."""
        run = self.run
        if not run.finished:
            first = [] if run.state.imaging.first is None else [run.state.imaging.first.export]
            pending = [s.info.export for s in run.state.imaging.pending] + first
            assert sorted(run.judged + pending) == run.exported
        if run.state.state not in {State.RAMPING, State.SETTLING}:
            assert run.load_goal_n is None
            assert run.stage_goal_um is None
        assert run.finished == (run.state.state in {State.COMPLETE, State.ABORTED})


class WaitingProtocol(Protocol):
    """The same, with a warm-up gate and holds that may be made longer."""

    def __init__(self) -> None:
        super().__init__()
        self.run = Record(replace(PLAN, warm_up=WarmUp(0.01, 300.0), adaptive_hold=AdaptiveHold(50.0, 0.02, 0.5)))

    @rule(behind=st.sampled_from([0, 0, 0, 1, 5]), rate=st.sampled_from([0.0, 0.005, 0.015, 1.0]), sigma=st.sampled_from([0.0, 0.004, 0.1]))
    def foresee_the_drift(self, behind: int, rate: float, sigma: float) -> None:
        run = self.run
        scans = tuple((run.now_ns + n * 20 * S, rate * 0.8**n, sigma * (1 + n)) for n in (0, 1, 2, 4, 8))
        self._send(DriftForecastUpdated(run.now_ns, len(run.pairs) - 1 - behind, scans))

    @rule(ago_s=st.sampled_from([1, 10, 40, 200]), rate=st.sampled_from([0.0, 0.015, 1.0]))
    def see_the_drift(self, ago_s: int, rate: float) -> None:
        self._send(HoldDriftMeasured(self.run.now_ns, self.run.now_ns - ago_s * S, rate))


TestProtocol = Protocol.TestCase
TestWaitingProtocol = WaitingProtocol.TestCase
TestProtocol.settings = settings(
    max_examples=100, stateful_step_count=30, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
TestWaitingProtocol.settings = settings(TestProtocol.settings, max_examples=40)
