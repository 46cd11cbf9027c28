"""Messages of the log that are inputs and outputs of the analysis."""

from __future__ import annotations

from semlive.data.faults import MODEL_WARNING_ORIGIN, PAIR_ORIGIN, RESULT_FAULTS, FaultKind
from semlive.formats.log.foxglove import IMAGE_TOPICS
from semlive.formats.log.messages import (
    DIC_MAP,
    DISPLACEMENT_FIELD,
    SEM_ORIGINAL,
    SEM_SIDECAR,
    STRAIN_FIELD,
    ClockOffsetMessage,
    FaultMessage,
    FileMessage,
    LogLineMessage,
    Payload,
    from_json,
    to_json,
    topic_of,
)
from semlive.formats.log.reader import LogMessage

INPUT_TOPICS = frozenset({"/run", "/sem/file", SEM_SIDECAR, SEM_ORIGINAL, "/pair", "/state"})
READY_TEXT = "analysis is ready"
_MODEL_TEXT = "a model is fitted to the maps and taken out of them: "
_OUTPUT_TOPICS = frozenset(
    {
        "/sem/scan",
        "/dic/summary",
        "/drift/estimate",
        "/drift/hold",
        "/distortion/estimate",
        "/motion",
        "/strain/summary",
        "/elastic",
        "/result",
    }
) | {DIC_MAP, DISPLACEMENT_FIELD, STRAIN_FIELD, *IMAGE_TOPICS}
"""Topics that only the analysis writes."""
_SHARED_TOPICS = frozenset({"/log", "/clock/offset", "/sem/file", "/fault"})
"""Topics that control writes, too."""


def is_output(message: LogMessage) -> bool:
    """Whether a message of the log is an output of the analysis, which need not be written again.

    Raises:
        BadLog: the message does not agree with its topic.
    """
    if message.topic not in _SHARED_TOPICS:
        return message.topic in _OUTPUT_TOPICS
    match from_json(message.topic, message.payload):
        case ClockOffsetMessage(export=export):
            # Without an export, control measured the offset of the share at the begin of the run.
            return export is not None
        case LogLineMessage(text=text):
            return text == READY_TEXT or text.startswith(_MODEL_TEXT)
        case FileMessage(decision=decision, sha256=sha256):
            # Control rejects frames by their number; a rejection by the analysis repeats the hash of the file.
            return decision == "refused" and bool(sha256)
        case FaultMessage(kind=kind):
            return kind in RESULT_FAULTS
        case _:
            return False


def is_model_warning(fault: FaultMessage) -> bool:
    """Whether a fault is a warning about the model; the pair was used."""
    return fault.kind == FaultKind.MODEL_WARNING


def fault_origin(pair: int) -> str:
    """Return the `where` of the fault of a pair that could not be analysed."""
    return f"{PAIR_ORIGIN}{pair}"


def log_message(payload: Payload, time_ns: int) -> LogMessage:
    """Serialise an output with its time (experiment time, ns)."""
    return LogMessage(topic_of(payload), time_ns, time_ns, 0, to_json(payload))


def begin_messages(effects: tuple[str, ...], time_ns: int) -> tuple[LogMessage, ...]:
    """Return the lines for `/log` after the configuration was read: the effects of the model, if it has any, and the readiness."""
    texts = (_MODEL_TEXT + ", ".join(effects), READY_TEXT) if effects else (READY_TEXT,)
    return tuple(log_message(LogLineMessage(time_ns=time_ns, level="info", text=text), time_ns) for text in texts)


def model_warning(text: str, pair: int, time_ns: int) -> LogMessage:
    """Return a warning about the model, found with a pair that was used."""
    action = "the run continues; `semlive diagnose LOG` identifies the effect that the model lacks"
    where = f"{MODEL_WARNING_ORIGIN}{pair}"
    return log_message(FaultMessage(time_ns=time_ns, what=text, where=where, action=action, kind=FaultKind.MODEL_WARNING), time_ns)


def unusable_pair(text: str, pair: int, time_ns: int) -> LogMessage:
    """Return the fault of a pair that could not be analysed."""
    action = "the pair is left out"
    fault = FaultMessage(time_ns=time_ns, what=text, where=fault_origin(pair), action=action, kind=FaultKind.PAIR_UNUSABLE)
    return log_message(fault, time_ns)
