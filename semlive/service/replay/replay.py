"""Replay: the analysis of a log, from its images or from its disparity maps."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

from semlive import pipeline
from semlive.data.pair import PairDecision
from semlive.data.results import FrameResult, RunResult
from semlive.data.settings import AnalysisSettings
from semlive.errors import BadConfig, BadLog, PoorCalibration
from semlive.estimate.method import MethodSolution
from semlive.formats.log.messages import ResultMessage, from_json
from semlive.service.analysis.worker import INPUT_TOPICS, WorkerState, background_work, process_message
from semlive.service.config.overrides import SettingOverride, apply_overrides
from semlive.service.diagnosis.model_file import compatible_model
from semlive.service.log.files import messages
from semlive.service.log.pairs import LogNotes, Maps, has_images, load_series, log_settings, pairs_with_maps, recorded_result, topic_counts
from semlive.service.replay.prefetch import prefetch
from semlive.service.runtime.blas import limit_blas_threads
from semlive.service.storage.map_store import MapStore, offload_pair

__all__ = [
    "ReplayCallbacks",
    "ReplayRequest",
    "ReplayResult",
    "Source",
    "load_series",
    "replay",
    "replay_images",
    "require_calibration",
    "result_from_maps",
]


class Source(StrEnum):
    """Source of a replay."""

    IMAGES = "images"
    DISPARITY = "disparity"


@dataclass(frozen=True, slots=True)
class ReplayRequest:
    """What is asked for.

    Attributes:
        log: one file, or a run folder of segments.
        method: of estimation, instead of the one that the log names.
        changes: of settings.
        source: images or disparity maps; None takes the images if the log has any.
        until: number of the last pair; None takes all.
        speed: times the speed of life; None is as fast as it goes.
        model: file with further effects, which are fitted to the disparity maps of the whole log and taken out of them, in place of
            those that the run was made with.
    """

    log: Path
    method: str | None = None
    changes: tuple[SettingOverride, ...] = ()
    source: Source | None = None
    until: int | None = None
    speed: float | None = None
    model: Path | None = None


@dataclass(frozen=True, slots=True)
class ReplayCallbacks:
    """Callbacks of a replay.

    Attributes:
        progress: what is done, how much of it, of how much in all.
        pair: a pair with what is known after it; asking for this costs an estimate for each pair.
        frame: every frame corrected with the newest estimate, which the result then does not keep.
        point_sigma: whether frames also say how uncertain their correction is at every point.
    """

    progress: Callable[[str, int, int], None] | None = None
    pair: Callable[[PairDecision, pipeline.AnalysisState], None] | None = None
    frame: Callable[[FrameResult], None] | None = None
    point_sigma: bool = False

    def report_progress(self, what: str, done: int, count: int) -> None:
        """Call the progress callback if there is one."""
        if self.progress is not None:
            self.progress(what, done, max(done, count))


@dataclass(frozen=True, slots=True, eq=False)
class ReplayResult:
    """Result of a replay.

    Attributes:
        result: result of the replay.
        settings: analysis settings of the replay.
        recorded: the result that the live run recorded; None if the run did not finish.
        analysis: pairs and maps of the run.
        solution: solution of the estimate, as an argument of `pipeline.correct_frame`.
        unchanged: whether all settings are the log's own and all pairs were taken, so that both results should be the same.
    """

    result: RunResult
    settings: AnalysisSettings
    recorded: dict[str, Any] | None
    analysis: pipeline.AnalysisState
    solution: MethodSolution
    unchanged: bool = True


def replay(asked: ReplayRequest, watch: ReplayCallbacks | None = None) -> ReplayResult:
    """Analyse a log again by the same functions as the live run.

    Memory does not grow with the fields: maps, and what the estimator makes of them, lie in temporary files beyond the first 256 MB, and
    frames are handed to `watch.frame` one by one. What grows are numbers for each pair.

    Raises:
        BadInput: the log cannot be read, holds nothing to replay, or a setting does not fit it.
    """
    limit_blas_threads()
    watch = watch or ReplayCallbacks()
    own = log_settings(asked.log)
    settings = requested_settings(own, asked)
    by_images = not settings.model.effects and has_images(asked.log)
    source = asked.source or (Source.IMAGES if by_images else Source.DISPARITY)
    refused = [change.key for change in asked.changes if change.of_images]
    if source is Source.DISPARITY and refused:
        raise BadConfig(
            f"--set {refused[0]}: changes what is correlated, but this replay "
            "starts from disparity maps; give a log with images and --from-images."
        )
    if source is Source.IMAGES and not has_images(asked.log):
        raise BadLog(f"{asked.log}: holds no images; replay it from its disparity maps.")
    words, store = LogNotes(), MapStore()
    with store.flushing():
        begun = (_from_images if source is Source.IMAGES else _from_maps)(asked, settings, words, watch, store)
        return _finished(asked, own, settings, source, begun, words, watch)


def finish_replay(
    asked: ReplayRequest,
    own: AnalysisSettings,
    settings: AnalysisSettings,
    pairs: Iterable[tuple[PairDecision, Maps]],
    watch: ReplayCallbacks,
) -> ReplayResult:
    """A replay whose pairs with their maps are made elsewhere, in their order.

    Args:
        asked: what is asked for.
        own: the log's own settings.
        settings: those to use.
        pairs: decisions and maps.
        watch: who is told.

    Raises:
        BadLog: there is no pair.
    """
    store = MapStore()
    with store.flushing():
        begun = _absorbed(asked, settings, _kept_pairs(asked, pairs, store), 0, watch, store)
        return _finished(asked, own, settings, Source.IMAGES, begun, LogNotes(recorded=recorded_result(asked.log)), watch)


def _finished(
    asked: ReplayRequest,
    own: AnalysisSettings,
    settings: AnalysisSettings,
    source: Source,
    begun: pipeline.AnalysisState | None,
    words: LogNotes,
    watch: ReplayCallbacks,
) -> ReplayResult:
    if begun is None:
        what = "no pair; nothing to replay" if source is Source.IMAGES else "no analysed pair; replay it from its images"
        raise BadLog(f"{asked.log}: holds {what}.")
    begun = pipeline.apply_effect_model(begun)
    solution = pipeline.solve(begun)
    result = _concluded(begun, solution, watch)
    unchanged = settings == own and asked.until is None
    return ReplayResult(result, settings, words.recorded, begun, solution, unchanged)


def require_calibration(log: Path, done: ReplayResult) -> None:
    """Give no corrected strain of a run under load whose translations do not determine the distortion.

    Raises:
        PoorCalibration: they went in one direction only, or were too small; the sentence holds the figures and says what to do.
    """
    why = pipeline.calibration_refusal(done.result, done.settings)
    if why is not None:
        accept = "or take what was measured under load all the same with --set estimate.accept_poor_calibration=true"
        raise PoorCalibration(f"{log}: the calibration is refused: {why}, {accept}.")


def replay_images(log: Path, method: str | None = None) -> ReplayResult:
    """Correlate the log's images again and estimate anew.

    Args:
        log: one file, or a run folder of segments.
        method: of estimation, instead of the one that the run's configuration names.

    Raises:
        BadLog: the log cannot be read or holds no pair.
    """
    return replay(ReplayRequest(log, method, source=Source.IMAGES))


def result_from_maps(log: Path, watch: ReplayCallbacks | None = None) -> tuple[RunResult, AnalysisSettings]:
    """The run's result, every frame corrected with the newest estimate, from the disparity maps in the log.

    Args:
        log: one file, or a run folder of segments.
        watch: who is told on the way.

    Raises:
        BadLog: the log cannot be read or holds no analysed pair.
    """
    done = replay(ReplayRequest(log, source=Source.DISPARITY), watch)
    return done.result, done.settings


def requested_settings(own: AnalysisSettings, asked: ReplayRequest) -> AnalysisSettings:
    """The log's own settings with what is asked for instead.

    Raises:
        BadConfig: a value is out of its range, or the model is of another magnification or scan.
    """
    if asked.method is not None and own.estimate.method != asked.method:
        own = replace(own, estimate=replace(own.estimate, method=asked.method))
    if asked.model is not None:
        own = replace(own, model=compatible_model(asked.log, asked.model).effect_model)
    return apply_overrides(own, asked.changes)


def _from_maps(
    asked: ReplayRequest, settings: AnalysisSettings, words: LogNotes, watch: ReplayCallbacks, store: MapStore
) -> pipeline.AnalysisState | None:
    return _absorbed(asked, settings, prefetch(_kept_pairs(asked, pairs_with_maps(asked.log, words), store)), _count(asked), watch, store)


def _kept_pairs(asked: ReplayRequest, pairs: Iterable[tuple[PairDecision, Maps]], store: MapStore) -> Iterator[tuple[PairDecision, Maps]]:
    """Yield the pairs up to the last requested one, with their maps in the store."""
    for decision, maps in pairs:
        if asked.until is not None and decision.pair > asked.until:
            return
        yield decision, tuple(store.store_map(one) for one in maps)


def _count(asked: ReplayRequest) -> int:
    """Return the expected number of pairs; 0 if the log has no summary."""
    count = (topic_counts(asked.log) or {}).get("/pair", 0)
    return count if asked.until is None else min(count, asked.until + 1)


def _absorbed(
    asked: ReplayRequest,
    settings: AnalysisSettings,
    pairs: Iterable[tuple[PairDecision, Maps]],
    count: int,
    watch: ReplayCallbacks,
    store: MapStore,
) -> pipeline.AnalysisState | None:
    pace, state = _Pace(asked.speed), None

    def step(before: pipeline.AnalysisState, decision: PairDecision, maps: Maps) -> pipeline.AnalysisState:
        pace.wait(decision.second.end_time_ns)
        after = pipeline.accumulate(before, decision, maps) if watch.pair is None else _live_step(before, decision, maps)
        return offload_pair(after, decision.pair, maps, store)

    for done, state in enumerate(pipeline.follow(settings, pairs, step), start=1):
        if watch.pair is not None:
            watch.pair(state.pairs[-1], state)
        watch.report_progress("pair", done, count)
    return state


def _live_step(state: pipeline.AnalysisState, decision: PairDecision, maps: Maps) -> pipeline.AnalysisState:
    """Add a pair as a live run does, with the review that may be due."""
    return pipeline.review_hyperparameters(pipeline.add_pair(state, decision, maps)[0])[0]


def _from_images(
    asked: ReplayRequest, settings: AnalysisSettings, words: LogNotes, watch: ReplayCallbacks, store: MapStore
) -> pipeline.AnalysisState | None:
    state, pace = WorkerState(), _Pace(asked.speed)
    count = _count(asked)
    for message in messages(asked.log):
        if message.topic in INPUT_TOPICS - {"/state"}:
            before = state.analysis
            state, _ = process_message(state, message)
            if message.topic == "/run":
                state = replace(state, settings=settings)
            if state.analysis is not None and state.analysis is not before:
                decision = state.analysis.pairs[-1]
                begun = offload_pair(state.analysis, decision.pair, (), store)
                state = replace(state, analysis=begun)
                pace.wait(decision.second.end_time_ns)
                if watch.pair is not None:
                    state, _ = background_work(state)
                    watch.pair(decision, state.analysis or begun)
                watch.report_progress("pair", len(begun.pairs), count)
                if asked.until is not None and decision.pair >= asked.until:
                    break
        elif message.topic == "/result":
            result = from_json(message.topic, message.payload)
            words.recorded = dict(result.root) if isinstance(result, ResultMessage) else None
    return state.analysis


def _concluded(begun: pipeline.AnalysisState, solution: MethodSolution, watch: ReplayCallbacks) -> RunResult:
    if watch.frame is None:
        return pipeline.finalise(begun, solution=solution)
    take, done = watch.frame, {"uncertainty": 0, "frame": 0}

    def tell(what: str) -> None:
        done[what] += 1
        watch.report_progress(what, done[what], 2 * len(begun.pairs))

    def each(frame: FrameResult) -> None:
        take(frame)
        tell("frame")

    return pipeline.finalise(begun, each, solution, lambda _: tell("uncertainty"), watch.point_sigma)


class _Pace:
    """Waits until the time of an event, at a multiple of real time."""

    def __init__(self, speed: float | None) -> None:
        self._speed = speed
        self._zero: tuple[float, int] | None = None

    def wait(self, time_ns: int) -> None:
        if self._speed is None:
            return
        now = time.monotonic()
        began, zero_ns = self._zero = self._zero or (now, time_ns)
        time.sleep(max(0.0, began + (time_ns - zero_ns) / 1e9 / self._speed - now))
