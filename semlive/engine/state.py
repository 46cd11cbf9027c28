"""State of a run: position in the plan, and one frozen part for each subject of the protocol."""

from __future__ import annotations

from dataclasses import dataclass, replace

from semlive.data.experiment import Limits, Phase, Plan, Step
from semlive.data.frame import FrameInfo
from semlive.data.loading import DeviceIdentity, LoadSample, StageSample
from semlive.engine.events import CalibrationAssessed, Device, DriftForecastUpdated, FieldOfViewMeasured, HoldDriftMeasured
from semlive.engine.load_history import LoadHistory
from semlive.engine.resume import InterruptedRun
from semlive.engine.states import State
from semlive.engine.supervision.load_watch import INITIAL, LoadSupervisor
from semlive.engine.supervision.standstill import NO_REST, Rest


@dataclass(frozen=True, slots=True)
class Devices:
    """Devices of the run with their last readings, and what the supervision derives from the load samples.

    Attributes:
        history: load samples.
        load_frame: identity of the load frame; None without one.
        stage: identity of the stage; None without one.
        linked: all links are open and analysis is ready, so `load_frame` and `stage` are known.
        load: last sample of the load frame.
        position: last sample of the stage.
        stale: devices whose last sample is too old.
        origin_um: reading of the stage when the run began.
        supervisor: earlier readings with which the next load sample is compared.
        standstill: supervision of the load frame while no motion is ordered.
        stopped_on_resume: devices of a resumed run that the link thread stopped because their first reading showed motion or was invalid.
    """

    history: LoadHistory
    load_frame: DeviceIdentity | None = None
    stage: DeviceIdentity | None = None
    linked: bool = False
    load: LoadSample | None = None
    position: StageSample | None = None
    stale: frozenset[Device] = frozenset()
    origin_um: tuple[float, float] | None = None
    supervisor: LoadSupervisor = INITIAL
    standstill: Rest = NO_REST
    stopped_on_resume: frozenset[Device] = frozenset()

    @property
    def present(self) -> tuple[Device, ...]:
        """The devices of this run."""
        return tuple(d for d, identity in ((Device.LOAD_FRAME, self.load_frame), (Device.STAGE, self.stage)) if identity is not None)

    def sample(self, device: Device) -> LoadSample | StageSample | None:
        """The last sample of a device."""
        return self.load if device is Device.LOAD_FRAME else self.position

    def with_load(self, sample: LoadSample, limits: Limits, ordered: bool) -> tuple[Devices, str | None]:
        """Add a sample of the load frame.

        Args:
            sample: the sample.
            limits: soft limits.
            ordered: a motion is ordered.

        Returns:
            The updated devices, and the limit that the sample violates relative to earlier samples, as a clause, or None.
        """
        supervisor, sudden_change = self.supervisor.with_sample(limits, sample)
        updated = replace(
            self,
            load=sample,
            supervisor=supervisor,
            standstill=self.standstill.with_sample(sample, ordered=ordered),
            stale=self.stale - {Device.LOAD_FRAME},
            history=self.history.with_sample(sample.time_ns, sample.force_n, sample.gage_strain),
        )
        return updated, sudden_change

    def with_position(self, sample: StageSample) -> Devices:
        """Add a sample of the stage; the first determines the origin."""
        origin_um = self.origin_um or (sample.x_um, sample.y_um)
        return replace(self, position=sample, stale=self.stale - {Device.STAGE}, origin_um=origin_um)

    def with_stale(self, device: Device) -> Devices:
        """Mark the last sample of a device as too old."""
        return replace(self, stale=self.stale | {device})


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
class HoldProgress:
    """Load and stage shift that were reached, and the hold of the step.

    Attributes:
        reached_load_n: the commanded load that was reached; None if unknown.
        reached_shift_um: the commanded stage shift that was reached, relative to the origin; None if unknown.
        load_n: the load to hold in a step that commands none.
        in_tolerance_since_ns: while settling, begin of the time within tolerance; None while out of tolerance.
        end_ns: end of the hold; valid frames begin later.
    """

    reached_load_n: float | None = None
    reached_shift_um: tuple[float, float] | None = (0.0, 0.0)
    load_n: float | None = None
    in_tolerance_since_ns: int | None = None
    end_ns: int = 0


@dataclass(frozen=True, slots=True)
class PendingFrame:
    """A frame to be selected or rejected, and its arrival time (experiment time, ns)."""

    info: FrameInfo
    arrival_time_ns: int


@dataclass(frozen=True, slots=True)
class Imaging:
    """Frames of the step.

    Attributes:
        pending: frames to be selected or rejected.
        first: the first frame of the pair.
        reference: the first frame accepted in the run; later ones must have the same settings.
        start_sigma_s: standard uncertainty of the start time of the last frame, s; before the first, the default of scan profiles.
        frame_requested: in triggered mode, a frame has been requested in this IMAGING state.
    """

    pending: tuple[PendingFrame, ...] = ()
    first: FrameInfo | None = None
    reference: FrameInfo | None = None
    start_sigma_s: float = 0.3
    frame_requested: bool = False


@dataclass(frozen=True, slots=True)
class AnalysisResults:
    """Newest results of the analysis.

    Attributes:
        field_of_view: field of view of the newest correlated pair; None before the first.
        drift_forecast: drift forecast of the newest estimate; None before the first.
        hold_drift: drift rate between the newest two frames of a hold; None before the first.
        calibration: assessment of the calibration by the newest estimate; None before the first.
    """

    field_of_view: FieldOfViewMeasured | None = None
    drift_forecast: DriftForecastUpdated | None = None
    hold_drift: HoldDriftMeasured | None = None
    calibration: CalibrationAssessed | None = None

    def with_result(self, event: FieldOfViewMeasured | DriftForecastUpdated | HoldDriftMeasured | CalibrationAssessed) -> AnalysisResults:
        """Replace the result that the event carries."""
        match event:
            case FieldOfViewMeasured():
                return replace(self, field_of_view=event)
            case DriftForecastUpdated():
                return replace(self, drift_forecast=event)
            case HoldDriftMeasured():
                return replace(self, hold_drift=event)
            case CalibrationAssessed():
                return replace(self, calibration=event)


@dataclass(frozen=True, slots=True)
class Gates:
    """Gates before the first load.

    Attributes:
        calibration_passed: the calibration gate was passed.
        calibration_rejected: the run was paused because the calibration is rejected.
        warm_up_passed: the warm-up gate was passed.
        warming_since_ns: time at which the warm-up gate was first reached; None before.
        previous_rate_px_s: forecast drift rate and its standard uncertainty when the warm-up gate last added a pair; None before.
    """

    calibration_passed: bool = False
    calibration_rejected: bool = False
    warm_up_passed: bool = False
    warming_since_ns: int | None = None
    previous_rate_px_s: tuple[float, float] | None = None


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
        devices: devices and their readings.
        motion: progress of the motion of the step.
        hold: reached load and shift, and the hold of the step.
        imaging: frames of the step.
        analysis: newest results of the analysis.
        gates: gates before the first load.
        interrupted_run: in a resumed run, the state at its interruption until the operator confirms; else None.
        message: the last message for the operator.
    """

    plan: Plan
    limits: Limits
    state: State
    step_index: int
    time_ns: int
    since_ns: int
    devices: Devices
    motion: MotionProgress = MotionProgress()
    hold: HoldProgress = HoldProgress()
    imaging: Imaging = Imaging()
    analysis: AnalysisResults = AnalysisResults()
    gates: Gates = Gates()
    interrupted_run: InterruptedRun | None = None
    message: str = ""

    @property
    def step(self) -> Step:
        """The present step."""
        return self.plan.steps[self.step_index]

    @property
    def calibration_question_open(self) -> bool:
        """Whether the run is paused for a decision of the operator because the calibration is rejected."""
        return self.state is State.PAUSED and self.gates.calibration_rejected and not self.gates.calibration_passed

    def seconds_since(self, time_ns: int) -> float:
        """Experiment seconds from `time_ns` to now."""
        return (self.time_ns - time_ns) / 1e9


@dataclass(frozen=True, slots=True)
class RunStatus:
    """Status of a run.

    Attributes:
        state: state of the protocol.
        step: index of the step.
        steps: number of steps.
        phase: purpose of the pair of the step.
        hold_remaining_s: experiment seconds until the hold is over; None unless holding.
        load_n: last reading, None before the first.
        target_n: load of the step; None if it commands none.
        shift_um: stage shift of the step.
        pair_frames_accepted: number of accepted frames of the pair of the step, 0 or 1.
        message: the last message for the operator.
    """

    state: State
    step: int
    steps: int
    phase: Phase
    hold_remaining_s: float | None
    load_n: float | None
    target_n: float | None
    shift_um: tuple[float, float]
    pair_frames_accepted: int
    message: str


def progress(state: EngineState) -> RunStatus:
    """Return the status that is displayed for a state."""
    holding = state.state is State.HOLDING
    return RunStatus(
        state=state.state,
        step=state.step_index,
        steps=len(state.plan.steps),
        phase=state.step.phase,
        hold_remaining_s=max(0.0, -state.seconds_since(state.hold.end_ns)) if holding else None,
        load_n=None if state.devices.load is None else state.devices.load.force_n,
        target_n=state.step.load_n,
        shift_um=state.step.shift_um,
        pair_frames_accepted=0 if state.imaging.first is None else 1,
        message=state.message,
    )
