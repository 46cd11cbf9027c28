"""One message of the log after another: the analysis as a pure function of the input messages."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from itertools import chain

from semlive import dic, pipeline
from semlive.data.frame import ExportedFile, Frame
from semlive.data.notes import Note, NoteCode
from semlive.data.pair import Pair, PairDecision
from semlive.data.results import PairResult
from semlive.data.settings import AnalysisSettings
from semlive.engine import FINAL_STATES, State
from semlive.errors import BadImage, BadInput, BadLog, SemliveError
from semlive.formats import read_frame
from semlive.formats.log import conversions as values
from semlive.formats.log.messages import (
    SEM_ORIGINAL,
    SEM_SIDECAR,
    FileMessage,
    HoldDriftMessage,
    PairMessage,
    ResultMessage,
    RunMessage,
    StateMessage,
    from_json,
)
from semlive.formats.log.reader import LogMessage
from semlive.service.analysis.messages import begin_messages, log_message, model_warning, unusable_pair
from semlive.service.analysis.preview_images import preview_images
from semlive.service.analysis.result_json import result_json
from semlive.service.analysis.results import new_warnings, result_messages
from semlive.service.config.configuration import parse_config
from semlive.service.watch.clock_offsets import FileClockOffsets

_MIN_STORED_FRAMES = 8
_MAX_STORED_BYTES = 512 * 2**20
"""Memory for decoded frames, of which `_MIN_STORED_FRAMES` are always stored.

A pair is named after its frames were read. During a long correlation more frames are read than a hold has: 22 scans at 16 times life on a
busy computer.
"""
_MAX_HASHES = 1000
"""Number of frames with which the pixels of a new frame are compared: a run of days must not use more memory after its first hour."""


@dataclass(frozen=True, slots=True, eq=False)
class WorkerState:
    """State of the analysis after the messages so far.

    Attributes:
        settings: from the configuration of the run; None before it.
        pending_file: the announced file whose bytes come next.
        sidecar: bytes of the text file of `pending_file`; None without one.
        pixel_hashes: name of the first frame with these pixels, by their hash.
        clocks: clocks of other computers, estimated from the files.
        frames: the newest decoded frames.
        analysis: the estimate of the run so far; None before the first pair.
        issued_warnings: subjects of the warnings of the estimate so far.
        pair_to_review: the pair that was reported last and has not been reviewed; None otherwise.
        at_rest_since_ns: begin of the time without ordered motion; None while a motion may be ordered.
        imaging_since_ns: scans that begin after this time are for a pair; None while no pair is imaged.
        newest_rest_frame: the newest frame, if it was scanned without motion and has not been evaluated.
        previous_rest_frame: the frame before it in the same hold.
        precorrelated: results of `pipeline.precorrelate` for frames of the next pair, by number of export.
    """

    settings: AnalysisSettings | None = None
    pending_file: FileMessage | None = None
    sidecar: bytes | None = None
    pixel_hashes: Mapping[str, str] = field(default_factory=dict)
    clocks: FileClockOffsets = field(default_factory=lambda: FileClockOffsets.with_poll_interval(1.0))
    frames: tuple[Frame, ...] = ()
    analysis: pipeline.AnalysisState | None = None
    issued_warnings: frozenset[NoteCode] = frozenset()
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
    match from_json(message.topic, message.payload):
        case RunMessage(config=config_values):
            config = parse_config(config_values, "the run's configuration")
            settings, clocks = config.analysis_settings(), FileClockOffsets.with_poll_interval(config.sem.poll_s)
            effects = tuple(effect.name for effect in settings.model.effects)
            return replace(state, settings=settings, clocks=clocks), begin_messages(effects, message.log_time_ns)
        case FileMessage(decision="arrived") as file:
            # A sidecar of an earlier file, whose bytes were lost with the end of a segment, does not belong to this file.
            return replace(state, pending_file=file, sidecar=None), ()
        case PairMessage() as pair:
            return _analyse(state, values.pair_decision(pair), message.log_time_ns)
        case StateMessage() as transition:
            state = _after_transition(state, transition)
            if transition.after not in FINAL_STATES or state.analysis is None or state.settings is None:
                return state, ()
            result = ResultMessage(result_json(pipeline.finalise(state.analysis), state.settings))
            return state, (log_message(result, message.log_time_ns),)
        case _:
            return state, ()


def _after_transition(state: WorkerState, transition: StateMessage) -> WorkerState:
    """Update the state after a transition of the engine, which determines the use of later frames."""
    imaging, holding = transition.after == State.IMAGING, transition.after == State.HOLDING
    # Scans that began between the end of the hold and its detection on a busy computer are valid for the pair.
    imaging_since_ns = transition.time_ns - round(1e9 * transition.late_s) if imaging else None
    return replace(
        state,
        at_rest_since_ns=state.at_rest_since_ns if imaging else transition.time_ns if holding else None,
        imaging_since_ns=imaging_since_ns,
        previous_rest_frame=state.previous_rest_frame if imaging else None,
        newest_rest_frame=None,
        precorrelated={},
    )


def background_work(state: WorkerState) -> tuple[WorkerState, Iterable[LogMessage]]:
    """After the results of `process_message` are written: work that is due after a pair, or that the next message will need."""
    analysis, frame, previous = state.analysis, state.newest_rest_frame, state.previous_rest_frame
    if analysis is not None and state.pair_to_review is not None:
        return _review(replace(state, pair_to_review=None), analysis, state.pair_to_review)
    if frame is None:
        return state, ()
    state = replace(state, newest_rest_frame=None, previous_rest_frame=frame)
    if analysis is not None and state.is_for_pair(frame):
        # An error is reported with the pair, if the frame becomes part of it.
        with suppress(SemliveError):
            precorrelated = pipeline.precorrelate(analysis, frame, first=not state.precorrelated)
            state = replace(state, precorrelated={**state.precorrelated, frame.info.export: precorrelated})
    return state, () if previous is None or state.is_for_pair(previous) else _hold_drift(state, previous, frame)


def _hold_drift(state: WorkerState, previous: Frame, frame: Frame) -> Iterator[LogMessage]:
    """Yield the drift between two frames of one hold, unless they form the pair."""
    assert state.settings is not None  # frames are decoded with them
    with suppress(SemliveError):
        reference = None if state.analysis is None else state.analysis.reference
        mask = pipeline.frame_mask(state.settings.dic, reference, previous)
        drift = dic.hold_drift(previous, frame, state.settings.dic, mask)
        yield log_message(HoldDriftMessage(**asdict(drift)), drift.end_time_ns)


def _review(state: WorkerState, analysis: pipeline.AnalysisState, pair: Pair) -> tuple[WorkerState, Iterable[LogMessage]]:
    """Select hyperparameters and terms again, and test the residuals."""
    end_ns, started_s = pair.decision.second.end_time_ns, time.perf_counter()
    try:
        reviewed, result = pipeline.review_hyperparameters(analysis)
    except SemliveError as error:
        return state, (model_warning(f"the choices stay as they were: {error}", pair.decision.pair, end_ns),)
    wall_s = time.perf_counter() - started_s
    state, outputs = (state, ()) if result is None else _outputs(replace(state, analysis=reviewed), pair, result, wall_s)
    state, warnings = _model_warnings(state, pair, pipeline.residual_notes(reviewed))
    return state, chain(outputs, warnings)


def _decode(state: WorkerState, message: LogMessage) -> tuple[WorkerState, tuple[LogMessage, ...]]:
    """Decode the bytes of the announced file; an unreadable file is rejected."""
    pending, settings = state.pending_file, state.settings
    if pending is None or settings is None or pending.export != message.sequence:
        raise BadLog(f"the bytes of export {message.sequence} come without the file's own message; recover the log first")
    times_ns = (pending.mtime_ns, pending.arrival_time_ns)
    file = ExportedFile(message.sequence, pending.name, message.payload, pending.sha256, *times_ns, state.sidecar, pending.settled_time_ns)
    decoded = replace(state, pending_file=None, sidecar=None)
    try:
        frame = read_frame(file, settings.scan)
        _require_mask_size(frame, settings)
        pixel_hashes = _with_hash(state.pixel_hashes, frame)
    except BadImage as error:
        refused = pending.model_copy(update={"decision": "refused", "reason": str(error)})
        return decoded, (log_message(refused, message.publish_time_ns),)
    clocks, offsets = state.clocks.updated(file, frame.info, settings.scan)
    frames = _newest((*state.frames, frame))
    scan = log_message(values.scan_message(frame.info), frame.info.end_time_ns)
    outputs = (*(log_message(offset, message.publish_time_ns) for offset in offsets), scan)
    at_rest = state.at_rest_since_ns is not None and frame.info.start_time_ns.value >= state.at_rest_since_ns
    newest_rest_frame = frame if at_rest else None
    return replace(decoded, frames=frames, pixel_hashes=pixel_hashes, clocks=clocks, newest_rest_frame=newest_rest_frame), outputs


def _require_mask_size(frame: Frame, settings: AnalysisSettings) -> None:
    """Reject a frame of another size than the mask, so that no pair is formed and nothing moves for it.

    Raises:
        BadImage: the sizes differ.
    """
    height, width = frame.image.shape
    try:
        dic.mask_of(settings.dic, (height, width))
    except BadInput as error:
        raise BadImage(f"{frame.info.name}: {error}") from error


def _with_hash(pixel_hashes: Mapping[str, str], frame: Frame) -> Mapping[str, str]:
    """Add the hash of the pixels of a frame. The pixels of two scans always differ by noise, whatever their headers contain.

    Raises:
        BadImage: an earlier frame has the same pixels.
    """
    pixels = hashlib.blake2b(frame.image.tobytes(), digest_size=16).hexdigest()
    if pixels in pixel_hashes:
        raise BadImage(f"{frame.info.name}: shows the same pixels as {pixel_hashes[pixels]}; the SEM's image is frozen, so let it scan.")
    retained = dict(list(pixel_hashes.items())[-(_MAX_HASHES - 1) :])
    return {**retained, pixels: frame.info.name}


def _newest(frames: tuple[Frame, ...]) -> tuple[Frame, ...]:
    max_frames = max(_MIN_STORED_FRAMES, _MAX_STORED_BYTES // max(1, frames[-1].image.nbytes))
    return frames[-max_frames:]


def _analyse(state: WorkerState, decision: PairDecision, time_ns: int) -> tuple[WorkerState, Iterable[LogMessage]]:
    """Analyse a pair; a pair that cannot be analysed gives a fault."""
    if state.settings is None:
        raise BadLog(f"pair {decision.pair} comes before the run's configuration; recover the log first")
    by_export = {frame.info.export: frame for frame in state.frames}
    try:
        pair = Pair(decision, by_export[decision.first.export], by_export[decision.second.export])
    except KeyError as error:
        raise BadLog(f"pair {decision.pair} names export {error}, whose bytes are not in the log; recover the log first") from error
    started_s = time.perf_counter()
    try:
        analysis, result = pipeline.analyse(state.settings, state.analysis, pair, state.precorrelated)
    except SemliveError as error:
        return state, chain((unusable_pair(str(error), decision.pair, time_ns),), preview_images(pair, None))
    wall_s = time.perf_counter() - started_s
    frames = tuple(frame for frame in state.frames if frame.info.export > decision.second.export)
    return _outputs(replace(state, frames=frames, analysis=analysis, pair_to_review=pair), pair, result, wall_s)


def _outputs(state: WorkerState, pair: Pair, result: PairResult, wall_s: float) -> tuple[WorkerState, Iterable[LogMessage]]:
    """Return the outputs of a result, the new warnings of the estimate, and the preview images last, for which no result waits."""
    state, warnings = _model_warnings(state, pair, result.estimate.notes)
    return state, chain(result_messages(result, wall_s), warnings, preview_images(pair, result))


def _model_warnings(state: WorkerState, pair: Pair, notes: Sequence[Note]) -> tuple[WorkerState, tuple[LogMessage, ...]]:
    """Return the warnings in the notes that have not been issued."""
    texts, issued = new_warnings(notes, state.issued_warnings)
    number, end_ns = pair.decision.pair, pair.decision.second.end_time_ns
    return replace(state, issued_warnings=issued), tuple(model_warning(text, number, end_ns) for text in texts)
