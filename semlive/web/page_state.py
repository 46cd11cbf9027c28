"""What the page shows, as one frozen value; a part that did not change is the same object.

Times are seconds after the start of the run (`Run.start_ns`): browsers have no integers for nanoseconds since 1970.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from semlive.data.clock import Clock
from semlive.data.experiment import Step
from semlive.service.log.alarms import Alarms
from semlive.web.downsampled_series import DownsampledSeries


@dataclass(frozen=True, slots=True)
class Run:
    """What is to be done, as configured.

    Attributes:
        name: of the run.
        host: computer that runs it.
        version: of semlive.
        start_ns: experiment time at which it began.
        limits: soft limits by name; empty without a load frame.
        hold_s: rest before a pair.
        max_hold_s: longest rest.
        settle_s: how long all must be within tolerance before.
        warm_up_rate_px_s: what the warm-up gate asks; None without one.
        warm_up_wait_s: how long it waits.
        area_mm2: cross-section of the specimen, None if unknown.
        loading_axis: ``x`` or ``y``.
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


@dataclass(frozen=True, slots=True)
class Schedule:
    """Steps that are done, as they were done, and those that were planned.

    Attributes:
        planned: as configured.
        done: of the pairs so far.
        measures: a pair more is being taken, to measure the drift while the warm-up gate waits.
    """

    planned: tuple[Step, ...] = ()
    done: tuple[Step, ...] = ()
    measures: bool = False


@dataclass(frozen=True, slots=True)
class Protocol:
    """Where the run is.

    Attributes:
        state: of the protocol.
        cause: of the last transition.
        step: index of the step.
        since_s: when the state was entered.
        hold_end_s: when the hold is over at the earliest; None unless holding.
        message: last sentence for the operator.
        advice: what to do; empty if nothing.
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
    """The last reading of load frame and stage; None where there is none."""

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
    """Drift over scan time, and what is expected.

    Attributes:
        frames: ascending.
        forecast: rows of time_s, x, y, sigma x, sigma y (px) of scans to come.
        rate_px_s: forecast mean speed of the next scan, and its standard uncertainty.
        verdict: of the warm-up gate, one sentence.
        warm: whether the gate has let the run pass.
    """

    frames: tuple[DriftFrame, ...] = ()
    forecast: tuple[tuple[float, ...], ...] = ()
    rate_px_s: tuple[float, float] | None = None
    verdict: str = "no pair yet"
    warm: bool | None = None


@dataclass(frozen=True, slots=True)
class MapQuality:
    """How well one map was correlated."""

    reference: int
    current: int
    converged: int
    points: int
    noise_px: float | None
    zncc: float | None = None


@dataclass(frozen=True, slots=True)
class StrainPoint:
    """Mean strain of one frame beside its load; stress is None without load or area."""

    frame: int
    phase: str
    load_n: float | None
    stress_mpa: float | None
    axial: float
    axial_sigma: float
    transverse: float
    transverse_sigma: float
    sd_axial: float


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
    """Strain beside stress, and what follows from it."""

    points: tuple[StrainPoint, ...] = ()
    elastic: tuple[ElasticRow, ...] = ()
    dic_over_gage: tuple[float, float] | None = None
    vsg_px: float | None = None


@dataclass(frozen=True, slots=True)
class Notice:
    """Something that went wrong, in words: an alarm, or a warning that nobody has to acknowledge.

    Attributes:
        time_s: when.
        level: ``error`` or ``warning``.
        text: what went wrong.
        advice: what to do; empty if nothing.
        identity: by which an alarm is acknowledged; empty for a warning.
        code: `FaultCode` of an alarm, empty if the log has none.
        acknowledged_s: when a person acknowledged it, None as long as nobody did.
        acknowledged_by: where that request came from.
        disobeyed: an open alarm: the machine moves on after every stop that was ordered.
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
    """What a person is asked and has not answered."""

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
    """A file or frame that is in no pair, and why."""

    time_s: float
    name: str
    reason: str


@dataclass(frozen=True, slots=True)
class Frames:
    """Exported files.

    Attributes:
        newest: number of the newest export, None before the first.
        name: its file.
        time_s: when it arrived.
        arrived: how many files arrived.
        paired: how many frames are in pairs.
        refused_count: how many files or frames were refused.
        refused: the last of them, newest first.
    """

    newest: int | None = None
    name: str = ""
    time_s: float = 0.0
    arrived: int = 0
    paired: int = 0
    refused_count: int = 0
    refused: tuple[RejectedFileRow, ...] = ()


@dataclass(frozen=True, slots=True)
class FrameMaps:
    """A frame that there are maps of; `version` grows with every map of it."""

    frame: int
    phase: str
    load_n: float | None
    fields: tuple[str, ...]
    version: int


@dataclass(frozen=True, slots=True)
class Maps:
    """Which maps there are, and the grid they lie on: x0, y0, step, nx, ny, subset (px)."""

    frames: tuple[FrameMaps, ...] = ()
    grid: tuple[int, ...] | None = None


@dataclass(frozen=True, slots=True)
class PageState:
    """Everything that the page shows, and what the next messages are understood by.

    Attributes:
        frame_loads: mean load of each frame of a pair, N.
        clock: line of experiment time in force.
        boot_id: boot of the computer that its monotonic clock belongs to.
        last_ns: when the last message was recorded.
        alarms: alarms and warnings as they are shown, oldest first.
        raised: the alarms that they are made of.
        warnings: the warnings that they are made of.
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
    frame_loads: dict[int, float] = field(default_factory=dict)
    clock: Clock | None = None
    boot_id: str = ""
    last_ns: int = 0
    raised: Alarms = field(default_factory=Alarms)
    warnings: tuple[Notice, ...] = ()
