"""State of a run, and the context of one engine step, which makes all state changes and collects all commands."""

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
"""Default fault code of each cause."""


@dataclass(frozen=True, slots=True)
class PendingFrame:
    """A frame to be selected or rejected, and its arrival time (experiment time, ns)."""

    info: FrameInfo
    arrival_time_ns: int


@dataclass(frozen=True, slots=True)
class MotionProgress:
    """Progress of the motion of a step.

    Attributes:
        began_ns: begin of the motion of the step, or of settling after a disturbance; start of the motion timeout.
        pending_devices: devices that have not arrived; the first is moving. The stage moves before the load frame, never both at once.
        acknowledged_ns: time at which the device acknowledged the command; None before. Samples up to this time are not used.
        out_of_tolerance_since_ns: begin of rest out of tolerance; None otherwise.
        approaches: number of repeated approaches to the target.
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
    """Complete state of the protocol.

    Attributes:
        plan: the plan of the run, with recentring and additional pairs.
        limits: soft limits, tightened by those of the device.
        state: state of the run.
        step_index: index of the step in `plan.steps`.
        time_ns: latest experiment time of an event.
        since_ns: time at which `state` was entered, or in IMAGING at which the last frame was accepted.
        load_frame: identity of the load frame; None without one.
        stage: identity of the stage; None without one.
        linked: all links are open and analysis is ready, so `load_frame` and `stage` are known.
        load: last sample of the load frame.
        position: last sample of the stage.
        stale: devices whose last sample is too old.
        origin_um: reading of the stage when the run began.
        reached_load_n: the commanded load that was reached; None if unknown.
        reached_shift_um: the commanded stage shift that was reached, relative to `origin_um`; None if unknown.
        motion: progress of the motion of the step.
        hold_load_n: the load to hold in a step that commands none.
        in_tolerance_since_ns: while settling, begin of the time within tolerance; None while out of tolerance.
        hold_end_ns: end of the hold; valid frames begin later.
        history: load samples.
        watch: earlier readings with which the next load sample is compared.
        rest: supervision of the load frame while no motion is ordered.
        pending_frames: frames to be selected or rejected.
        first: the first frame of the pair.
        reference: the first frame accepted in the run; later ones must have the same settings.
        start_sigma_s: standard uncertainty of the start time of the last frame, s; before the first, the default of scan profiles.
        field_of_view: field of view of the newest correlated pair; None before the first.
        drift_forecast: drift forecast of the newest estimate; None before the first.
        hold_drift: drift rate between the newest two frames of a hold; None before the first.
        calibration_assessment: assessment of the calibration by the newest estimate; None before the first.
        calibration_gate_passed: the calibration gate was passed.
        calibration_asked: the run was paused because the calibration is rejected.
        warm_up_gate_passed: the warm-up gate was passed.
        warming_since_ns: time at which the warm-up gate was first reached; None before.
        frame_requested: in triggered mode, a frame has been requested in this IMAGING state.
        interrupted_run: in a resumed run, the state at its interruption until the operator confirms; else None.
        stopped_on_resume: devices of a resumed run that the link thread stopped because their first reading showed motion or was invalid.
        message: the last message for the operator.
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
        """The present step."""
        return self.plan.steps[self.step_index]

    @property
    def calibration_question_open(self) -> bool:
        """Whether the run is paused for a decision of the operator because the calibration is rejected."""
        return self.state is State.PAUSED and self.calibration_asked and not self.calibration_gate_passed

    @property
    def devices(self) -> tuple[Device, ...]:
        """The devices of this run."""
        return tuple(d for d, identity in ((Device.LOAD_FRAME, self.load_frame), (Device.STAGE, self.stage)) if identity is not None)

    def sample(self, device: Device) -> LoadSample | StageSample | None:
        """The last sample of a device."""
        return self.load if device is Device.LOAD_FRAME else self.position

    def seconds_since(self, time_ns: int) -> float:
        """Experiment seconds from `time_ns` to now."""
        return (self.time_ns - time_ns) / 1e9


@dataclass(slots=True)
class StepContext:
    """Context of one call of `step`: the changing state and the commands so far."""

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
            InvalidTransition: if the table does not list it.
        """
        before = self.state
        after = next_state(before.state, cause)
        self.commands.append(Transition(before.time_ns, before.state, cause, after, before.step_index, guards, code))
        self.state = replace(before, state=after, since_ns=before.time_ns)

    def announce(self, text: str) -> None:
        """Show a message to the operator."""
        self.commands.append(Notify(text))
        self.update(message=text)

    def discard_frames(self, reason: str) -> None:
        """Reject the first frame of the pair and all pending frames."""
        discarded = (() if self.state.first is None else (self.state.first,)) + tuple(s.info for s in self.state.pending_frames)
        self.commands.extend(RejectFrame(info.export, f"{info.name} is not used: {reason}") for info in discarded)
        self.update(first=None, pending_frames=())

    def stop_and_transition(self, cause: Cause, reason: str, *guards: Guard, code: FaultCode | None = None) -> None:
        """Order all devices to stop, then change state; the reached load, and the reached shift of a moving stage, become unknown."""
        self.commands.append(StopMotion(reason))
        self.discard_frames(reason)
        stage_moving = Device.STAGE in self.state.motion.pending_devices[:1]
        self.update(
            motion=MotionProgress(),
            reached_load_n=None,
            in_tolerance_since_ns=None,
            reached_shift_um=None if stage_moving else self.state.reached_shift_um,
        )
        self.transition(cause, *guards, code=code)
        self.announce(reason)

    def fault(self, cause: Cause, reason: str, *guards: Guard, code: FaultCode | None = None) -> None:
        """Stop and go to FAULT if the table lists `cause` here; else only announce the reason. Without `code` the cause determines it."""
        if self.is_allowed(cause):
            self.stop_and_transition(cause, reason, *guards, code=code or FAULT_OF_CAUSE[cause])
        elif self.state.state not in FINAL_STATES and reason != self.state.message:
            self.announce(reason)

    def finish(self, cause: Cause, text: str) -> None:
        """End the run."""
        self.transition(cause)
        self.announce(text)
        self.commands.append(FinishRun(self.state.state, text))
