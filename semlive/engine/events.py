"""What happens to a run. Every event carries experiment time, the only time that the engine knows."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from semlive.data.faults import FaultCode
from semlive.data.frame import FrameInfo
from semlive.data.loading import DeviceIdentity, LoadSample, StageSample


class Device(StrEnum):
    """Who an event is about."""

    LOAD_FRAME = "load_frame"
    STAGE = "stage"
    SEM = "sem"

    @property
    def words(self) -> str:
        """The device in a sentence."""
        return {"load_frame": "load frame", "stage": "stage", "sem": "SEM"}[self.value]


class OperatorCommand(StrEnum):
    """What the operator can say."""

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
        load_frame: who answers, or None if the run has no load frame.
        stage: likewise.
    """

    time_ns: int
    load_frame: DeviceIdentity | None
    stage: DeviceIdentity | None


@dataclass(frozen=True, slots=True)
class Tick:
    """Time passes."""

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
    """A device took the last motion command: written and read back."""

    time_ns: int
    device: Device


@dataclass(frozen=True, slots=True)
class DeviceStopped:
    """The link thread stopped a device on its own account."""

    time_ns: int
    device: Device
    reason: str
    code: FaultCode = FaultCode.DEVICE_FAULT


@dataclass(frozen=True, slots=True)
class LinkStale:
    """The last sample is too old to decide on."""

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
    """A device refused a command or is in trouble.

    Attributes:
        time_ns: experiment time.
        device: which.
        reason: one sentence.
        emergency: the emergency stop was pressed.
        code: what kind of fault it is.
    """

    time_ns: int
    device: Device
    reason: str
    emergency: bool = False
    code: FaultCode = FaultCode.DEVICE_FAULT


@dataclass(frozen=True, slots=True)
class FrameScanned:
    """A frame was exported completely and its header read; `time_ns` is when it was known."""

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
    """How fast the drift is expected to be, from the pairs so far.

    Attributes:
        time_ns: experiment time.
        pair: number of the newest pair that it is known from.
        scans: begin (experiment time, ns, ascending), mean rate (px/s) and its standard uncertainty of scans to come; empty if the
            estimate does not say.
    """

    time_ns: int
    pair: int
    scans: tuple[tuple[int, float, float], ...]


@dataclass(frozen=True, slots=True)
class HoldDriftMeasured:
    """How fast the drift was between two frames of one rest.

    Attributes:
        time_ns: experiment time.
        begin_ns: when the first of them began.
        rate_px_s: its size.
    """

    time_ns: int
    begin_ns: int
    rate_px_s: float


@dataclass(frozen=True, slots=True)
class CalibrationAssessed:
    """What the calibration is worth, from the pairs so far.

    Attributes:
        time_ns: experiment time.
        pair: number of the newest pair that it is known from.
        rejection_reason: why nothing is to be loaded with it, one sentence with the figures; empty where it is good enough.
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
    """The operator said something, or semlive did in the operator's place.

    Attributes:
        time_ns: experiment time.
        verb: what.
        reason: why semlive said it; empty if the operator did.
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
