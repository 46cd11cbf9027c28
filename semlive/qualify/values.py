"""Values of a qualification: figures with 95 % intervals, quantities that the frames do not determine, limits and protocol."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum

FORMAT_VERSION = 1
SAME_SIZE, SAME_TURN_DEG, SAME_DWELL = 0.02, 1.0, 0.05
"""Largest relative difference of pixel sizes, difference of rotations and relative difference of dwell times within one setup."""


class Trend(StrEnum):
    """Direction in which a figure becomes worse; ``none`` for a property without a preferred direction."""

    LARGER = "larger"
    SMALLER = "smaller"
    NONE = "none"


@dataclass(frozen=True, slots=True)
class Figure:
    """A measured figure.

    Attributes:
        name: canonical name, without unit.
        title: short description.
        value: most likely value.
        low: lower end of the 95 % interval.
        high: upper end of the 95 % interval.
        unit: unit of all three; empty for ratios.
        worse: direction in which the figure becomes worse.
        note: what the figure refers to; empty if the title suffices.
    """

    name: str
    title: str
    value: float
    low: float
    high: float
    unit: str
    worse: Trend = Trend.LARGER
    note: str = ""


@dataclass(frozen=True, slots=True)
class Undetermined:
    """A quantity that the frames do not determine.

    Attributes:
        name: canonical name.
        reason: why it is not determined, a clause.
        remedy: which frames determine it, an imperative.
        by_pairs: whether further pairs of the plan can determine it.
    """

    name: str
    reason: str
    remedy: str
    by_pairs: bool = True


Result = Figure | Undetermined


@dataclass(frozen=True, slots=True)
class GaugeResolution:
    """Strain resolution at one gauge length.

    Attributes:
        gauge_px: edge of the virtual strain gauge, px, subset included.
        gauge_um: the same, um; 0 if the pixel size is unknown.
        noise: standard deviation of the strain of one gauge, largest of exx, eyy and exy, measured.
        noise_low: lower end of its 95 % interval.
        noise_high: upper end of its 95 % interval.
        systematic: false strain without correction, for the reference shift and the drift of one frame.
        systematic_corrected: standard uncertainty of the same after correction.
    """

    gauge_px: int
    gauge_um: float
    noise: float
    noise_low: float
    noise_high: float
    systematic: float
    systematic_corrected: float


@dataclass(frozen=True, slots=True)
class Limit:
    """A source of strain error.

    Attributes:
        name: canonical name of the effect.
        strain: its strain error at the reference gauge without correction.
        strain_corrected: the same after the corrections of a run.
        remedy: what reduces it, an imperative.
    """

    name: str
    strain: float
    strain_corrected: float
    remedy: str


@dataclass(frozen=True, slots=True)
class Protocol:
    """Recommended protocol.

    Attributes:
        warm_up_s: waiting time after the first pair of these frames, s.
        max_rate_px_s: drift rate above which a run waits, px/s; None without a decaying drift.
        dwell_factor: dwell time, as a multiple of that of the frames.
        subset_px: edge of the subset.
        step_px: distance of the points.
        window_points: edge of the strain gauge in points.
        shifts_px: shifts of the calibration pairs, px.
        hold_s: hold before each pair, s.
        minutes: expected beam time of the calibration, minutes.
    """

    warm_up_s: float
    max_rate_px_s: float | None
    dwell_factor: float
    subset_px: int
    step_px: int
    window_points: int
    shifts_px: tuple[tuple[float, float], ...]
    hold_s: float
    minutes: float


@dataclass(frozen=True, slots=True)
class Conditions:
    """Under which conditions the frames were taken.

    Attributes:
        source: name of the folder or log.
        time_ns: start of the first frame, UTC ns.
        frames: number of frames.
        pairs: number of pairs.
        width_px: width of a frame.
        height_px: height of a frame.
        dwell_s: dwell time.
        row_s: row time.
        frame_s: duration of one frame, all integrated scans included.
        pixel_nm: pixel size; 0 if unknown.
        vendor: vendor of the files.
        timed: whether the times of the scans are given; otherwise dwell, row and frame time are placeholders.
        not_paired: names of frames that belong to no pair, each with the reason.
        dated: whether `time_ns` is the true time; otherwise it has an arbitrary origin.
    """

    source: str
    time_ns: int
    frames: int
    pairs: int
    width_px: int
    height_px: int
    dwell_s: float
    row_s: float
    frame_s: float
    pixel_nm: float
    vendor: str
    timed: bool
    not_paired: tuple[str, ...] = ()
    dated: bool = True

    @property
    def day(self) -> str:
        """Day of the first frame as ``2026-11-26``, UTC; meaningless without `dated`."""
        return datetime.fromtimestamp(self.time_ns // 10**9, UTC).date().isoformat()


@dataclass(frozen=True, slots=True)
class ScanSetup:
    """Settings of the scan that separate groups of pairs.

    Attributes:
        pixel_nm: pixel size; 0 if unknown.
        rotation_deg: scan rotation by the file; 0 if unknown.
        dwell_s: dwell time.
    """

    pixel_nm: float
    rotation_deg: float
    dwell_s: float

    def is_same(self, other: ScanSetup) -> bool:
        """Whether both are one setup."""
        turn = (self.rotation_deg - other.rotation_deg + 180.0) % 360.0 - 180.0
        sizes = abs(self.pixel_nm - other.pixel_nm) <= SAME_SIZE * self.pixel_nm
        return sizes and abs(turn) <= SAME_TURN_DEG and abs(self.dwell_s - other.dwell_s) <= SAME_DWELL * self.dwell_s


@dataclass(frozen=True, slots=True)
class SetupFigures(ScanSetup):
    """Figures at another magnification, scan rotation or dwell time.

    Attributes:
        pixel_nm: pixel size; 0 if unknown.
        rotation_deg: scan rotation by the file; 0 if unknown.
        dwell_s: dwell time.
        pairs: number of pairs.
        figures: measured figures; those of the scan relate it to the main setup.
        height_px: height of a frame; 0 in files of earlier versions.
    """

    pairs: int
    figures: tuple[Figure, ...]
    height_px: int = 0


@dataclass(frozen=True, slots=True)
class Qualification:
    """Result of a qualification.

    Attributes:
        format: version of the format of the file.
        conditions: of the frames.
        figures: measured figures.
        undetermined: quantities that the frames do not determine.
        resolution: strain resolution by gauge length, ascending.
        limits: sources of strain error, the largest without correction first.
        limiting: name of the limiting effect without correction; empty if it is not determined.
        limiting_corrected: the same after correction.
        protocol: recommended protocol.
        setups: figures of pairs at another magnification, scan rotation or dwell time; all others are of the setup with most pairs.
    """

    format: int
    conditions: Conditions
    figures: tuple[Figure, ...]
    undetermined: tuple[Undetermined, ...]
    resolution: tuple[GaugeResolution, ...]
    limits: tuple[Limit, ...]
    limiting: str
    limiting_corrected: str
    protocol: Protocol
    setups: tuple[SetupFigures, ...] = ()
