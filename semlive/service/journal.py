"""What happens, written down: values of the engine as messages of the log."""

from __future__ import annotations

import math

from semlive.data.frame import ExportedFile, FrameInfo
from semlive.data.loading import FrameLoad, LoadSample, StageSample
from semlive.data.pair import PairDecision
from semlive.engine import Transition
from semlive.formats import message_values as values
from semlive.formats.log import LogMessage
from semlive.formats.messages import (
    SEM_ORIGINAL,
    CommandMessage,
    FaultMessage,
    FileMessage,
    LogLineMessage,
    Payload,
    StateMessage,
    topic_of,
)
from semlive.service.record import Recorder


class Journal:
    """The recorder, in the words of the experiment. Every method returns the message as it stands in the log."""

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder

    def note(self, payload: Payload, publish_time_ns: int | None = None) -> LogMessage:
        """Any message."""
        return self._recorder.write(topic_of(payload), payload, publish_time_ns)

    def output(self, message: LogMessage) -> LogMessage:
        """What analysis said, as it said it."""
        sequence = message.sequence if message.topic == "/dic/map" else None
        return self._recorder.write(message.topic, message.payload, message.publish_time_ns, sequence)

    def sample(self, sample: LoadSample | StageSample) -> LogMessage:
        """A reading of the load frame or of the stage."""
        told = values.load_sample_message(sample) if isinstance(sample, LoadSample) else values.stage_sample_message(sample)
        return self.note(told, sample.time_ns)

    def file(self, file: ExportedFile) -> tuple[LogMessage, LogMessage]:
        """An exported file: what it is, then its bytes."""
        told = FileMessage(
            export=file.export,
            name=file.name,
            size=len(file.data),
            sha256=file.sha256,
            mtime_ns=file.mtime_ns,
            arrival_time_ns=file.arrival_time_ns,
            decision="arrived",
            reason="",
        )
        return self.note(told), self._recorder.write(SEM_ORIGINAL, file.data, file.arrival_time_ns, file.export)

    def refused_file(self, export: int | None, name: str, reason: str, time_ns: int) -> LogMessage:
        """A file or frame that is part of no pair, and why."""
        told = FileMessage(
            export=export, name=name, size=0, sha256="", mtime_ns=0, arrival_time_ns=time_ns, decision="refused", reason=reason
        )
        return self.note(told)

    def scan(self, info: FrameInfo, load: FrameLoad | None) -> LogMessage:
        """What is known of a frame, and the load while it was scanned."""
        return self.note(values.scan_message(info, load=load), info.end_time_ns)

    def pair(self, decision: PairDecision) -> LogMessage:
        """A pair."""
        return self.note(values.pair_message(decision), decision.second.end_time_ns)

    def transition(self, one: Transition) -> LogMessage:
        """A change of the engine's state; a guard of a device that the run does not have is left out."""
        guards = {name: value for name, value in one.guards if not (isinstance(value, float) and math.isnan(value))}
        told = StateMessage(time_ns=one.time_ns, before=one.before, after=one.after, cause=one.cause, step=one.step, guards=guards)
        return self.note(told, one.time_ns)

    def command(self, time_ns: int, what: str, args: dict[str, float | str], result: str) -> LogMessage:
        """Something asked of a device."""
        return self.note(CommandMessage(time_ns=time_ns, what=what, args=dict(args), result=result))

    def fault(self, time_ns: int, what: str, where: str, action: str) -> LogMessage:
        """Something that went wrong."""
        return self.note(FaultMessage(time_ns=time_ns, what=what, where=where, action=action))

    def line(self, time_ns: int, text: str, level: str = "info") -> LogMessage:
        """One line of the service's own log."""
        return self.note(LogLineMessage(time_ns=time_ns, level=level, text=text))
