"""What stands in a log: one model for each topic, its JSON, and the registry of topics.

Payloads are canonical JSON: keys sorted, no blanks, floats as Python's repr, which reads back to the same float; NaN and
infinity are refused. A field that is None by default is left out when it is None. Fields that begin with `wall_` tell how
long something took and differ from run to run; everything else of a replay can be compared byte for byte. Nouns of
`semlive.data` stand in messages as they are.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict, JsonValue, RootModel, ValidationError

from semlive.data.drift import CalibrationQuality
from semlive.data.experiment import Step
from semlive.data.frame import ColumnSettings, FrameInfo
from semlive.data.grid import Grid
from semlive.data.loading import DeviceFault, FrameLoad, MotionState
from semlive.data.scan import Provenance, Sourced
from semlive.data.strain import MeasuredValue, StrainGageComparison, Tensor2
from semlive.errors import BadLog
from semlive.formats.log.base import BootStamped, MonotonicStamped
from semlive.formats.log.base import Message as Message
from semlive.formats.log.foxglove import FILE_DESCRIPTORS, IMAGE_TOPICS
from semlive.formats.log.log_line import FoxgloveLog
from semlive.formats.log.log_line import LogLineMessage as LogLineMessage
from semlive.formats.log.schemas import non_nullable, plottable_schema

Values = tuple[float, ...]
Rows = tuple[tuple[float, ...], ...]
Point = tuple[float, float]


class RunMessage(Message):
    """`/run`: a run began, or was taken up again in the next segment.

    Attributes:
        run: name of the run.
        segment: number of this segment.
        started_time_ns: experiment time of the start, UTC ns.
        started_mono_ns: monotonic clock at that instant.
        boot_id: identity of the boot that the monotonic clock belongs to; empty if unknown.
        host: computer's name.
        versions: of semlive, python, numpy, numba, ... and the `commit` that semlive comes from, where that can be told.
        config: the checked configuration.
    """

    run: str
    segment: int = 0
    started_time_ns: int
    started_mono_ns: int = 0
    boot_id: str = ""
    host: str
    versions: dict[str, str]
    config: dict[str, JsonValue]


class ClockMessage(MonotonicStamped):
    """`/clock`: the line of experiment time in force from now on."""

    utc0_ns: int
    mono0_ns: int
    rate: float
    revision: int
    reason: str


class ClockOffsetMessage(Message):
    """`/clock/offset`: another computer's clock beside experiment time, as the files so far tell it (see `semlive.data.clock`).

    Attributes:
        clock: ``sem``, the computer that writes the time into the files, or ``share``, the one that keeps their modification times.
        offset_s: that clock minus experiment time.
        sigma_s: standard uncertainty.
        files: how many files tell it.
        export: the newest of them; None if it was asked otherwise.
        reason: why it is told, one sentence.
        advice: what to do if it makes frames count as scanned at the wrong time; empty if nothing.
    """

    clock: str
    offset_s: float
    sigma_s: float
    files: int
    export: int | None
    reason: str
    advice: str = ""


class StateMessage(MonotonicStamped):
    """`/state`: a transition of the engine, with its cause and the values that decided."""

    time_ns: int
    before: str
    after: str
    cause: str
    step: int | None
    guards: dict[str, JsonValue]


class CommandMessage(MonotonicStamped):
    """`/command`: something that was asked of a device, and how it ended."""

    time_ns: int
    what: str
    args: dict[str, JsonValue]
    result: str


class LoadSampleMessage(BootStamped):
    """`/load_frame/sample`: one reading, with the registers as read (see `semlive.data.loading.LoadSample`)."""

    sequence: int
    time_ns: int
    mono_ns: int
    force_n: float
    extension_mm: float
    motion: MotionState
    target_n: float
    simulator_lag_s: float | None = None
    raw: tuple[int, ...]
    gage_strain: float | None = None
    trouble: DeviceFault | None = None
    rtt_s: float | None = None


class StageSampleMessage(BootStamped):
    """`/stage/sample`: one reading, with the registers as read (see `semlive.data.loading.StageSample`)."""

    sequence: int
    time_ns: int
    mono_ns: int
    x_um: float
    y_um: float
    motion: MotionState
    raw: tuple[int, ...]
    rtt_s: float | None = None


class SnapshotMessage(Message):
    """`/snapshot`: where a run stood when it was taken up again; the configuration is in the `/run` before it.

    The estimate itself is not repeated here: the pairs and disparity maps of the earlier segments are exact, and give it again to the
    last bit. `inputs` and `outputs` say how far it was.

    Attributes:
        segment: number of this segment.
        time_ns: experiment time.
        interrupted_time_ns: when the last message before was recorded.
        interrupted_boot_id: boot of the computer then.
        state: of the protocol when it broke off.
        next_step: index of the step that is entered again, or the number of steps if all are done.
        pairs: pairs that count.
        exports: exported files so far; the next one has this number.
        origin_um: the stage's reading when the run began, None without one.
        load: last reading of the load frame.
        stage: last reading of the stage.
        inputs: messages that analysis has been given.
        outputs: messages of analysis that stand in the log.
        revision: of the last estimate in the log, 0 if there is none.
        pairs_analysed: how many pairs it is from.
        damage: what could not be read of the earlier segments, one sentence each.
    """

    segment: int
    time_ns: int
    interrupted_time_ns: int
    interrupted_boot_id: str
    state: str
    next_step: int
    pairs: int
    exports: int
    origin_um: Point | None
    load: LoadSampleMessage | None
    stage: StageSampleMessage | None
    inputs: int
    outputs: int
    revision: int
    damage: tuple[str, ...]
    pairs_analysed: int = 0


class FileMessage(MonotonicStamped):
    """`/sem/file`: a file in the export folder, and what was decided about it.

    Attributes:
        export: number of the export, or None if the watcher refused the file.
        name: file name.
        size: bytes.
        sha256: of the bytes; empty if they were never read.
        mtime_ns: modification time.
        arrival_time_ns: experiment time when it was believed complete, or refused.
        decision: ``arrived``, ``paired`` or ``refused``.
        reason: why, one sentence; may be empty.
        sidecar_sha256: of the bytes of the text file beside it; empty without one.
        settled_time_ns: experiment time when the watcher first saw it as it stayed; 0 if unknown.
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
    """`/sem/scan`: what is known of a frame, each value with where it comes from, and the load while it was scanned.

    `frame` is the frame's number in the analysis, None for exports that are in no pair.
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


class PairMessage(Message):
    """`/pair`: two exports are the pair of a step (see `semlive.data.pair.PairDecision`)."""

    pair: int
    step: Step
    first: FrameInfo
    second: FrameInfo
    loads: tuple[FrameLoad, FrameLoad] | None


class DicMessage(Message):
    """`/dic/summary`: one disparity map in a line; means are None if no point converged."""

    reference: int
    current: int
    points: int
    converged: int
    mean_u_px: float | None = None
    mean_v_px: float | None = None
    noise_px: float | None = None
    wall_s: float


class DriftForecastMessage(Message):
    """Drift of scans to come (see `semlive.data.drift.DriftForecast`)."""

    time_s: Values
    duration_s: float
    rate_px_s: tuple[Point, ...]
    sigma_px_s: tuple[Point, ...]


class DriftMessage(Message):
    """`/drift/estimate`: one revision of drift in time, and what the calibration is worth (see `semlive.data.drift`).

    The numbers from `x_px` on are the newest row of the columns before them: a plot draws numbers, not the ends of columns.
    `pairs` is how many pairs it is from; logs that do not have it have one revision for each pair.
    """

    revision: int
    pairs: int | None = None
    time_s: Values
    frame: tuple[int, ...]
    drift_px: tuple[Point, ...]
    sigma_px: tuple[Point, ...]
    rate_px_s: tuple[Point, ...]
    forecast: DriftForecastMessage | None = None
    x_px: float | None = None
    y_px: float | None = None
    sigma_x_px: float | None = None
    sigma_y_px: float | None = None
    rate_x_px_s: float | None = None
    rate_y_px_s: float | None = None
    calibration: CalibrationQuality | None = None


class HoldDriftMessage(Message):
    """`/drift/hold`: drift seen directly between two frames of one rest (see `semlive.data.drift.HoldDrift`)."""

    before: int
    after: int
    begin_time_ns: int
    end_time_ns: int
    rate_px_s: Point
    sigma_px_s: Point


class DistortionMessage(Message):
    """`/distortion/estimate`: one revision of distortion in space (see `semlive.data.drift.DistortionField`)."""

    revision: int
    grid: Grid
    ex_px: Rows
    ey_px: Rows
    sigma_px: Rows
    valid: tuple[tuple[bool, ...], ...]


class MotionMessage(Message):
    """`/motion`: one revision of how the specimen lay in a pair (see `semlive.data.drift.PairMotion`)."""

    revision: int
    pair: int
    shift_px: Point
    shift_sigma_px: Point
    gradient: tuple[Point, Point]
    gradient_sigma: tuple[Point, Point]


class StrainMessage(Message):
    """`/strain/summary`: strain of a frame relative to frame 0 (see `semlive.data.strain.StrainSummary`)."""

    revision: int
    frame: int
    mean: Tensor2
    mean_sigma: Tensor2
    sd: Tensor2
    vsg_px: float
    gauge_sigma: Tensor2 | None = None
    systematic_sigma: Tensor2 | None = None


class ElasticMessage(Message):
    """`/elastic`: elastic constants so far, None while the loads do not determine them, and their comparison with a strain gage.

    `pairs` is how many pairs they are from; logs that do not have it have one revision for each pair.
    """

    revision: int
    pairs: int | None = None
    youngs_modulus_gpa: MeasuredValue | None = None
    poissons_ratio: MeasuredValue | None = None
    gage: StrainGageComparison | None = None


class ResultMessage(RootModel[dict[str, JsonValue]]):
    """`/result`: the object that `semlive replay --json` prints."""

    model_config = ConfigDict(frozen=True)


class FaultMessage(MonotonicStamped):
    """`/fault`: something went wrong: what, where, what semlive did about it, and as `code` a `FaultCode` (empty in older logs)."""

    time_ns: int
    what: str
    where: str
    action: str
    code: str = ""


class OperatorMessage(MonotonicStamped):
    """`/operator`: what the operator was asked, or said."""

    time_ns: int
    what: str
    args: dict[str, JsonValue]


Payload = Message | ResultMessage
_LEFT_OUT: dict[str, frozenset[str]] = {}

TOPICS: Mapping[str, type[Payload]] = {
    "/run": RunMessage,
    "/snapshot": SnapshotMessage,
    "/clock": ClockMessage,
    "/clock/offset": ClockOffsetMessage,
    "/state": StateMessage,
    "/command": CommandMessage,
    "/load_frame/sample": LoadSampleMessage,
    "/stage/sample": StageSampleMessage,
    "/sem/file": FileMessage,
    "/sem/scan": ScanMessage,
    "/pair": PairMessage,
    "/dic/summary": DicMessage,
    "/drift/estimate": DriftMessage,
    "/drift/hold": HoldDriftMessage,
    "/distortion/estimate": DistortionMessage,
    "/motion": MotionMessage,
    "/strain/summary": StrainMessage,
    "/elastic": ElasticMessage,
    "/result": ResultMessage,
    "/fault": FaultMessage,
    "/log": LogLineMessage,
    "/operator": OperatorMessage,
}

SEM_ORIGINAL = "/sem/original"
"""The bytes of an exported file as they came; `sequence` is the export's number."""
SEM_SIDECAR = "/sem/sidecar"
"""The bytes of the text file beside an exported file; `sequence` is the export's number. It stands before `/sem/original`."""
DIC_MAP = "/dic/map"
"""A disparity map, encoded by `semlive.formats.log.maps`; `sequence` is the number of its current frame."""
DISPLACEMENT_FIELD = "/displacement/field"
"""A frame's displacement, corrected, encoded by `semlive.formats.log.maps`; `sequence` is the frame's number."""
STRAIN_FIELD = "/strain/field"
"""A frame's strain, encoded by `semlive.formats.log.maps`; `sequence` is the frame's number."""

RAW_TOPICS: Mapping[str, str] = {
    **dict.fromkeys((SEM_ORIGINAL, SEM_SIDECAR, DIC_MAP, DISPLACEMENT_FIELD, STRAIN_FIELD), "application/octet-stream"),
    **dict.fromkeys(IMAGE_TOPICS, "protobuf"),
}
"""Topics without a JSON schema, with their message encoding; for each the sequence has a meaning."""


def topic_of(message: Payload) -> str:
    """The topic that a message belongs to."""
    return next(topic for topic, model in TOPICS.items() if isinstance(message, model))


def to_json(message: Payload, wall: bool = True) -> bytes:
    """A message as canonical JSON.

    Args:
        message: the message.
        wall: with the fields that begin with `wall_`; without them equal inputs give equal bytes.

    Raises:
        ValueError: a number is NaN or infinite.
    """
    values: dict[str, Any] = message.model_dump(mode="json")
    left_out = _left_out(type(message))
    values = {key: value for key, value in values.items() if value is not None or key not in left_out}
    if not wall:
        values = {key: value for key, value in values.items() if not key.startswith("wall_")}
    return json.dumps(values, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()


def from_json(topic: str, payload: bytes) -> Payload:
    """The message that a payload of a topic holds.

    Raises:
        BadLog: the topic is unknown, or the payload is not one of its messages.
    """
    model = TOPICS.get(topic)
    if model is None:
        raise BadLog(f"{topic}: no such topic; read this log with the version of semlive that wrote it.")
    try:
        return model.model_validate_json(payload)
    except ValidationError as exc:
        where = ".".join(str(part) for part in exc.errors()[0]["loc"]) or "the message"
        raise BadLog(f"{topic}: {where}: {exc.errors()[0]['msg']}; read this log with the version of semlive that wrote it.") from exc


def json_schema(topic: str) -> bytes:
    """JSON schema of a topic's payload; `schema_of` gives it as it stands in the log."""
    return json.dumps(_json_schema(topic), sort_keys=True).encode()


def _json_schema(topic: str) -> dict[str, Any]:
    model = FoxgloveLog if topic == "/log" else TOPICS[topic]
    return non_nullable(model.model_json_schema(mode="serialization"), _left_out(model))


def _left_out(model: type[BaseModel]) -> frozenset[str]:
    """Fields that are left out of the JSON when they are None: those that are None by default."""
    known = _LEFT_OUT.get(model.__name__)
    if known is None:
        known = _LEFT_OUT[model.__name__] = frozenset(name for name, one in model.model_fields.items() if one.default is None)
    return known


def schema_of(topic: str) -> tuple[str, str, bytes] | None:
    """Name, encoding and text of a topic's schema, as they stand in the log; None for bytes of our own.

    Raises:
        KeyError: there is no such topic.
    """
    if topic in IMAGE_TOPICS:
        return IMAGE_TOPICS[topic], "protobuf", FILE_DESCRIPTORS[IMAGE_TOPICS[topic]]
    if topic in RAW_TOPICS:
        return None
    name = "foxglove.Log" if topic == "/log" else "semlive." + TOPICS[topic].__name__
    return name, "jsonschema", json.dumps(plottable_schema(_json_schema(topic)), sort_keys=True).encode()
