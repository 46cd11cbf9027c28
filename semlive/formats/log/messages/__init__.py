"""Messages of the log: one model for each topic, its JSON, and the registry of topics.

A payload is canonical JSON: keys sorted, no blanks, floats as Python's repr, which reads back to the same float; NaN and
infinity are refused. A key whose default is None is omitted when the value is None. Keys that begin with `wall_` hold
durations that differ from run to run; all other keys of two replays are equal byte for byte. Values of `semlive.data` are
stored in messages unchanged.
"""

from __future__ import annotations

from semlive.formats.log.messages.base import (
    BootStamped,
    Message,
    MonotonicStamped,
    Point,
)
from semlive.formats.log.messages.devices import LoadSampleMessage, StageSampleMessage
from semlive.formats.log.messages.frames import FileMessage, PairMessage, ScanMessage, ScanReadingMessage, TriggerMessage
from semlive.formats.log.messages.log_line import LogLineMessage
from semlive.formats.log.messages.results import (
    DicMessage,
    DistortionMessage,
    DriftForecastMessage,
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
from semlive.formats.log.messages.topics import (
    DIC_MAP,
    DISPLACEMENT_FIELD,
    RAW_TOPICS,
    SEM_ORIGINAL,
    SEM_SIDECAR,
    STRAIN_FIELD,
    TOPICS,
    Payload,
    from_json,
    json_schema,
    schema_of,
    to_json,
    topic_of,
)

__all__ = [
    "DIC_MAP",
    "DISPLACEMENT_FIELD",
    "RAW_TOPICS",
    "SEM_ORIGINAL",
    "SEM_SIDECAR",
    "STRAIN_FIELD",
    "TOPICS",
    "BootStamped",
    "ClockMessage",
    "ClockOffsetMessage",
    "CommandMessage",
    "DicMessage",
    "DistortionMessage",
    "DriftForecastMessage",
    "DriftMessage",
    "ElasticMessage",
    "FaultMessage",
    "FileMessage",
    "HoldDriftMessage",
    "LoadSampleMessage",
    "LogLineMessage",
    "Message",
    "MonotonicStamped",
    "MotionMessage",
    "OperatorMessage",
    "PairMessage",
    "Payload",
    "Point",
    "ResultMessage",
    "RunMessage",
    "ScanMessage",
    "ScanReadingMessage",
    "SnapshotMessage",
    "StageSampleMessage",
    "StateMessage",
    "StrainMessage",
    "TriggerMessage",
    "from_json",
    "json_schema",
    "schema_of",
    "to_json",
    "topic_of",
]
