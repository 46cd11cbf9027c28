"""Messages about exported files, frames and pairs."""

from __future__ import annotations

from semlive.data.experiment import Step
from semlive.data.frame import ColumnSettings, FrameInfo
from semlive.data.loading import FrameLoad
from semlive.data.scan import Provenance, RowClock, ScanGeometry, Sourced
from semlive.formats.log.messages.base import Message, MonotonicStamped


class FileMessage(MonotonicStamped):
    """`/sem/file`: a file in the export folder, and the decision about it.

    Attributes:
        export: number of the export, or None if the watcher refused the file.
        name: file name.
        size: bytes.
        sha256: of the bytes; empty if they were never read.
        mtime_ns: modification time.
        arrival_time_ns: experiment time when it was accepted as complete, or refused.
        decision: ``arrived``, ``paired`` or ``refused``.
        reason: why, one sentence; may be empty.
        sidecar_sha256: of the bytes of its sidecar (a text file); empty without one.
        settled_time_ns: experiment time of the first scan of the folder that found the file in its final state; 0 if unknown.
    """

    export: int | None
    name: str
    size: int
    sha256: str
    mtime_ns: int
    arrival_time_ns: int
    decision: str
    reason: str
    sidecar_sha256: str = ""
    settled_time_ns: int = 0


class ScanMessage(Message):
    """`/sem/scan`: metadata of a frame, each value with its provenance, and the load during the scan.

    `frame` is the number of the frame in the analysis, None for exports that are in no pair.
    """

    frame: int | None
    export: int
    name: str
    vendor: str
    width_px: int
    height_px: int
    databar_rows: int
    dwell_time_s: Sourced[float]
    row_time_s: Sourced[float]
    frame_time_s: Sourced[float]
    integrations: Sourced[int]
    start_time_ns: Sourced[int]
    start_sigma_s: float
    end_time_ns: int
    pixel_size_m: Sourced[float]
    load_before_n: float | None = None
    load_after_n: float | None = None
    load_mean_n: float | None = None
    load_sd_n: float | None = None
    gage_strain_mean: float | None = None
    line_integrations: Sourced[int] = Sourced(1, Provenance.ASSUMED)
    column: ColumnSettings = ColumnSettings()
    start_anchor: str = "end"
    embedded_time_ns: int | None = None
    notes: tuple[str, ...] = ()
    geometry: ScanGeometry = ScanGeometry()
    clock: RowClock | None = None


class ScanReadingMessage(Message):
    """Settings of a microscope at one instant (see `semlive.data.scan_report.ScanReading`)."""

    time_ns: int
    dwell_time_s: float
    row_time_s: float | None = None
    field_width_m: float
    width_px: int
    height_px: int
    others: dict[str, str]


class TriggerMessage(Message):
    """`/sem/trigger`: settings of a triggered scan as the microscope reported them (see `semlive.data.scan_report.ScanReport`)."""

    time_ns: int
    file: str
    before: ScanReadingMessage
    after: ScanReadingMessage
    measured_row_time_s: float | None = None


class PairMessage(Message):
    """`/pair`: two exports form the pair of a step (see `semlive.data.pair.PairDecision`)."""

    pair: int
    step: Step
    first: FrameInfo
    second: FrameInfo
    loads: tuple[FrameLoad, FrameLoad] | None
