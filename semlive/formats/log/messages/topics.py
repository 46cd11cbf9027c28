"""Topics of the log: the message model, or the encoding, of each; JSON of messages and schemas of topics."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, ValidationError

from semlive.errors import BadLog
from semlive.formats.log.foxglove import FILE_DESCRIPTORS, IMAGE_TOPICS
from semlive.formats.log.messages.base import Message
from semlive.formats.log.messages.devices import LoadSampleMessage, StageSampleMessage
from semlive.formats.log.messages.frames import FileMessage, PairMessage, ScanMessage, TriggerMessage
from semlive.formats.log.messages.log_line import FoxgloveLog, LogLineMessage
from semlive.formats.log.messages.results import (
    DicMessage,
    DistortionMessage,
    DriftMessage,
    ElasticMessage,
    HoldDriftMessage,
    MotionMessage,
    ResultMessage,
    StrainMessage,
)
from semlive.formats.log.messages.run import (
    ClockMessage,
    ClockOffsetMessage,
    CommandMessage,
    FaultMessage,
    OperatorMessage,
    RunMessage,
    SnapshotMessage,
    StateMessage,
)
from semlive.formats.log.messages.schemas import non_nullable, plottable_schema

Payload = Message | ResultMessage
_OPTIONAL_KEYS: dict[str, frozenset[str]] = {}

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
    "/sem/trigger": TriggerMessage,
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
"""The bytes of an exported file; `sequence` is the number of the export."""
SEM_SIDECAR = "/sem/sidecar"
"""The bytes of the sidecar of an exported file; `sequence` is the number of the export. It is written before `/sem/original`."""
DIC_MAP = "/dic/map"
"""A disparity map, encoded by `semlive.formats.log.maps`; `sequence` is the number of its current frame."""
DISPLACEMENT_FIELD = "/displacement/field"
"""The corrected displacement of a frame, encoded by `semlive.formats.log.maps`; `sequence` is the number of the frame."""
STRAIN_FIELD = "/strain/field"
"""The strain of a frame, encoded by `semlive.formats.log.maps`; `sequence` is the number of the frame."""

RAW_TOPICS: Mapping[str, str] = {
    **dict.fromkeys((SEM_ORIGINAL, SEM_SIDECAR, DIC_MAP, DISPLACEMENT_FIELD, STRAIN_FIELD), "application/octet-stream"),
    **dict.fromkeys(IMAGE_TOPICS, "protobuf"),
}
"""Topics without a JSON schema, and their message encoding; `sequence` has a meaning for each of them."""


def topic_of(message: Payload) -> str:
    """Return the topic of a message."""
    return next(topic for topic, model in TOPICS.items() if isinstance(message, model))


def to_json(message: Payload, wall: bool = True) -> bytes:
    """Return a message as canonical JSON.

    Args:
        message: the message.
        wall: whether to write the keys that begin with `wall_`; without them equal inputs give equal bytes.

    Raises:
        ValueError: a number is NaN or infinite.
    """
    values: dict[str, Any] = message.model_dump(mode="json")
    optional = _optional_keys(type(message))
    values = {key: value for key, value in values.items() if value is not None or key not in optional}
    if not wall:
        values = {key: value for key, value in values.items() if not key.startswith("wall_")}
    return json.dumps(values, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()


def from_json(topic: str, payload: bytes) -> Payload:
    """Return the message of a payload.

    Raises:
        BadLog: the topic is unknown, or the payload does not fit its model.
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
    """Return the JSON schema of the payload of a topic; `schema_of` returns the form that is written to the log."""
    return json.dumps(_json_schema(topic), sort_keys=True).encode()


def _json_schema(topic: str) -> dict[str, Any]:
    model = FoxgloveLog if topic == "/log" else TOPICS[topic]
    return non_nullable(model.model_json_schema(mode="serialization"), _optional_keys(model))


def _optional_keys(model: type[BaseModel]) -> frozenset[str]:
    """Keys that are omitted from the JSON when they are None: those that are None by default."""
    keys = _OPTIONAL_KEYS.get(model.__name__)
    if keys is None:
        keys = _OPTIONAL_KEYS[model.__name__] = frozenset(name for name, info in model.model_fields.items() if info.default is None)
    return keys


def schema_of(topic: str) -> tuple[str, str, bytes] | None:
    """Return name, encoding and text of the schema of a topic in the log; None for semlive's own binary formats.

    Raises:
        KeyError: there is no such topic.
    """
    if topic in IMAGE_TOPICS:
        return IMAGE_TOPICS[topic], "protobuf", FILE_DESCRIPTORS[IMAGE_TOPICS[topic]]
    if topic in RAW_TOPICS:
        return None
    name = "foxglove.Log" if topic == "/log" else "semlive." + TOPICS[topic].__name__
    return name, "jsonschema", json.dumps(plottable_schema(_json_schema(topic)), sort_keys=True).encode()
