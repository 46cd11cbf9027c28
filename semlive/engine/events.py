"""Events of a run. Each event carries experiment time, which is the only time that the engine uses."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from semlive.data.faults import FaultCode
from semlive.data.frame import FrameInfo
from semlive.data.loading import DeviceIdentity, LoadSample, StageSample


class Device(StrEnum):
    """Device that an event refers to."""

    LOAD_FRAME = "load_frame"
    STAGE = "stage"
    SEM = "sem"

    @property
    def words(self) -> str:
        """Name of the device in messages."""
        return {"load_frame": "load frame", "stage": "stage", "sem": "SEM"}[self.value]


class OperatorCommand(StrEnum):
    """Commands of the operator."""

    START = "start"
    PAUSE = "pause"
    RESUME = "resume"
    STOP = "stop"
    ABORT = "abort"


@dataclass(frozen=True, slots=True)
class LinksOpening:
    """The links are being opened."""

    time_ns: int


@dataclass(frozen=True, slots=True)
class LinksReady:
    """All links are open and the analysis is warm.

    Attributes:
        time_ns: experiment time.
        load_frame: identity of the load frame; None if the run has none.
        stage: identity of the stage; None if the run has none.
    """

    time_ns: int
    load_frame: DeviceIdentity | None
    stage: DeviceIdentity | None


@dataclass(frozen=True, slots=True)
class Tick:
    """Periodic event without content, which advances the time."""

    time_ns: int


@dataclass(frozen=True, slots=True)
class LoadReading:
    """A sample of the load frame arrived."""

    time_ns: int
    sample: LoadSample


@dataclass(frozen=True, slots=True)
class StageReading:
    """A sample of the stage arrived."""

    time_ns: int
    sample: StageSample


@dataclass(frozen=True, slots=True)
class CommandAcknowledged:
    """A device has acknowledged the last motion command: it was written and read back."""

    time_ns: int
    device: Device


@dataclass(frozen=True, slots=True)
class DeviceStopped:
    """The link thread stopped a device without a command of the engine."""

    time_ns: int
    device: Device
    reason: str
    code: FaultCode = FaultCode.DEVICE_FAULT


@dataclass(frozen=True, slots=True)
class LinkStale:
    """The last sample of a device is too old for decisions."""

    time_ns: int
    device: Device


@dataclass(frozen=True, slots=True)
class LinkLost:
    """The device has not answered for too long."""

    time_ns: int
    device: Device
    reason: str


@dataclass(frozen=True, slots=True)
class LinkRestored:
    """The same device answers again."""

    time_ns: int
    device: Device


@dataclass(frozen=True, slots=True)
class DeviceFault:
    """A device rejected a command or reports a fault.

    Attributes:
        time_ns: experiment time.
        device: the device with the fault.
        reason: one sentence.
        emergency: the emergency stop was pressed.
        code: kind of the fault.
    """

    time_ns: int
    device: Device
    reason: str
    emergency: bool = False
    code: FaultCode = FaultCode.DEVICE_FAULT


@dataclass(frozen=True, slots=True)
class FrameScanned:
    """A frame was exported completely and its header read; `time_ns` is the time of arrival."""

    time_ns: int
    info: FrameInfo


@dataclass(frozen=True, slots=True)
class FieldOfViewMeasured:
    """A pair was correlated with frame 0.

    Attributes:
        time_ns: experiment time.
        pair: its number.
        shift_px: mean disparity (x, y) of the field since frame 0.
    """

    time_ns: int
    pair: int
    shift_px: tuple[float, float]


@dataclass(frozen=True, slots=True)
class DriftForecastUpdated:
    """Forecast of the drift rate from the pairs so far.

    Attributes:
        time_ns: experiment time.
        pair: number of the newest pair in the estimate.
        scans: begin (experiment time, ns, ascending), mean rate (px/s) and its standard uncertainty of future scans; empty without a
            forecast.
    """

    time_ns: int
    pair: int
    scans: tuple[tuple[int, float, float], ...]


@dataclass(frozen=True, slots=True)
class HoldDriftMeasured:
    """Drift rate between two frames of one hold.

    Attributes:
        time_ns: experiment time.
        begin_ns: begin of the first frame, experiment time.
        rate_px_s: magnitude of the drift rate.
    """

    time_ns: int
    begin_ns: int
    rate_px_s: float


@dataclass(frozen=True, slots=True)
class CalibrationAssessed:
    """Assessment of the calibration from the pairs so far.

    Attributes:
        time_ns: experiment time.
        pair: number of the newest pair in the estimate.
        rejection_reason: why the calibration is rejected, one sentence with the figures; empty if it is accepted.
    """

    time_ns: int
    pair: int
    rejection_reason: str


@dataclass(frozen=True, slots=True)
class FrameUnreadable:
    """An exported file cannot be used."""

    time_ns: int
    export: int
    reason: str


@dataclass(frozen=True, slots=True)
class OperatorAction:
    """A command of the operator, or of semlive in place of the operator.

    Attributes:
        time_ns: experiment time.
        verb: the command.
        reason: why semlive issued it; empty for a command of the operator.
    """

    time_ns: int
    verb: OperatorCommand
    reason: str = ""


Event = (
    LinksOpening
    | LinksReady
    | Tick
    | LoadReading
    | StageReading
    | CommandAcknowledged
    | DeviceStopped
    | LinkStale
    | LinkLost
    | LinkRestored
    | DeviceFault
    | FrameScanned
    | FrameUnreadable
    | FieldOfViewMeasured
    | DriftForecastUpdated
    | HoldDriftMeasured
    | CalibrationAssessed
    | OperatorAction
)
