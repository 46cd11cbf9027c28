"""State of the live page as one frozen value; a part that did not change is the same object.

Field names are keys of the JSON that the page reads. Times are seconds after the start of the run (`Run.start_ns`), because browsers
have no integers for nanoseconds since 1970.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from semlive.data.clock import Clock
from semlive.data.experiment import Step
from semlive.service.log.alarms import Alarms
from semlive.web.downsampled_series import DownsampledSeries
from semlive.web.run_progress import RunProgress


@dataclass(frozen=True, slots=True)
class Run:
    """Configuration of the run.

    Attributes:
        name: name of the run.
        host: name of the computer of the run.
        version: version of semlive.
        start_ns: experiment time of the start, ns.
        limits: soft limits by name; empty without a load frame.
        hold_s: duration of the hold before a pair, s.
        max_hold_s: maximum duration of the hold, s.
        settle_s: time within tolerance before the hold, s.
        warm_up_rate_px_s: maximum drift rate of the warm-up gate, px/s; None if it is not checked.
        warm_up_wait_s: maximum waiting time of the gate, s.
        area_mm2: cross-section of the specimen, None if unknown.
        loading_axis: image axis of the load, ``x`` or ``y``.
        pixel_um: edge of a pixel on the specimen as configured, um; None if unknown.
        mask: whether the correlation excludes a part of the specimen.
        warm_up_change_px_s: maximum change of the drift rate from pair to pair at the warm-up gate, px/s; None if it is not checked.
    """

    name: str
    host: str
    version: str
    start_ns: int
    limits: dict[str, float]
    hold_s: float
    max_hold_s: float
    settle_s: float
    warm_up_rate_px_s: float | None
    warm_up_wait_s: float | None
    area_mm2: float | None
    loading_axis: str
    pixel_um: float | None = None
    mask: bool = False
    warm_up_change_px_s: float | None = None

    @property
    def warm_up_required(self) -> str:
        """Maxima of the warm-up gate as text; empty without a gate."""
        rate = [] if self.warm_up_rate_px_s is None else [f"{60 * self.warm_up_rate_px_s:.2g} px/min"]
        change = [] if self.warm_up_change_px_s is None else [f"a change from pair to pair of {60 * self.warm_up_change_px_s:.2g} px/min"]
        return f"{' and '.join((*rate, *change))} required" if rate or change else ""


@dataclass(frozen=True, slots=True)
class Schedule:
    """Planned and completed steps.

    Attributes:
        planned: steps of the configuration.
        done: steps of the completed pairs, as carried out.
        measures: an additional pair is being taken to measure the drift while the warm-up gate waits.
    """

    planned: tuple[Step, ...] = ()
    done: tuple[Step, ...] = ()
    measures: bool = False


@dataclass(frozen=True, slots=True)
class Protocol:
    """Current state of the protocol.

    Attributes:
        state: state of the protocol.
        cause: cause of the last transition.
        step: index of the step.
        since_s: time at which the state was entered.
        hold_end_s: earliest end of the hold; None unless holding.
        message: last message for the operator.
        advice: advice for the operator; empty if there is none.
        asks: whether the run waits for the operator.
        guards: values that decided the last transition.
    """

    state: str = "idle"
    cause: str = ""
    step: int | None = None
    since_s: float = 0.0
    hold_end_s: float | None = None
    message: str = ""
    advice: str = ""
    asks: bool = False
    guards: dict[str, float | str] | None = None


@dataclass(frozen=True, slots=True)
class Reading:
    """Last reading of load frame and stage; None without the device."""

    force_n: float | None = None
    extension_mm: float | None = None
    target_n: float | None = None
    motion: str = ""
    gage_strain: float | None = None
    stage_um: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class DriftFrame:
    """Drift within one frame: rows of time_s, x, y, sigma x, sigma y (px); time after the start of frame 0."""

    frame: int
    rows: tuple[tuple[float, ...], ...]


@dataclass(frozen=True, slots=True)
class Drift:
    """Drift over scan time, and its forecast.

    Attributes:
        frames: drift of each frame, ascending.
        forecast: rows of time_s, x, y, sigma x, sigma y (px) of the next scans.
        rate_px_s: forecast mean speed during the next scan, and its standard uncertainty.
        verdict: status of the warm-up gate as text.
        warm: whether the warm-up gate is passed.
    """

    frames: tuple[DriftFrame, ...] = ()
    forecast: tuple[tuple[float, ...], ...] = ()
    rate_px_s: tuple[float, float] | None = None
    verdict: str = "no pair yet"
    warm: bool | None = None


@dataclass(frozen=True, slots=True)
class MapQuality:
    """Correlation quality of one map."""

    reference: int
    current: int
    converged: int
    points: int
    noise_px: float | None
    zncc: float | None = None


@dataclass(frozen=True, slots=True)
class StrainPoint:
    """Mean strain and load of one frame; stress is None without load or area.

    `gauge_sigma` is the standard uncertainty of exx, eyy and exy of one strain gauge; None if unknown.
    """

    frame: int
    phase: str
    load_n: float | None
    stress_mpa: float | None
    axial: float
    axial_sigma: float
    transverse: float
    transverse_sigma: float
    sd_axial: float
    gauge_sigma: tuple[float, float, float] | None = None


@dataclass(frozen=True, slots=True)
class ElasticRow:
    """Elastic constants after a pair."""

    pairs: int
    modulus_gpa: float | None
    modulus_sigma_gpa: float | None
    ratio: float | None
    ratio_sigma: float | None


@dataclass(frozen=True, slots=True)
class StressStrain:
    """Strain and stress of the frames, and the elastic constants."""

    points: tuple[StrainPoint, ...] = ()
    elastic: tuple[ElasticRow, ...] = ()
    dic_over_gage: tuple[float, float] | None = None
    vsg_px: float | None = None


@dataclass(frozen=True, slots=True)
class Notice:
    """An alarm, or a warning, which needs no acknowledgement.

    Attributes:
        time_s: time of the event.
        level: ``error`` if a person must act, else ``warning``.
        text: message.
        advice: advice for the operator; empty if there is none.
        identity: identity with which an alarm is acknowledged; empty for a warning.
        code: `FaultCode` of an alarm, empty if the log has none.
        acknowledged_s: time of the acknowledgement, None if not acknowledged.
        acknowledged_by: origin of the acknowledgement.
        disobeyed: an open alarm: the machine still moves after every stop command.
    """

    time_s: float
    level: str
    text: str
    advice: str
    identity: str = ""
    code: str = ""
    acknowledged_s: float | None = None
    acknowledged_by: str = ""
    disobeyed: bool = False


@dataclass(frozen=True, slots=True)
class Question:
    """An open prompt to the operator."""

    question: str
    text: str
    wanted: str


@dataclass(frozen=True, slots=True)
class OperatorPanel:
    """Open prompts to the operator, and the newest message."""

    questions: tuple[Question, ...] = ()
    told: str = ""


@dataclass(frozen=True, slots=True)
class RejectedFileRow:
    """A file or frame that is in no pair, and the reason."""

    time_s: float
    name: str
    reason: str


@dataclass(frozen=True, slots=True)
class Frames:
    """Exported files.

    Attributes:
        newest: number of the newest export, None before the first.
        name: name of the newest file.
        time_s: time at which it arrived.
        arrived: number of files that arrived.
        paired: number of frames in pairs.
        refused_count: number of rejected files or frames.
        refused: the last rejected ones, newest first.
    """

    newest: int | None = None
    name: str = ""
    time_s: float = 0.0
    arrived: int = 0
    paired: int = 0
    refused_count: int = 0
    refused: tuple[RejectedFileRow, ...] = ()


@dataclass(frozen=True, slots=True)
class ScanInfo:
    """Metadata of the newest file: its pixel size (um; None if unknown), time of one scan (s) and size (width, height; px)."""

    pixel_um: float | None = None
    scan_s: float | None = None
    size_px: tuple[int, int] | None = None


@dataclass(frozen=True, slots=True)
class LogRow:
    """Line of the log: ``level`` is that of the message, or ``state`` for a transition of the protocol."""

    time_s: float
    level: str
    text: str


@dataclass(frozen=True, slots=True)
class LogRows:
    """Newest lines of the log and transitions, oldest first, and their number since the start of the log."""

    rows: tuple[LogRow, ...] = ()
    count: int = 0


@dataclass(frozen=True, slots=True)
class FrameMaps:
    """Frame with maps; `version` increases with every new map of the frame.

    `image` is true once its own image is available. `shift_px` is the median disparity from frame 0, by which points are moved in it.
    """

    frame: int
    phase: str
    load_n: float | None
    fields: tuple[str, ...]
    version: int
    image: bool = False
    shift_px: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class Maps:
    """Available maps and their grid: x0, y0, step, nx, ny, subset (px)."""

    frames: tuple[FrameMaps, ...] = ()
    grid: tuple[int, ...] | None = None


@dataclass(frozen=True, slots=True)
class EarlierMessages:
    """Values of earlier messages that are needed to process the next ones.

    Attributes:
        frame_loads: mean load of each frame of a pair, N.
        last_ns: time at which the last message was recorded, ns.
        raised: alarms of the log, from which `PageState.alarms` is made.
        warnings: warnings of the log, from which `PageState.alarms` is made.
    """

    frame_loads: dict[int, float] = field(default_factory=dict)
    last_ns: int = 0
    raised: Alarms = field(default_factory=Alarms)
    warnings: tuple[Notice, ...] = ()


@dataclass(frozen=True, slots=True)
class PageState:
    """Contents of the page, and values that are needed to process the next messages.

    Attributes:
        clock: current linear relation of experiment time and monotonic clock.
        boot_id: identity of the boot of the computer to which the monotonic clock refers.
        alarms: alarms and warnings in the order shown, oldest first.
    """

    run: Run | None = None
    schedule: Schedule = Schedule()
    protocol: Protocol = Protocol()
    reading: Reading = Reading()
    load: DownsampledSeries = field(default_factory=DownsampledSeries)
    drift: Drift = Drift()
    quality: tuple[MapQuality, ...] = ()
    strength: StressStrain = StressStrain()
    alarms: tuple[Notice, ...] = ()
    desk: OperatorPanel = OperatorPanel()
    frames: Frames = Frames()
    maps: Maps = Maps()
    scan: ScanInfo = ScanInfo()
    progress: RunProgress = field(default_factory=RunProgress)
    lines: LogRows = LogRows()
    clock: Clock | None = None
    boot_id: str = ""
    earlier: EarlierMessages = field(default_factory=EarlierMessages)
