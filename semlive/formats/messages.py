"""What stands in a log: one model for each topic, its JSON, and the registry of topics.

Payloads are canonical JSON: keys sorted, no blanks, floats as Python's repr, which reads back to the same float; NaN and
infinity are refused. Fields that begin with `wall_` tell how long something took and differ from run to run; everything
else of a replay can be compared byte for byte. Nouns of `semlive.data` stand in messages as they are.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict, JsonValue, RootModel, ValidationError

from semlive.data.experiment import Step
from semlive.data.frame import FrameInfo
from semlive.data.grid import Grid
from semlive.data.loading import FrameLoad, MotionState
from semlive.data.scan import Sourced
from semlive.data.strain import GageComparison, Measured, Tensor2
from semlive.errors import BadLog

Values = tuple[float, ...]
Rows = tuple[tuple[float, ...], ...]
Point = tuple[float, float]


class Message(BaseModel):
    """Base of all messages: frozen, no unknown fields, no NaN."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=False)


class RunMessage(Message):
    """`/run`: a run began, or was taken up again in the next segment.

    Attributes:
        run: name of the run.
        segment: number of this segment.
        started_time_ns: experiment time of the start, UTC ns.
        started_mono_ns: monotonic clock at that instant.
        boot_id: identity of the boot that the monotonic clock belongs to; empty if unknown.
        host: computer's name.
        versions: of semlive, python, numpy, numba, ...
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


class ClockMessage(Message):
    """`/clock`: the line of experiment time in force from now on."""

    utc0_ns: int
    mono0_ns: int
    rate: float
    revision: int
    reason: str


class StateMessage(Message):
    """`/state`: a transition of the engine, with its cause and the values that decided."""

    time_ns: int
    before: str
    after: str
    cause: str
    step: int | None
    guards: dict[str, JsonValue]


class CommandMessage(Message):
    """`/command`: something that was asked of a device, and how it ended."""

    time_ns: int
    what: str
    args: dict[str, JsonValue]
    result: str


class LoadSampleMessage(Message):
    """`/load_frame/sample`: one reading, with the registers as read (see `semlive.data.loading.LoadSample`)."""

    sequence: int
    time_ns: int
    mono_ns: int
    force_n: float
    extension_mm: float
    motion: MotionState
    target_n: float
    simulator_lag_s: float | None
    raw: tuple[int, ...]
    gage_strain: float | None = None


class StageSampleMessage(Message):
    """`/stage/sample`: one reading, with the registers as read (see `semlive.data.loading.StageSample`)."""

    sequence: int
    time_ns: int
    mono_ns: int
    x_um: float
    y_um: float
    motion: MotionState
    raw: tuple[int, ...]


class FileMessage(Message):
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
    """

    export: int | None
    name: str
    size: int
    sha256: str
    mtime_ns: int
    arrival_time_ns: int
    decision: str
    reason: str


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
    load_before_n: float | None
    load_after_n: float | None
    load_mean_n: float | None
    load_sd_n: float | None
    gage_strain_mean: float | None = None


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
    mean_u_px: float | None
    mean_v_px: float | None
    noise_px: float | None
    wall_s: float


class DriftForecastMessage(Message):
    """Drift of scans to come (see `semlive.data.drift.DriftForecast`)."""

    time_s: Values
    duration_s: float
    rate_px_s: tuple[Point, ...]
    sigma_px_s: tuple[Point, ...]


class DriftMessage(Message):
    """`/drift/estimate`: one revision of drift in time (see `semlive.data.drift.DriftEstimate`)."""

    revision: int
    time_s: Values
    frame: tuple[int, ...]
    drift_px: tuple[Point, ...]
    sigma_px: tuple[Point, ...]
    rate_px_s: tuple[Point, ...]
    forecast: DriftForecastMessage | None = None


class DistortionMessage(Message):
    """`/distortion/estimate`: one revision of distortion in space (see `semlive.data.drift.DistortionField`)."""

    revision: int
    grid: Grid
    ex_px: Rows
    ey_px: Rows
    sigma_px: Rows
    valid: tuple[tuple[bool, ...], ...]


class MotionMessage(Message):
    """`/motion`: one revision of how the specimen lay in a pair (see `semlive.data.drift.Motion`)."""

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


class ElasticMessage(Message):
    """`/elastic`: elastic constants so far, None while the loads do not determine them, and their comparison with a strain gage."""

    revision: int
    youngs_modulus_gpa: Measured | None
    poissons_ratio: Measured | None
    gage: GageComparison | None = None


class ResultMessage(RootModel[dict[str, JsonValue]]):
    """`/result`: the object that `semlive replay --json` prints."""

    model_config = ConfigDict(frozen=True)


class FaultMessage(Message):
    """`/fault`: something went wrong: what, where, and what semlive did about it."""

    time_ns: int
    what: str
    where: str
    action: str


class LogLineMessage(Message):
    """`/log`: one line of the service's own log."""

    time_ns: int
    level: str
    text: str


class OperatorMessage(Message):
    """`/operator`: what the operator was asked, or said."""

    time_ns: int
    what: str
    args: dict[str, JsonValue]


Payload = Message | ResultMessage

TOPICS: Mapping[str, type[Payload]] = {
    "/run": RunMessage,
    "/clock": ClockMessage,
    "/state": StateMessage,
    "/command": CommandMessage,
    "/load_frame/sample": LoadSampleMessage,
    "/stage/sample": StageSampleMessage,
    "/sem/file": FileMessage,
    "/sem/scan": ScanMessage,
    "/pair": PairMessage,
    "/dic/summary": DicMessage,
    "/drift/estimate": DriftMessage,
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
DIC_MAP = "/dic/map"
"""A disparity map, encoded by `semlive.formats.maps`; `sequence` is the number of its current frame."""
DISPLACEMENT_FIELD = "/displacement/field"
"""A frame's displacement, corrected, encoded by `semlive.formats.maps`; `sequence` is the frame's number."""
STRAIN_FIELD = "/strain/field"
"""A frame's strain, encoded by `semlive.formats.maps`; `sequence` is the frame's number."""

RAW_TOPICS: Mapping[str, str] = dict.fromkeys((SEM_ORIGINAL, DIC_MAP, DISPLACEMENT_FIELD, STRAIN_FIELD), "application/octet-stream")
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
    """JSON schema of a topic's payload, as it stands in the log."""
    return json.dumps(TOPICS[topic].model_json_schema(mode="serialization"), sort_keys=True).encode()
