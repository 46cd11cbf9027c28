"""The state of a run, and one turn of it: the only way in which a state changes or a command is given."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

from semlive.data.experiment import Limits, Plan, Step
from semlive.data.faults import FaultCode
from semlive.data.frame import FrameInfo
from semlive.data.loading import DeviceIdentity, LoadSample, StageSample
from semlive.engine.commands import Command, FinishRun, Guard, Notify, RejectFrame, StopMotion, Transition
from semlive.engine.events import CalibrationAssessed, Device, DriftForecastUpdated, FieldOfViewMeasured, HoldDriftMeasured
from semlive.engine.load_history import LoadHistory
from semlive.engine.resume import InterruptedRun
from semlive.engine.states import FINAL_STATES, TRANSITIONS, Cause, State, next_state
from semlive.engine.supervision.load_watch import INITIAL, LoadSupervisor
from semlive.engine.supervision.standstill import NO_REST, Rest

FAULT_OF_CAUSE: Mapping[str, FaultCode] = MappingProxyType(
    {
        Cause.LIMIT: FaultCode.LIMIT,
        Cause.LINK_LOST: FaultCode.LINK_LOST,
        Cause.DEVICE_FAULT: FaultCode.DEVICE_FAULT,
        Cause.DEVICE_STOPPED: FaultCode.DEVICE_FAULT,
        Cause.NOT_REACHED: FaultCode.NOT_REACHED,
        Cause.MOTION_TIMEOUT: FaultCode.MOTION_TIMEOUT,
        Cause.FRAME_TIMEOUT: FaultCode.FRAME_TIMEOUT,
        Cause.EMERGENCY: FaultCode.EMERGENCY_STOP,
    }
)
"""The kind of fault that a cause means where nothing more special is known."""


@dataclass(frozen=True, slots=True)
class PendingFrame:
    """A frame that waits to be judged, and when it was known."""

    info: FrameInfo
    arrival_time_ns: int


@dataclass(frozen=True, slots=True)
class MotionProgress:
    """How far a step's motion is.

    Attributes:
        began_ns: when the step's motion (or settling, after a disturbance) began; timeouts count from here.
        pending_devices: devices that are still to move, the first is under way. The stage comes first, never both at once.
        acknowledged_ns: when the device took the command; a sample that is not later counts as old.
        out_of_tolerance_since_ns: since when everything rests out of tolerance, or None.
        approaches: how often the target was approached again.
        from_n: the load when the load frame was last ordered to move, or None.
    """

    began_ns: int = 0
    pending_devices: tuple[Device, ...] = ()
    acknowledged_ns: int | None = None
    out_of_tolerance_since_ns: int | None = None
    approaches: int = 0
    from_n: float | None = None


@dataclass(frozen=True, slots=True)
class EngineState:
    """Everything that the protocol knows.

    Attributes:
        plan: what is to be done.
        limits: soft limits, tightened by the device's own.
        state: state of the run.
        step_index: index of the step in `plan.steps`.
        time_ns: latest experiment time seen.
        since_ns: when `state` was entered, or in IMAGING when the last frame was taken up.
        load_frame: who answers, or None without a load frame.
        stage: likewise.
        linked: all links are open and analysis is ready, so `load_frame` and `stage` are known.
        load: last sample.
        position: last sample of the stage.
        stale: devices whose last sample is too old.
        origin_um: the stage's reading when the run began.
        reached_load_n: the load that the load frame was told to hold and reached, None if unknown.
        reached_shift_um: the same of the stage, relative to `origin_um`.
        motion: how far the step's motion is.
        hold_load_n: the load that must be kept in a step that commands none.
        in_tolerance_since_ns: since when everything is within tolerance while settling.
        hold_end_ns: when the hold is over or was over; frames count from here.
        history: load samples.
        watch: what the next load sample is compared with.
        rest: how the load frame rests while no motion is ordered.
        pending_frames: frames to be judged.
        first: the first frame of the pair.
        reference: the first frame accepted in the run; later ones must be of its kind.
        start_sigma_s: how well the start of the last frame was known; before the first, what scan profiles assume.
        field_of_view: where the field of the newest correlated pair was; None before.
        drift_forecast: how fast the newest estimate expects the drift to be; None before.
        hold_drift: how fast the drift was between the newest two frames of a rest; None before.
        calibration_assessment: what the newest estimate says of the calibration; None before.
        calibration_gate_passed: the calibration's gate was passed.
        calibration_asked: the operator was told that it is refused.
        warm_up_gate_passed: the warm-up gate was passed.
        warming_since_ns: when the run first came to it.
        frame_requested: in triggered mode, a frame has been asked for in this IMAGING.
        interrupted_run: what the log told of a run that is taken up again, until the operator let it go on; else None.
        stopped_on_resume: devices of a run that is taken up again which the first reading told to be in motion, or in doubt.
        message: the last sentence for the operator.
    """

    plan: Plan
    limits: Limits
    state: State
    step_index: int
    time_ns: int
    since_ns: int
    history: LoadHistory
    watch: LoadSupervisor = INITIAL
    rest: Rest = NO_REST
    load_frame: DeviceIdentity | None = None
    stage: DeviceIdentity | None = None
    linked: bool = False
    load: LoadSample | None = None
    position: StageSample | None = None
    stale: frozenset[Device] = frozenset()
    origin_um: tuple[float, float] | None = None
    reached_load_n: float | None = None
    reached_shift_um: tuple[float, float] | None = (0.0, 0.0)
    motion: MotionProgress = MotionProgress()
    hold_load_n: float | None = None
    in_tolerance_since_ns: int | None = None
    hold_end_ns: int = 0
    pending_frames: tuple[PendingFrame, ...] = ()
    first: FrameInfo | None = None
    reference: FrameInfo | None = None
    start_sigma_s: float = 0.3
    field_of_view: FieldOfViewMeasured | None = None
    drift_forecast: DriftForecastUpdated | None = None
    hold_drift: HoldDriftMeasured | None = None
    calibration_assessment: CalibrationAssessed | None = None
    calibration_gate_passed: bool = False
    calibration_asked: bool = False
    warm_up_gate_passed: bool = False
    warming_since_ns: int | None = None
    frame_requested: bool = False
    interrupted_run: InterruptedRun | None = None
    stopped_on_resume: frozenset[Device] = frozenset()
    message: str = ""

    @property
    def step(self) -> Step:
        """The step that is under way."""
        return self.plan.steps[self.step_index]

    @property
    def calibration_question_open(self) -> bool:
        """Whether it waits for the operator's word because the calibration is refused."""
        return self.state is State.PAUSED and self.calibration_asked and not self.calibration_gate_passed

    @property
    def devices(self) -> tuple[Device, ...]:
        """The devices of this run."""
        return tuple(d for d, who in ((Device.LOAD_FRAME, self.load_frame), (Device.STAGE, self.stage)) if who is not None)

    def sample(self, device: Device) -> LoadSample | StageSample | None:
        """The last sample of a device."""
        return self.load if device is Device.LOAD_FRAME else self.position

    def seconds_since(self, time_ns: int) -> float:
        """Experiment seconds from `time_ns` to now."""
        return (self.time_ns - time_ns) / 1e9


@dataclass(slots=True)
class StepContext:
    """One call of `step` at work: collects commands beside the changing state, and never outlives the call."""

    state: EngineState
    commands: list[Command] = field(default_factory=list)

    def update(self, **changes: Any) -> None:
        """Replace fields of the state; the state of the run itself changes only by `transition`."""
        if "state" in changes:
            raise TypeError("the state of a run changes by transition()")
        self.state = replace(self.state, **changes)

    def is_allowed(self, cause: Cause) -> bool:
        """Whether the table lists `cause` here."""
        return (self.state.state, cause) in TRANSITIONS

    def transition(self, cause: Cause, *guards: Guard, code: FaultCode | None = None) -> None:
        """Change state by the table; `code` names the fault, if it is one.

        Raises:
            ImpossibleTransition: if the table does not list it.
        """
        now = self.state
        after = next_state(now.state, cause)
        self.commands.append(Transition(now.time_ns, now.state, cause, after, now.step_index, guards, code))
        self.state = replace(now, state=after, since_ns=now.time_ns)

    def announce(self, text: str) -> None:
        """Tell the operator."""
        self.commands.append(Notify(text))
        self.update(message=text)

    def discard_frames(self, why: str) -> None:
        """Refuse the frames at hand: the pair that they would have made is off."""
        held = (() if self.state.first is None else (self.state.first,)) + tuple(s.info for s in self.state.pending_frames)
        self.commands.extend(RejectFrame(info.export, f"{info.name} is not used: {why}") for info in held)
        self.update(first=None, pending_frames=())

    def stop_and_go(self, cause: Cause, reason: str, *guards: Guard, code: FaultCode | None = None) -> None:
        """Stop everything first, then change state; where a device is then is no longer known."""
        self.commands.append(StopMotion(reason))
        self.discard_frames(reason)
        under_way = Device.STAGE in self.state.motion.pending_devices[:1]
        self.update(
            motion=MotionProgress(),
            reached_load_n=None,
            in_tolerance_since_ns=None,
            reached_shift_um=None if under_way else self.state.reached_shift_um,
        )
        self.transition(cause, *guards, code=code)
        self.announce(reason)

    def fault(self, cause: Cause, reason: str, *guards: Guard, code: FaultCode | None = None) -> None:
        """Stop and go to FAULT, if the table says so here; else only tell. Without a `code` the cause names the fault."""
        if self.is_allowed(cause):
            self.stop_and_go(cause, reason, *guards, code=code or FAULT_OF_CAUSE[cause])
        elif self.state.state not in FINAL_STATES and reason != self.state.message:
            self.announce(reason)

    def finish(self, cause: Cause, text: str) -> None:
        """End the run."""
        self.transition(cause)
        self.announce(text)
        self.commands.append(FinishRun(self.state.state, text))
