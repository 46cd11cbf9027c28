"""Analysis: a pure function of the messages of the log, and the child process that runs it during the experiment.

The child reads the growing log, up to the number of inputs that it receives on standard input, and writes its outputs to standard output in
the form of log messages. After a crash, a new child reads the log from the beginning.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from itertools import chain
from pathlib import Path

from semlive import dic, pipeline
from semlive.data.frame import ExportedFile, Frame
from semlive.data.pair import Pair, PairDecision
from semlive.data.results import PairResult
from semlive.data.settings import AnalysisSettings
from semlive.engine import FINAL_STATES, State
from semlive.errors import BadImage, BadLog, SemliveError
from semlive.formats import read_frame
from semlive.formats.log import conversions as values
from semlive.formats.log.foxglove import IMAGE_TOPICS
from semlive.formats.log.maps import encode_displacement, encode_map, encode_strain
from semlive.formats.log.messages import (
    DIC_MAP,
    DISPLACEMENT_FIELD,
    SEM_ORIGINAL,
    SEM_SIDECAR,
    STRAIN_FIELD,
    ClockOffsetMessage,
    DicMessage,
    FaultMessage,
    FileMessage,
    HoldDriftMessage,
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
from semlive.formats.log.reader import LogMessage
from semlive.service.analysis.output import OutputStream, lower_priority
from semlive.service.analysis.pipe import read_counts
from semlive.service.analysis.preview_images import preview_images
from semlive.service.analysis.result_json import result_json
from semlive.service.analysis.warnings import new_warnings
from semlive.service.config.configuration import parse_config
from semlive.service.log.tail import LogReplaced, LogTail
from semlive.service.runtime.blas import limit_blas_threads
from semlive.service.runtime.memory import trim_heap
from semlive.service.runtime.pause import pause
from semlive.service.storage.map_store import offload_pair
from semlive.service.storage.pair_archive import PairArchive
from semlive.service.watch.clock_offsets import FileClockOffsets

LOG_REPLACED = 4
"""Exit status of the process when another run's log lies where its own was."""
INPUT_TOPICS = frozenset({"/run", "/sem/file", SEM_SIDECAR, SEM_ORIGINAL, "/pair", "/state"})
READY_TEXT = "analysis is ready"
_MODEL = "a model is fitted to the maps and taken out of them: "
_FAULT_OF_PAIR = "analysis of pair "
_DOUBT = "estimate with pair "
_ONLY_OURS = frozenset(
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

# A pair is named after its frames were read, and while a correlation takes long many more are read than a hold has: 22 scans
# came between at 16 times life on a busy computer. So what limits them is memory, and never fewer are kept than a hold needs.
_KEPT_FRAMES = 8
_KEPT_BYTES = 512 * 2**20
_KEPT_HASHES = 1000
# Beside an instrument a run lasts days, and its memory shall stay where it is after the first hour.
_TOLD_BEYOND = 0.01
_ASK = "the run goes on; `semlive diagnose LOG` says what is missing from the model"
# From the word that something was recorded to its bytes in the log the recorder takes some milliseconds.
_POLL_S = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class WorkerState:
    """State of the analysis after the messages so far.

    Attributes:
        settings: from the run's configuration, None before it.
        pending_file: the file whose bytes come next.
        frames: the newest decoded frames.
        analysis: the run's estimate so far.
        sidecar: bytes of the text file beside the file whose bytes come next.
        pixel_hashes: name of the frame that first showed these pixels, by their hash.
        clocks: clocks of other computers as files tell them.
        issued_warnings: what the estimate has warned of, without its figures.
        pair_to_review: the pair that was reported last and has not been reviewed; None otherwise.
        at_rest_since_ns: since when nothing is moved; None while something may be.
        imaging_since_ns: scans that begin after this are meant for a pair; None while the engine asks for none.
        newest_rest_frame: the newest frame, if it was scanned at rest and not looked at.
        previous_rest_frame: the one before it in the same rest.
        precorrelated: what was made of frames that are meant for a pair, by number of export.
    """

    settings: AnalysisSettings | None = None
    pending_file: FileMessage | None = None
    sidecar: bytes | None = None
    pixel_hashes: Mapping[str, str] = field(default_factory=dict)
    clocks: FileClockOffsets = field(default_factory=lambda: FileClockOffsets.with_poll_interval(1.0))
    frames: tuple[Frame, ...] = ()
    analysis: pipeline.AnalysisState | None = None
    issued_warnings: frozenset[str] = frozenset()
    pair_to_review: Pair | None = None
    at_rest_since_ns: int | None = None
    imaging_since_ns: int | None = None
    newest_rest_frame: Frame | None = None
    previous_rest_frame: Frame | None = None
    precorrelated: Mapping[int, pipeline.PrecorrelatedFrame] = field(default_factory=dict)

    def is_for_pair(self, frame: Frame) -> bool:
        """Whether a frame belongs to the pair that is being imaged."""
        return self.imaging_since_ns is not None and frame.info.start_time_ns.value >= self.imaging_since_ns


def process_message(state: WorkerState, message: LogMessage) -> tuple[WorkerState, Iterable[LogMessage]]:
    """Process one message of the log and return the new state and the outputs for the log.

    The outputs of a pair, its preview images last, are serialised once, on demand.

    Raises:
        BadLog: the message does not agree with its topic.
    """
    if message.topic == SEM_SIDECAR:
        return replace(state, sidecar=message.payload), ()
    if message.topic == SEM_ORIGINAL:
        return _decode(state, message)
    payload = from_json(message.topic, message.payload)
    if isinstance(payload, RunMessage):
        config = parse_config(payload.config, "the run's configuration")
        settings, clocks = config.analysis_settings(), FileClockOffsets.with_poll_interval(config.sem.poll_s)
        ready = LogLineMessage(time_ns=message.log_time_ns, level="info", text=READY_TEXT)
        effects = ", ".join(effect.name for effect in settings.model.effects)
        notice = LogLineMessage(time_ns=message.log_time_ns, level="info", text=_MODEL + effects)
        said = (notice, ready) if effects else (ready,)
        return replace(state, settings=settings, clocks=clocks), tuple(_message(output, message.log_time_ns) for output in said)
    if isinstance(payload, FileMessage):
        # Bytes beside an announced file whose own bytes were lost with the end of a segment belong to no other.
        return (replace(state, pending_file=payload, sidecar=None) if payload.decision == "arrived" else state), ()
    if isinstance(payload, PairMessage):
        return _analyse(state, values.pair_decision(payload), message.log_time_ns)
    if isinstance(payload, StateMessage):
        state = _after_transition(state, payload)
    if isinstance(payload, StateMessage) and payload.after in FINAL_STATES and state.analysis and state.settings:
        result = ResultMessage(result_json(pipeline.finalise(state.analysis), state.settings))
        return state, (_message(result, message.log_time_ns),)
    return state, ()


def _after_transition(state: WorkerState, transition: StateMessage) -> WorkerState:
    """Update the state after a transition of the engine, which determines the use of later frames."""
    imaging, holding = transition.after == State.IMAGING, transition.after == State.HOLDING
    since_ns = state.at_rest_since_ns if imaging else transition.time_ns if holding else None
    rested = state.previous_rest_frame if imaging else None
    # A frame that began before a busy computer noticed that the hold was over counts for the pair too.
    late_s = transition.guards.get("late_s", 0.0)
    imaging_since_ns = transition.time_ns - round(1e9 * late_s if isinstance(late_s, int | float) else 0.0) if imaging else None
    return replace(
        state,
        at_rest_since_ns=since_ns,
        imaging_since_ns=imaging_since_ns,
        previous_rest_frame=rested,
        newest_rest_frame=None,
        precorrelated={},
    )


def background_work(state: WorkerState) -> tuple[WorkerState, Iterable[LogMessage]]:
    """After the results of `process_message` are written: work that is due after a pair, or that the next message will need."""
    analysis, frame, before = state.analysis, state.newest_rest_frame, state.previous_rest_frame
    if analysis is not None and state.pair_to_review is not None:
        return _reconsider(replace(state, pair_to_review=None), analysis, state.pair_to_review)
    if frame is None:
        return state, ()
    state = replace(state, newest_rest_frame=None, previous_rest_frame=frame)
    if analysis is not None and state.is_for_pair(frame):
        # If it fails the pair says so, should the frame come into one.
        with suppress(SemliveError):
            precorrelated = pipeline.precorrelate(analysis, frame, first=not state.precorrelated)
            state = replace(state, precorrelated={**state.precorrelated, frame.info.export: precorrelated})
    return state, () if before is None or state.is_for_pair(before) else _drifted(state, before, frame)


def _drifted(state: WorkerState, before: Frame, after: Frame) -> Iterator[LogMessage]:
    """Yield the drift between two frames of one hold, unless they form the pair."""
    assert state.settings is not None  # frames are read by them
    with suppress(SemliveError):
        drift = dic.hold_drift(before, after, state.settings.dic)
        yield _message(HoldDriftMessage(**asdict(drift)), drift.end_time_ns)


def _reconsider(state: WorkerState, before: pipeline.AnalysisState, pair: Pair) -> tuple[WorkerState, Iterable[LogMessage]]:
    end_ns, started = pair.decision.second.end_time_ns, time.perf_counter()
    try:
        begun, result = pipeline.review_hyperparameters(before)
    except SemliveError as error:
        return state, (_doubt(f"the choices stay as they were: {error}", pair.decision.pair, end_ns),)
    wall_s = time.perf_counter() - started
    state, said = (state, ()) if result is None else _said(replace(state, analysis=begun), pair, result, wall_s)
    state, doubts = _newly_doubted(state, pair, pipeline.residual_warning(begun))
    return state, chain(said, doubts)


def is_output(message: LogMessage) -> bool:
    """Whether a message of the log is an output of the analysis, which need not be written again."""
    if message.topic in _ONLY_OURS:
        return True
    if message.topic not in ("/log", "/clock/offset", "/sem/file", "/fault"):
        return False
    payload = from_json(message.topic, message.payload)
    if isinstance(payload, ClockOffsetMessage):
        return payload.export is not None  # else the share was asked, when the run began
    if isinstance(payload, LogLineMessage):
        return payload.text == READY_TEXT or payload.text.startswith(_MODEL)
    if isinstance(payload, FileMessage):
        # Control refuses frames by their number alone; only who has read the bytes repeats what the file is.
        return payload.decision == "refused" and bool(payload.sha256)
    return isinstance(payload, FaultMessage) and payload.where.startswith((_FAULT_OF_PAIR, _DOUBT))


def is_model_warning(fault: FaultMessage) -> bool:
    """Whether a fault is a warning about the model; the pair was used."""
    return fault.where.startswith(_DOUBT)


def fault_origin(pair: int) -> str:
    """Return the `where` of the fault of a pair that could not be analysed."""
    return f"{_FAULT_OF_PAIR}{pair}"


def _decode(state: WorkerState, message: LogMessage) -> tuple[WorkerState, tuple[LogMessage, ...]]:
    told, settings = state.pending_file, state.settings
    if told is None or settings is None or told.export != message.sequence:
        raise BadLog(f"the bytes of export {message.sequence} come without the file's own message; recover the log first")
    file = ExportedFile(
        message.sequence, told.name, message.payload, told.sha256, told.mtime_ns, told.arrival_time_ns, state.sidecar, told.settled_time_ns
    )
    done = replace(state, pending_file=None, sidecar=None)
    try:
        frame = read_frame(file, settings.scan)
        shown = _shown(state.pixel_hashes, frame)
    except BadImage as error:
        refused = told.model_copy(update={"decision": "refused", "reason": str(error)})
        return done, (_message(refused, message.publish_time_ns),)
    clocks, told_clocks = state.clocks.updated(file, frame.info, settings.scan)
    frames = _newest((*state.frames, frame))
    scan = _message(values.scan_message(frame.info), frame.info.end_time_ns)
    outputs = (*(_message(output, message.publish_time_ns) for output in told_clocks), scan)
    resting = state.at_rest_since_ns is not None and frame.info.start_time_ns.value >= state.at_rest_since_ns
    return replace(done, frames=frames, pixel_hashes=shown, clocks=clocks, newest_rest_frame=frame if resting else None), outputs


def _shown(before: Mapping[str, str], frame: Frame) -> Mapping[str, str]:
    """With the frame's pixels; noise alone makes those of two scans differ, whatever their headers say.

    Raises:
        BadImage: an earlier frame shows the same.
    """
    pixels = hashlib.blake2b(frame.image.tobytes(), digest_size=16).hexdigest()
    if pixels in before:
        raise BadImage(f"{frame.info.name}: shows the same pixels as {before[pixels]}; the SEM's image is frozen, so let it scan.")
    retained = dict(list(before.items())[-(_KEPT_HASHES - 1) :])
    return {**retained, pixels: frame.info.name}


def _newest(frames: tuple[Frame, ...]) -> tuple[Frame, ...]:
    max_frames = max(_KEPT_FRAMES, _KEPT_BYTES // max(1, frames[-1].image.nbytes))
    return frames[-max_frames:]


def _analyse(state: WorkerState, decision: PairDecision, time_ns: int) -> tuple[WorkerState, Iterable[LogMessage]]:
    if state.settings is None:
        raise BadLog(f"pair {decision.pair} comes before the run's configuration; recover the log first")
    by_export = {frame.info.export: frame for frame in state.frames}
    try:
        pair = Pair(decision, by_export[decision.first.export], by_export[decision.second.export])
    except KeyError as error:
        raise BadLog(f"pair {decision.pair} names export {error}, whose bytes are not in the log; recover the log first") from error
    started = time.perf_counter()
    try:
        begun, result = pipeline.analyse(state.settings, state.analysis, pair, state.precorrelated)
    except SemliveError as error:
        fault = FaultMessage(time_ns=time_ns, what=str(error), where=fault_origin(decision.pair), action="the pair is left out")
        return state, _with_pictures(pair, lambda: (_message(fault, time_ns),))
    wall_s = time.perf_counter() - started
    frames = tuple(frame for frame in state.frames if frame.info.export > decision.second.export)
    return _said(replace(state, frames=frames, analysis=begun, pair_to_review=pair), pair, result, wall_s)


def _said(state: WorkerState, pair: Pair, result: PairResult, wall_s: float) -> tuple[WorkerState, Iterable[LogMessage]]:
    """Return the outputs of a result and the new warnings of the estimate."""
    state, doubts = _newly_doubted(state, pair, result.estimate.notes)
    return state, _with_pictures(pair, lambda: (*result_messages(result, wall_s), *doubts))


def _newly_doubted(state: WorkerState, pair: Pair, notes: Sequence[str]) -> tuple[WorkerState, tuple[LogMessage, ...]]:
    news, warned = new_warnings(notes, state.issued_warnings)
    return replace(state, issued_warnings=warned), tuple(_doubt(one, pair.decision.pair, pair.decision.second.end_time_ns) for one in news)


def _doubt(what: str, pair: int, time_ns: int) -> LogMessage:
    return _message(FaultMessage(time_ns=time_ns, what=what, where=f"{_DOUBT}{pair}", action=_ASK), time_ns)


def _with_pictures(pair: Pair, words: Callable[[], tuple[LogMessage, ...]]) -> Iterator[LogMessage]:
    """Yield the outputs of a pair, then its preview images, so that no result waits for an image."""
    outputs = words()
    yield from outputs
    yield from preview_images(pair, outputs)


def result_messages(result: PairResult, wall_s: float) -> Iterator[LogMessage]:
    """Yield all outputs of an analysed pair in the order of the log."""
    estimate, end_ns = result.estimate, result.decision.second.end_time_ns
    revision, pairs = estimate.drift.revision, result.pairs
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
    yield _message(values.drift_message(estimate.drift, estimate.calibration, pairs), end_ns)
    yield _message(values.distortion_message(estimate.distortion, revision), end_ns)
    for motion in estimate.motions:
        yield _message(values.motion_message(motion, revision), end_ns)
    for frame in (*result.frames, *result.revised_frames):
        number = frame.summary.frame
        yield LogMessage(DISPLACEMENT_FIELD, end_ns, end_ns, number, encode_displacement(frame.displacement))
        yield LogMessage(STRAIN_FIELD, end_ns, end_ns, number, encode_strain(frame.strain))
        yield _message(values.strain_message(frame.summary, revision), end_ns)
    yield _message(values.elastic_message(result.elastic, revision, result.gage, pairs), end_ns)
    yield from _left_area(result, end_ns)


def _left_area(result: PairResult, end_ns: int) -> Iterator[LogMessage]:
    """A word for the operator while the specimen can still be brought back: points that a frame shows beyond what was calibrated."""
    measured = {disparity_map.current: disparity_map.valid for disparity_map in result.maps if disparity_map.reference == 0}
    for frame in result.frames:
        seen, number = measured.get(frame.summary.frame), frame.summary.frame
        if seen is None or not seen.any():
            continue
        beyond = 1.0 - float(frame.displacement.valid[seen].mean())
        if beyond > _TOLD_BEYOND:
            what = (
                f"{100 * beyond:.0f} % of the points of frame {number} lie beyond the area that the calibration covered and have no "
                "displacement; bring the specimen back, or calibrate with larger translations"
            )
            action = "the other points are corrected as ever"
            yield _message(FaultMessage(time_ns=end_ns, what=what, where=fault_origin(result.decision.pair), action=action), end_ns)
            return


def _message(payload: Payload, time_ns: int) -> LogMessage:
    return LogMessage(topic_of(payload), time_ns, time_ns, 0, to_json(payload))


def main() -> None:
    """Main function of the child process; it ends with its standard input."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--log", type=Path, required=True, help="the growing log")
    parser.add_argument("--inputs", type=int, default=0, help="how many input messages stand in it already")
    parser.add_argument("--skip", type=int, default=0, help="how many outputs stand in it already")
    parser.add_argument("--began-ns", type=int, default=None, help="log time of the log's first message, if there is one already")
    parser.add_argument("--beat", action="store_true", help="also say every second that this process lives")
    arguments = parser.parse_args()
    lower_priority()
    limit_blas_threads()
    counts = chain((arguments.inputs,), read_counts(sys.stdin.buffer))
    try:
        _follow(_inputs(arguments.log, counts, arguments.began_ns), arguments.skip, arguments.beat)
    except LogReplaced as error:
        sys.stderr.write(f"{error}\n")
        sys.exit(LOG_REPLACED)


def _follow(inputs: Iterable[LogMessage], skip: int, beat: bool) -> None:
    """Write the outputs to standard output, without those that are already in the log."""
    state, archive = WorkerState(), PairArchive()
    with OutputStream(sys.stdout.buffer, beat) as voice:
        for message in inputs:
            with voice.busy():
                before = state.analysis
                state, outputs = process_message(state, message)
                _warm(state, message)
                skip = _say(voice, outputs, skip)
                state, outputs = background_work(state)
                skip = _say(voice, outputs, skip)
                state = _lighter(state, before, archive)


def _say(voice: OutputStream, outputs: Iterable[LogMessage], skip: int) -> int:
    """Say all but the first so many, which stand in the log; how many of those are still to come."""
    for output in outputs:
        if skip > 0:
            skip -= 1
        else:
            voice.write(output)
    return skip


def _inputs(log: Path, counts: Iterable[int], began_ns: int | None = None) -> Iterator[LogMessage]:
    """Input messages of a growing log; each count says how many there are by now, and they are waited for.

    Raises:
        LogReplaced: the log does not begin at `began_ns`, or not any more where it began.
    """
    tail, taken = LogTail(log), 0
    for count in counts:
        while taken < count:
            for message in tail.poll():
                if began_ns not in (None, message.log_time_ns):
                    raise LogReplaced(f"{log}: is not the log of this run any more; look at what became of the folder.")
                began_ns = None
                if message.topic in INPUT_TOPICS:
                    taken += 1
                    yield message
            if taken < count:
                pause(_POLL_S)


def _lighter(state: WorkerState, before: pipeline.AnalysisState | None, archive: PairArchive) -> WorkerState:
    """Move the stored data of a new pair into unnamed files, bit by bit equal."""
    if state.analysis is None or state.analysis is before:
        return state
    analysis = offload_pair(state.analysis, state.analysis.pairs[-1].pair, (), archive)
    archive.flush()
    trim_heap()
    return replace(state, analysis=analysis)


def _warm(state: WorkerState, message: LogMessage) -> None:
    """Compile before the first pair; the word READY then goes out after it."""
    if message.topic == "/run" and state.settings is not None:
        dic.warm_up(state.settings.dic)


if __name__ == "__main__":
    main()
