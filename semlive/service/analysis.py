"""Analysis: a pure function of the log's messages, and the child process that runs it beside the experiment.

The child reads messages from standard input and writes what it makes of them to standard output, both as they stand in
the log. Started again after a crash, it first catches up from the log itself.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

from semlive import dic, pipeline
from semlive.data.frame import ExportedFile, Frame
from semlive.data.pair import Pair, PairDecision
from semlive.data.results import PairResult
from semlive.data.settings import AnalysisSettings
from semlive.engine import FINAL_STATES
from semlive.errors import BadImage, BadLog, SemliveError
from semlive.formats import message_values as values
from semlive.formats import read_frame
from semlive.formats.log import LogMessage
from semlive.formats.maps import encode_displacement, encode_map, encode_strain
from semlive.formats.messages import (
    DIC_MAP,
    DISPLACEMENT_FIELD,
    SEM_ORIGINAL,
    STRAIN_FIELD,
    DicMessage,
    FaultMessage,
    FileMessage,
    LogLineMessage,
    PairMessage,
    Payload,
    ResultMessage,
    RunMessage,
    StateMessage,
    from_json,
    to_json,
    topic_of,
)
from semlive.service.blas import one_blas_thread
from semlive.service.config import parse_config
from semlive.service.log_files import messages
from semlive.service.pipe import read_message, write_message
from semlive.service.result_json import result_json

INPUT_TOPICS = frozenset({"/run", "/sem/file", SEM_ORIGINAL, "/pair", "/state"})
READY = "analysis is ready"

# A pair is named after its frames were read, and while a correlation takes long many more are read than a hold has: 22 scans
# came between at 16 times life on a busy computer. So what limits them is memory, and never fewer are kept than a hold needs.
_KEPT_FRAMES = 8
_KEPT_BYTES = 512 * 2**20


@dataclass(frozen=True, slots=True, eq=False)
class AnalysisState:
    """What the messages so far amount to.

    Attributes:
        settings: from the run's configuration, None before it.
        announced: the file whose bytes come next.
        frames: the newest decoded frames.
        begun: the run's estimate so far.
    """

    settings: AnalysisSettings | None = None
    announced: FileMessage | None = None
    frames: tuple[Frame, ...] = ()
    begun: pipeline.Begun | None = None


def feed(state: AnalysisState, message: LogMessage) -> tuple[AnalysisState, tuple[LogMessage, ...]]:
    """Take one message of the log and give what follows from it, ready to be logged.

    Raises:
        BadLog: the message is not what its topic promises.
    """
    if message.topic == SEM_ORIGINAL:
        return _decode(state, message)
    payload = from_json(message.topic, message.payload)
    if isinstance(payload, RunMessage):
        settings = parse_config(payload.config, "the run's configuration").analysis_settings()
        ready = LogLineMessage(time_ns=message.log_time_ns, level="info", text=READY)
        return replace(state, settings=settings), (_message(ready, message.log_time_ns),)
    if isinstance(payload, FileMessage):
        return (replace(state, announced=payload) if payload.decision == "arrived" else state), ()
    if isinstance(payload, PairMessage):
        return _analyse(state, values.pair_decision(payload), message.log_time_ns)
    if isinstance(payload, StateMessage) and payload.after in FINAL_STATES and state.begun and state.settings:
        result = ResultMessage(result_json(pipeline.conclude(state.begun), state.settings))
        return state, (_message(result, message.log_time_ns),)
    return state, ()


def _decode(state: AnalysisState, message: LogMessage) -> tuple[AnalysisState, tuple[LogMessage, ...]]:
    told, settings = state.announced, state.settings
    if told is None or settings is None or told.export != message.sequence:
        raise BadLog(f"the bytes of export {message.sequence} come without the file's own message; recover the log first")
    file = ExportedFile(message.sequence, told.name, message.payload, told.sha256, told.mtime_ns, told.arrival_time_ns)
    try:
        frame = read_frame(file, settings.scan)
    except BadImage as error:
        refused = told.model_copy(update={"decision": "refused", "reason": str(error)})
        return replace(state, announced=None), (_message(refused, message.publish_time_ns),)
    frames = _newest((*state.frames, frame))
    return replace(state, announced=None, frames=frames), (_message(values.scan_message(frame.info), frame.info.end_time_ns),)


def _newest(frames: tuple[Frame, ...]) -> tuple[Frame, ...]:
    kept = max(_KEPT_FRAMES, _KEPT_BYTES // max(1, frames[-1].image.nbytes))
    return frames[-kept:]


def _analyse(state: AnalysisState, decision: PairDecision, time_ns: int) -> tuple[AnalysisState, tuple[LogMessage, ...]]:
    if state.settings is None:
        raise BadLog(f"pair {decision.pair} comes before the run's configuration; recover the log first")
    by_export = {frame.info.export: frame for frame in state.frames}
    try:
        pair = Pair(decision, by_export[decision.first.export], by_export[decision.second.export])
    except KeyError as error:
        raise BadLog(f"pair {decision.pair} names export {error}, whose bytes are not in the log; recover the log first") from error
    started = time.perf_counter()
    try:
        begun, result = pipeline.analyse(state.settings, state.begun, pair)
    except SemliveError as error:
        fault = FaultMessage(time_ns=time_ns, what=str(error), where=f"analysis of pair {decision.pair}", action="the pair is left out")
        return state, (_message(fault, time_ns),)
    wall_s = time.perf_counter() - started
    frames = tuple(frame for frame in state.frames if frame.info.export > decision.second.export)
    return replace(state, frames=frames, begun=begun), tuple(_pair_messages(result, wall_s))


def _pair_messages(result: PairResult, wall_s: float) -> Iterator[LogMessage]:
    estimate, end_ns = result.estimate, result.decision.second.end_time_ns
    revision = estimate.drift.revision
    for disparity in result.maps:
        yield LogMessage(DIC_MAP, end_ns, end_ns, disparity.current, encode_map(disparity))
        valid = disparity.valid
        means = [float(field[valid].mean()) if valid.any() else None for field in (disparity.u_px, disparity.v_px, disparity.sigma_u_px)]
        summary = DicMessage(
            reference=disparity.reference,
            current=disparity.current,
            points=valid.size,
            converged=int(valid.sum()),
            mean_u_px=means[0],
            mean_v_px=means[1],
            noise_px=means[2],
            wall_s=wall_s,
        )
        yield _message(summary, end_ns)
    yield _message(values.drift_message(estimate.drift), end_ns)
    yield _message(values.distortion_message(estimate.distortion, revision), end_ns)
    for motion in estimate.motions:
        yield _message(values.motion_message(motion, revision), end_ns)
    for frame in (*result.frames, *result.revised):
        number = frame.summary.frame
        yield LogMessage(DISPLACEMENT_FIELD, end_ns, end_ns, number, encode_displacement(frame.displacement))
        yield LogMessage(STRAIN_FIELD, end_ns, end_ns, number, encode_strain(frame.strain))
        yield _message(values.strain_message(frame.summary, revision), end_ns)
    yield _message(values.elastic_message(result.elastic, revision, result.gage), end_ns)


def _message(payload: Payload, time_ns: int) -> LogMessage:
    return LogMessage(topic_of(payload), time_ns, time_ns, 0, to_json(payload))


def main() -> None:
    """The child process; it ends when its standard input does."""
    if hasattr(os, "nice"):
        # Links, watcher and recorder come first: they are late by milliseconds if correlation takes both cores.
        os.nice(10)
    for name in ("SIGTERM", "SIGHUP"):
        # A service manager tells the whole group to end; control ends us when the log is whole.
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    parser = argparse.ArgumentParser()
    parser.add_argument("--log", type=Path, help="catch up from this log first")
    parser.add_argument("--inputs", type=int, default=0, help="how many of its input messages")
    parser.add_argument("--skip", type=int, default=0, help="how many outputs are in the log already")
    arguments = parser.parse_args()
    state, skip = AnalysisState(), arguments.skip
    one_blas_thread()
    for message in _inputs(arguments.log, arguments.inputs):
        state, outputs = feed(state, message)
        _warm(state, message)
        for output in outputs[skip:]:
            write_message(sys.stdout.buffer, output)
        skip = max(0, skip - len(outputs))


def _inputs(log: Path | None, count: int) -> Iterator[LogMessage]:
    if log is not None:
        yield from islice((message for message in messages(log) if message.topic in INPUT_TOPICS), count)
    while (message := read_message(sys.stdin.buffer)) is not None:
        yield message


def _warm(state: AnalysisState, message: LogMessage) -> None:
    """Compile before the first pair; the word READY then goes out after it."""
    if message.topic == "/run" and state.settings is not None:
        dic.warm_up(state.settings.dic)


if __name__ == "__main__":
    main()
