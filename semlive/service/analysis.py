"""Analysis: a pure function of the log's messages, and the child process that runs it beside the experiment.

The child reads the growing log, as far as standard input says that there is something for it, and writes what it makes of it to standard
output as it shall stand in the log. Started again after a crash, it reads the log from the beginning.
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
from semlive.formats import message_values as values
from semlive.formats import read_frame
from semlive.formats.foxglove import PICTURE_TOPICS
from semlive.formats.log import LogMessage
from semlive.formats.maps import encode_displacement, encode_map, encode_strain
from semlive.formats.messages import (
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
from semlive.service.analysis_voice import Voice, stand_back
from semlive.service.archive import Archive
from semlive.service.blas import one_blas_thread
from semlive.service.config import parse_config
from semlive.service.display import pictures
from semlive.service.file_clocks import FileClocks
from semlive.service.map_store import beside_memory
from semlive.service.memory import give_back
from semlive.service.pause import pause
from semlive.service.pipe import read_counts
from semlive.service.result_json import result_json
from semlive.service.tail import LogReplaced, Tail
from semlive.service.warned import newly_warned

LOG_REPLACED = 4
"""Exit status of the process when another run's log lies where its own was."""
INPUT_TOPICS = frozenset({"/run", "/sem/file", SEM_SIDECAR, SEM_ORIGINAL, "/pair", "/state"})
READY = "analysis is ready"
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
) | {DIC_MAP, DISPLACEMENT_FIELD, STRAIN_FIELD, *PICTURE_TOPICS}

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
class AnalysisState:
    """What the messages so far amount to.

    Attributes:
        settings: from the run's configuration, None before it.
        announced: the file whose bytes come next.
        frames: the newest decoded frames.
        begun: the run's estimate so far.
        sidecar: bytes of the text file beside the file whose bytes come next.
        shown: name of the frame that first showed these pixels, by their hash.
        clocks: clocks of other computers as files tell them.
        warned: what the estimate has warned of, without its figures.
        told: the pair that was told last and has not been reconsidered; None otherwise.
        rest_since_ns: since when nothing is moved; None while something may be.
        imaging_since_ns: scans that begin after this are meant for a pair; None while the engine asks for none.
        fresh: the newest frame, if it was scanned at rest and not looked at.
        rested: the one before it in the same rest.
        foreseen: what was made of frames that are meant for a pair, by number of export.
    """

    settings: AnalysisSettings | None = None
    announced: FileMessage | None = None
    sidecar: bytes | None = None
    shown: Mapping[str, str] = field(default_factory=dict)
    clocks: FileClocks = field(default_factory=lambda: FileClocks.looked_at_every(1.0))
    frames: tuple[Frame, ...] = ()
    begun: pipeline.Begun | None = None
    warned: frozenset[str] = frozenset()
    told: Pair | None = None
    rest_since_ns: int | None = None
    imaging_since_ns: int | None = None
    fresh: Frame | None = None
    rested: Frame | None = None
    foreseen: Mapping[int, pipeline.Foreseen] = field(default_factory=dict)

    def means(self, frame: Frame) -> bool:
        """Whether a frame is meant for the pair that is being taken."""
        return self.imaging_since_ns is not None and frame.info.start_time_ns.value >= self.imaging_since_ns


def feed(state: AnalysisState, message: LogMessage) -> tuple[AnalysisState, Iterable[LogMessage]]:
    """Take one message of the log and give what follows from it, ready to be logged.

    What is told of a pair, its pictures last, is put into words only when it is asked for, once.

    Raises:
        BadLog: the message is not what its topic promises.
    """
    if message.topic == SEM_SIDECAR:
        return replace(state, sidecar=message.payload), ()
    if message.topic == SEM_ORIGINAL:
        return _decode(state, message)
    payload = from_json(message.topic, message.payload)
    if isinstance(payload, RunMessage):
        config = parse_config(payload.config, "the run's configuration")
        settings, clocks = config.analysis_settings(), FileClocks.looked_at_every(config.sem.poll_s)
        ready = LogLineMessage(time_ns=message.log_time_ns, level="info", text=READY)
        effects = ", ".join(one.name for one in settings.model.effects)
        told = LogLineMessage(time_ns=message.log_time_ns, level="info", text=_MODEL + effects)
        said = (told, ready) if effects else (ready,)
        return replace(state, settings=settings, clocks=clocks), tuple(_message(one, message.log_time_ns) for one in said)
    if isinstance(payload, FileMessage):
        # Bytes beside an announced file whose own bytes were lost with the end of a segment belong to no other.
        return (replace(state, announced=payload, sidecar=None) if payload.decision == "arrived" else state), ()
    if isinstance(payload, PairMessage):
        return _analyse(state, values.pair_decision(payload), message.log_time_ns)
    if isinstance(payload, StateMessage):
        state = _moved_on(state, payload)
    if isinstance(payload, StateMessage) and payload.after in FINAL_STATES and state.begun and state.settings:
        result = ResultMessage(result_json(pipeline.conclude(state.begun), state.settings))
        return state, (_message(result, message.log_time_ns),)
    return state, ()


def _moved_on(state: AnalysisState, told: StateMessage) -> AnalysisState:
    """What a transition of the engine says of the frames that come."""
    imaging, holding = told.after == State.IMAGING, told.after == State.HOLDING
    since_ns = state.rest_since_ns if imaging else told.time_ns if holding else None
    rested = state.rested if imaging else None
    # A frame that began before a busy computer noticed that the hold was over counts for the pair too.
    late_s = told.guards.get("late_s", 0.0)
    imaging_since_ns = told.time_ns - round(1e9 * late_s if isinstance(late_s, int | float) else 0.0) if imaging else None
    return replace(state, rest_since_ns=since_ns, imaging_since_ns=imaging_since_ns, rested=rested, fresh=None, foreseen={})


def meanwhile(state: AnalysisState) -> tuple[AnalysisState, Iterable[LogMessage]]:
    """After `feed`, when what it gave has been said and nobody waits: what is due once a pair was told, or what the next will ask."""
    begun, frame, before = state.begun, state.fresh, state.rested
    if begun is not None and state.told is not None:
        return _reconsider(replace(state, told=None), begun, state.told)
    if frame is None:
        return state, ()
    state = replace(state, fresh=None, rested=frame)
    if begun is not None and state.means(frame):
        # If it fails the pair says so, should the frame come into one.
        with suppress(SemliveError):
            known = pipeline.foresee(begun, frame, first=not state.foreseen)
            state = replace(state, foreseen={**state.foreseen, frame.info.export: known})
    return state, () if before is None or state.means(before) else _drifted(state, before, frame)


def _drifted(state: AnalysisState, before: Frame, after: Frame) -> Iterator[LogMessage]:
    """The drift between two frames of one rest, unless they are to be the pair, which will tell it."""
    assert state.settings is not None  # frames are read by them
    with suppress(SemliveError):
        seen = dic.hold_drift(before, after, state.settings.dic)
        yield _message(HoldDriftMessage(**asdict(seen)), seen.end_time_ns)


def _reconsider(state: AnalysisState, before: pipeline.Begun, pair: Pair) -> tuple[AnalysisState, Iterable[LogMessage]]:
    end_ns, started = pair.decision.second.end_time_ns, time.perf_counter()
    try:
        begun, result = pipeline.reconsider(before)
    except SemliveError as error:
        return state, (_doubt(f"the choices stay as they were: {error}", pair.decision.pair, end_ns),)
    wall_s = time.perf_counter() - started
    state, said = (state, ()) if result is None else _said(replace(state, begun=begun), pair, result, wall_s)
    state, doubts = _newly_doubted(state, pair, pipeline.still_white(begun))
    return state, chain(said, doubts)


def is_output(message: LogMessage) -> bool:
    """Whether a message of the log is one that analysis gave: what stands in the log need not be said again."""
    if message.topic in _ONLY_OURS:
        return True
    if message.topic not in ("/log", "/clock/offset", "/sem/file", "/fault"):
        return False
    payload = from_json(message.topic, message.payload)
    if isinstance(payload, ClockOffsetMessage):
        return payload.export is not None  # else the share was asked, when the run began
    if isinstance(payload, LogLineMessage):
        return payload.text == READY or payload.text.startswith(_MODEL)
    if isinstance(payload, FileMessage):
        # Control refuses frames by their number alone; only who has read the bytes repeats what the file is.
        return payload.decision == "refused" and bool(payload.sha256)
    return isinstance(payload, FaultMessage) and payload.where.startswith((_FAULT_OF_PAIR, _DOUBT))


def is_doubt(fault: FaultMessage) -> bool:
    """It doubts the model, and the pair was used."""
    return fault.where.startswith(_DOUBT)


def fault_place(pair: int) -> str:
    """Where the fault of a pair that could not be analysed says that it arose."""
    return f"{_FAULT_OF_PAIR}{pair}"


def _decode(state: AnalysisState, message: LogMessage) -> tuple[AnalysisState, tuple[LogMessage, ...]]:
    told, settings = state.announced, state.settings
    if told is None or settings is None or told.export != message.sequence:
        raise BadLog(f"the bytes of export {message.sequence} come without the file's own message; recover the log first")
    file = ExportedFile(
        message.sequence, told.name, message.payload, told.sha256, told.mtime_ns, told.arrival_time_ns, state.sidecar, told.settled_time_ns
    )
    done = replace(state, announced=None, sidecar=None)
    try:
        frame = read_frame(file, settings.scan)
        shown = _shown(state.shown, frame)
    except BadImage as error:
        refused = told.model_copy(update={"decision": "refused", "reason": str(error)})
        return done, (_message(refused, message.publish_time_ns),)
    clocks, told_clocks = state.clocks.after(file, frame.info, settings.scan)
    frames = _newest((*state.frames, frame))
    scan = _message(values.scan_message(frame.info), frame.info.end_time_ns)
    outputs = (*(_message(one, message.publish_time_ns) for one in told_clocks), scan)
    resting = state.rest_since_ns is not None and frame.info.start_time_ns.value >= state.rest_since_ns
    return replace(done, frames=frames, shown=shown, clocks=clocks, fresh=frame if resting else None), outputs


def _shown(before: Mapping[str, str], frame: Frame) -> Mapping[str, str]:
    """With the frame's pixels; noise alone makes those of two scans differ, whatever their headers say.

    Raises:
        BadImage: an earlier frame shows the same.
    """
    pixels = hashlib.blake2b(frame.image.tobytes(), digest_size=16).hexdigest()
    if pixels in before:
        raise BadImage(f"{frame.info.name}: shows the same pixels as {before[pixels]}; the SEM's image is frozen, so let it scan.")
    kept = dict(list(before.items())[-(_KEPT_HASHES - 1) :])
    return {**kept, pixels: frame.info.name}


def _newest(frames: tuple[Frame, ...]) -> tuple[Frame, ...]:
    kept = max(_KEPT_FRAMES, _KEPT_BYTES // max(1, frames[-1].image.nbytes))
    return frames[-kept:]


def _analyse(state: AnalysisState, decision: PairDecision, time_ns: int) -> tuple[AnalysisState, Iterable[LogMessage]]:
    if state.settings is None:
        raise BadLog(f"pair {decision.pair} comes before the run's configuration; recover the log first")
    by_export = {frame.info.export: frame for frame in state.frames}
    try:
        pair = Pair(decision, by_export[decision.first.export], by_export[decision.second.export])
    except KeyError as error:
        raise BadLog(f"pair {decision.pair} names export {error}, whose bytes are not in the log; recover the log first") from error
    started = time.perf_counter()
    try:
        begun, result = pipeline.analyse(state.settings, state.begun, pair, state.foreseen)
    except SemliveError as error:
        fault = FaultMessage(time_ns=time_ns, what=str(error), where=fault_place(decision.pair), action="the pair is left out")
        return state, _with_pictures(pair, lambda: (_message(fault, time_ns),))
    wall_s = time.perf_counter() - started
    frames = tuple(frame for frame in state.frames if frame.info.export > decision.second.export)
    return _said(replace(state, frames=frames, begun=begun, told=pair), pair, result, wall_s)


def _said(state: AnalysisState, pair: Pair, result: PairResult, wall_s: float) -> tuple[AnalysisState, Iterable[LogMessage]]:
    """What is told of a result, and what the estimate warns of for the first time."""
    state, doubts = _newly_doubted(state, pair, result.estimate.notes)
    return state, _with_pictures(pair, lambda: (*pair_messages(result, wall_s), *doubts))


def _newly_doubted(state: AnalysisState, pair: Pair, notes: Sequence[str]) -> tuple[AnalysisState, tuple[LogMessage, ...]]:
    news, warned = newly_warned(notes, state.warned)
    return replace(state, warned=warned), tuple(_doubt(one, pair.decision.pair, pair.decision.second.end_time_ns) for one in news)


def _doubt(what: str, pair: int, time_ns: int) -> LogMessage:
    return _message(FaultMessage(time_ns=time_ns, what=what, where=f"{_DOUBT}{pair}", action=_ASK), time_ns)


def _with_pictures(pair: Pair, words: Callable[[], tuple[LogMessage, ...]]) -> Iterator[LogMessage]:
    """What is told of a pair, then its pictures: no result waits for a picture."""
    told = words()
    yield from told
    yield from pictures(pair, told)


def pair_messages(result: PairResult, wall_s: float) -> Iterator[LogMessage]:
    """All that is told of an analysed pair, in the order in which it is logged."""
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
    for frame in (*result.frames, *result.revised):
        number = frame.summary.frame
        yield LogMessage(DISPLACEMENT_FIELD, end_ns, end_ns, number, encode_displacement(frame.displacement))
        yield LogMessage(STRAIN_FIELD, end_ns, end_ns, number, encode_strain(frame.strain))
        yield _message(values.strain_message(frame.summary, revision), end_ns)
    yield _message(values.elastic_message(result.elastic, revision, result.gage, pairs), end_ns)
    yield from _left_area(result, end_ns)


def _left_area(result: PairResult, end_ns: int) -> Iterator[LogMessage]:
    """A word for the operator while the specimen can still be brought back: points that a frame shows beyond what was calibrated."""
    measured = {one.current: one.valid for one in result.maps if one.reference == 0}
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
            yield _message(FaultMessage(time_ns=end_ns, what=what, where=fault_place(result.decision.pair), action=action), end_ns)
            return


def _message(payload: Payload, time_ns: int) -> LogMessage:
    return LogMessage(topic_of(payload), time_ns, time_ns, 0, to_json(payload))


def main() -> None:
    """The child process; it ends when its standard input does."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--log", type=Path, required=True, help="the growing log")
    parser.add_argument("--inputs", type=int, default=0, help="how many input messages stand in it already")
    parser.add_argument("--skip", type=int, default=0, help="how many outputs stand in it already")
    parser.add_argument("--began-ns", type=int, default=None, help="log time of the log's first message, if there is one already")
    parser.add_argument("--beat", action="store_true", help="also say every second that this process lives")
    arguments = parser.parse_args()
    stand_back()
    one_blas_thread()
    counts = chain((arguments.inputs,), read_counts(sys.stdin.buffer))
    try:
        _follow(_inputs(arguments.log, counts, arguments.began_ns), arguments.skip, arguments.beat)
    except LogReplaced as error:
        sys.stderr.write(f"{error}\n")
        sys.exit(LOG_REPLACED)


def _follow(inputs: Iterable[LogMessage], skip: int, beat: bool) -> None:
    """Write to standard output what follows from the inputs, without the first so many outputs."""
    state, archive = AnalysisState(), Archive()
    with Voice(sys.stdout.buffer, beat) as voice:
        for message in inputs:
            with voice.at_work():
                before = state.begun
                state, outputs = feed(state, message)
                _warm(state, message)
                skip = _say(voice, outputs, skip)
                state, outputs = meanwhile(state)
                skip = _say(voice, outputs, skip)
                state = _lighter(state, before, archive)


def _say(voice: Voice, outputs: Iterable[LogMessage], skip: int) -> int:
    """Say all but the first so many, which stand in the log; how many of those are still to come."""
    for output in outputs:
        if skip > 0:
            skip -= 1
        else:
            voice.say(output)
    return skip


def _inputs(log: Path, counts: Iterable[int], began_ns: int | None = None) -> Iterator[LogMessage]:
    """Input messages of a growing log; each count says how many there are by now, and they are waited for.

    Raises:
        LogReplaced: the log does not begin at `began_ns`, or not any more where it began.
    """
    tail, taken = Tail(log), 0
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


def _lighter(state: AnalysisState, before: pipeline.Begun | None, archive: Archive) -> AnalysisState:
    """What is kept of a new pair goes into files without a name, the same to the last bit."""
    if state.begun is None or state.begun is before:
        return state
    begun = beside_memory(state.begun, state.begun.pairs[-1].pair, (), archive)
    archive.settle()
    give_back()
    return replace(state, begun=begun)


def _warm(state: AnalysisState, message: LogMessage) -> None:
    """Compile before the first pair; the word READY then goes out after it."""
    if message.topic == "/run" and state.settings is not None:
        dic.warm_up(state.settings.dic)


if __name__ == "__main__":
    main()
