"""The log of a run: values of the engine and the devices as messages."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable

from pydantic import JsonValue

from semlive.data.frame import ExportedFile, FrameInfo
from semlive.data.loading import FrameLoad, LoadSample, StageSample
from semlive.data.pair import PairDecision
from semlive.engine import Transition
from semlive.formats.log import conversions as values
from semlive.formats.log.messages import (
    RAW_TOPICS,
    SEM_ORIGINAL,
    SEM_SIDECAR,
    BootStamped,
    CommandMessage,
    FaultMessage,
    FileMessage,
    LogLineMessage,
    MonotonicStamped,
    Payload,
    StateMessage,
    topic_of,
)
from semlive.formats.log.reader import LogMessage
from semlive.service.log import alarms as alarm_rules
from semlive.service.log.alarms import Alarms
from semlive.service.log.recording import Recorder
from semlive.service.runtime.clock import boot_id


class RunLog:
    """Writes events of the experiment through the recorder.

    Each follower receives every message as it is stored, in the order of the log, so its messages are always a beginning of the log.
    All methods are for one thread, that of the event loop.

    Attributes:
        recorder: writes the messages; its `backlog_message` reports whether it keeps up.
        alarms: alarms of the log so far.
    """

    def __init__(self, recorder: Recorder, alarms: Alarms | None = None) -> None:
        """Begin the log of a new run, or of a resumed run with the alarms of its earlier segments."""
        self.recorder = recorder
        self.alarms = alarms or Alarms()
        self._boot_id = boot_id()
        self._followers: tuple[Callable[[LogMessage], None], ...] = ()

    def subscribe(self, follower: Callable[[LogMessage], None]) -> None:
        """Pass every message from now on to `follower` too."""
        self._followers = (*self._followers, follower)

    def write_message(self, payload: Payload, publish_time_ns: int | None = None) -> None:
        """Write any message."""
        self._write(topic_of(payload), payload, publish_time_ns)

    def output(self, message: LogMessage) -> None:
        """Write a message of the analysis process unchanged."""
        sequence = message.sequence if message.topic in RAW_TOPICS else None
        self._write(message.topic, message.payload, message.publish_time_ns, sequence)

    def sample(self, sample: LoadSample | StageSample) -> None:
        """Write a reading of the load frame or of the stage."""
        message = values.load_sample_message(sample) if isinstance(sample, LoadSample) else values.stage_sample_message(sample)
        self.write_message(message, sample.time_ns)

    def file(self, file: ExportedFile) -> None:
        """Write an exported file: its description, the bytes of its sidecar, if it has one, and its bytes."""
        message = FileMessage(
            export=file.index,
            name=file.name,
            size=len(file.data),
            sha256=file.sha256,
            mtime_ns=file.mtime_ns,
            arrival_time_ns=file.arrival_time_ns,
            decision="arrived",
            reason="",
            sidecar_sha256="" if file.sidecar is None else hashlib.sha256(file.sidecar).hexdigest(),
            settled_time_ns=file.stable_time_ns,
        )
        self.write_message(message)
        if file.sidecar is not None:
            self._write(SEM_SIDECAR, file.sidecar, file.arrival_time_ns, file.index)
        self._write(SEM_ORIGINAL, file.data, file.arrival_time_ns, file.index)

    def refused_file(self, export: int | None, name: str, reason: str, time_ns: int) -> None:
        """Write that a file or frame is part of no pair, and the reason."""
        message = FileMessage(
            export=export, name=name, size=0, sha256="", mtime_ns=0, arrival_time_ns=time_ns, decision="refused", reason=reason
        )
        self.write_message(message)

    def scan(self, info: FrameInfo, load: FrameLoad | None) -> None:
        """Write the metadata of a frame, and the load during its scan."""
        self.write_message(values.scan_message(info, load=load), info.end_time_ns)

    def pair(self, decision: PairDecision) -> None:
        """Write a pair."""
        self.write_message(values.pair_message(decision), decision.second.end_time_ns)

    def transition(self, transition: Transition) -> None:
        """Write a transition of the engine; guards of devices that the run does not have are omitted."""
        guards: dict[str, JsonValue] = {
            name: value for name, value in transition.details if not (isinstance(value, float) and math.isnan(value))
        }
        message = StateMessage(
            time_ns=transition.time_ns,
            before=transition.before,
            after=transition.after,
            cause=transition.cause,
            step=transition.step,
            guards=guards,
            late_s=transition.late_s,
        )
        self.write_message(message, transition.time_ns)

    def command(self, time_ns: int, what: str, args: dict[str, float | str], result: str) -> None:
        """Write a command to a device."""
        self.write_message(CommandMessage(time_ns=time_ns, what=what, args=dict(args), result=result))

    def fault(self, time_ns: int, what: str, where: str, action: str, code: str = "") -> None:
        """Write a fault; `code` is a `FaultCode`."""
        self.write_message(FaultMessage(time_ns=time_ns, what=what, where=where, action=action, code=code))

    def write_text(self, time_ns: int, text: str, level: str = "info") -> None:
        """Write one line of text of the service."""
        self.write_message(LogLineMessage(time_ns=time_ns, level=level, text=text))

    def _write(self, topic: str, payload: Payload | bytes, publish_time_ns: int | None, sequence: int | None = None) -> None:
        if isinstance(payload, BootStamped):
            stamp = {"mono_ns": time.monotonic_ns()} if isinstance(payload, MonotonicStamped) else {}
            payload = payload.model_copy(update={**stamp, "boot_id": self._boot_id})
        message = self.recorder.write(topic, payload, publish_time_ns, sequence)
        if not isinstance(payload, bytes):
            self.alarms = alarm_rules.after(self.alarms, payload)
        elif topic == "/fault":
            self.alarms = alarm_rules.after_message(self.alarms, message)
        for follower in self._followers:
            follower(message)
