"""The same analysis again, from a log: from its images, or from the disparity maps that it holds."""

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
from semlive.formats.messages import ResultMessage, from_json
from semlive.service.ahead import ahead
from semlive.service.analysis import INPUT_TOPICS, AnalysisState, feed, meanwhile
from semlive.service.blas import one_blas_thread
from semlive.service.log_files import messages
from semlive.service.log_pairs import Maps, Words, has_images, load_series, log_settings, mapped_pairs, recorded_result, topic_counts
from semlive.service.map_store import MapStore, beside_memory
from semlive.service.model_file import fitting_model
from semlive.service.settings_changes import Change, changed

__all__ = ["Replay", "Replayed", "Source", "Watch", "last_result", "load_series", "replay", "replay_images", "require_calibration"]


class Source(StrEnum):
    """What a replay starts from."""

    IMAGES = "images"
    DISPARITY = "disparity"


@dataclass(frozen=True, slots=True)
class Replay:
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
    changes: tuple[Change, ...] = ()
    source: Source | None = None
    until: int | None = None
    speed: float | None = None
    model: Path | None = None


@dataclass(frozen=True, slots=True)
class Watch:
    """Who is told on the way.

    Attributes:
        progress: what is done, how much of it, of how much in all.
        pair: a pair with what is known after it; asking for this costs an estimate for each pair.
        frame: every frame corrected with the newest estimate, which the result then does not keep.
        point_sigma: whether frames also say how uncertain their correction is at every point.
    """

    progress: Callable[[str, int, int], None] | None = None
    pair: Callable[[PairDecision, pipeline.Begun], None] | None = None
    frame: Callable[[FrameResult], None] | None = None
    point_sigma: bool = False

    def tell(self, what: str, done: int, count: int) -> None:
        """Tell progress, if anybody listens."""
        if self.progress is not None:
            self.progress(what, done, max(done, count))


@dataclass(frozen=True, slots=True, eq=False)
class Replayed:
    """A run analysed again.

    Attributes:
        result: of the replay.
        settings: that it was made with.
        recorded: the result that the live run recorded, or None if it did not get there.
        begun: the run's pairs and maps.
        solution: what was solved for, as `pipeline.corrected` takes it.
        unchanged: whether all settings are the log's own and all pairs were taken, so that both results should be the same.
    """

    result: RunResult
    settings: AnalysisSettings
    recorded: dict[str, Any] | None
    begun: pipeline.Begun
    solution: Any
    unchanged: bool = True


def replay(asked: Replay, watch: Watch | None = None) -> Replayed:
    """Analyse a log again by the same functions as the live run.

    Memory does not grow with the fields: maps, and what the estimator makes of them, lie in temporary files beyond the first 256 MB, and
    frames are handed to `watch.frame` one by one. What grows are numbers for each pair.

    Raises:
        BadInput: the log cannot be read, holds nothing to replay, or a setting does not fit it.
    """
    one_blas_thread()
    watch = watch or Watch()
    own = log_settings(asked.log)
    settings = asked_settings(own, asked)
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
    words, store = Words(), MapStore()
    with store.settling():
        begun = (_from_images if source is Source.IMAGES else _from_maps)(asked, settings, words, watch, store)
        return _finished(asked, own, settings, source, begun, words, watch)


def conclude_replay(
    asked: Replay, own: AnalysisSettings, settings: AnalysisSettings, pairs: Iterable[tuple[PairDecision, Maps]], watch: Watch
) -> Replayed:
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
    with store.settling():
        begun = _absorbed(asked, settings, _kept_pairs(asked, pairs, store), 0, watch, store)
        return _finished(asked, own, settings, Source.IMAGES, begun, Words(recorded=recorded_result(asked.log)), watch)


def _finished(
    asked: Replay,
    own: AnalysisSettings,
    settings: AnalysisSettings,
    source: Source,
    begun: pipeline.Begun | None,
    words: Words,
    watch: Watch,
) -> Replayed:
    if begun is None:
        what = "no pair; nothing to replay" if source is Source.IMAGES else "no analysed pair; replay it from its images"
        raise BadLog(f"{asked.log}: holds {what}.")
    begun = pipeline.without_effects(begun)
    solution = pipeline.solve(begun)
    result = _concluded(begun, solution, watch)
    unchanged = settings == own and asked.until is None
    return Replayed(result, settings, words.recorded, begun, solution, unchanged)


def require_calibration(log: Path, done: Replayed) -> None:
    """Give no corrected strain of a run under load whose translations do not determine the distortion.

    Raises:
        PoorCalibration: they went in one direction only, or were too small; the sentence holds the figures and says what to do.
    """
    why = pipeline.refused(done.result, done.settings)
    if why is not None:
        accept = "or take what was measured under load all the same with --set estimate.accept_poor_calibration=true"
        raise PoorCalibration(f"{log}: the calibration is refused: {why}, {accept}.")


def replay_images(log: Path, method: str | None = None) -> Replayed:
    """Correlate the log's images again and estimate anew.

    Args:
        log: one file, or a run folder of segments.
        method: of estimation, instead of the one that the run's configuration names.

    Raises:
        BadLog: the log cannot be read or holds no pair.
    """
    return replay(Replay(log, method, source=Source.IMAGES))


def last_result(log: Path, watch: Watch | None = None) -> tuple[RunResult, AnalysisSettings]:
    """The run's result, every frame corrected with the newest estimate, from the disparity maps in the log.

    Args:
        log: one file, or a run folder of segments.
        watch: who is told on the way.

    Raises:
        BadLog: the log cannot be read or holds no analysed pair.
    """
    done = replay(Replay(log, source=Source.DISPARITY), watch)
    return done.result, done.settings


def asked_settings(own: AnalysisSettings, asked: Replay) -> AnalysisSettings:
    """The log's own settings with what is asked for instead.

    Raises:
        BadConfig: a value is out of its range, or the model is of another magnification or scan.
    """
    if asked.method is not None and own.estimate.method != asked.method:
        own = replace(own, estimate=replace(own.estimate, method=asked.method))
    if asked.model is not None:
        own = replace(own, model=fitting_model(asked.log, asked.model).known)
    return changed(own, asked.changes)


def _from_maps(asked: Replay, settings: AnalysisSettings, words: Words, watch: Watch, store: MapStore) -> pipeline.Begun | None:
    return _absorbed(asked, settings, ahead(_kept_pairs(asked, mapped_pairs(asked.log, words), store)), _count(asked), watch, store)


def _kept_pairs(asked: Replay, pairs: Iterable[tuple[PairDecision, Maps]], store: MapStore) -> Iterator[tuple[PairDecision, Maps]]:
    """Pairs up to the last that is asked for, their maps in the store."""
    for decision, maps in pairs:
        if asked.until is not None and decision.pair > asked.until:
            return
        yield decision, tuple(store.map(one) for one in maps)


def _count(asked: Replay) -> int:
    """How many pairs are to be expected, 0 if the log does not tell quickly."""
    count = (topic_counts(asked.log) or {}).get("/pair", 0)
    return count if asked.until is None else min(count, asked.until + 1)


def _absorbed(
    asked: Replay,
    settings: AnalysisSettings,
    pairs: Iterable[tuple[PairDecision, Maps]],
    count: int,
    watch: Watch,
    store: MapStore,
) -> pipeline.Begun | None:
    pace, begun = _Pace(asked.speed), None
    for done, (decision, kept) in enumerate(pairs, start=1):
        begun = begun or pipeline.begin_from_maps(settings, decision.first, kept[0].grid)
        pace.wait(decision.second.end_time_ns)
        begun = pipeline.absorb(begun, decision, kept) if watch.pair is None else _followed(begun, decision, kept)
        begun = beside_memory(begun, decision.pair, kept, store)
        if watch.pair is not None:
            watch.pair(decision, begun)
        watch.tell("pair", done, count)
    return begun


def _followed(begun: pipeline.Begun, decision: PairDecision, maps: Maps) -> pipeline.Begun:
    """As a live run goes on."""
    return pipeline.reconsider(pipeline.update(begun, decision, maps)[0])[0]


def _from_images(asked: Replay, settings: AnalysisSettings, words: Words, watch: Watch, store: MapStore) -> pipeline.Begun | None:
    state, pace = AnalysisState(), _Pace(asked.speed)
    count = _count(asked)
    for message in messages(asked.log):
        if message.topic in INPUT_TOPICS - {"/state"}:
            before = state.begun
            state, _ = feed(state, message)
            if message.topic == "/run":
                state = replace(state, settings=settings)
            if state.begun is not None and state.begun is not before:
                decision = state.begun.pairs[-1]
                begun = beside_memory(state.begun, decision.pair, (), store)
                state = replace(state, begun=begun)
                pace.wait(decision.second.end_time_ns)
                if watch.pair is not None:
                    state, _ = meanwhile(state)
                    watch.pair(decision, state.begun or begun)
                watch.tell("pair", len(begun.pairs), count)
                if asked.until is not None and decision.pair >= asked.until:
                    break
        elif message.topic == "/result":
            result = from_json(message.topic, message.payload)
            words.recorded = dict(result.root) if isinstance(result, ResultMessage) else None
    return state.begun


def _concluded(begun: pipeline.Begun, solution: Any, watch: Watch) -> RunResult:
    if watch.frame is None:
        return pipeline.conclude(begun, solution=solution)
    take, done = watch.frame, {"uncertainty": 0, "frame": 0}

    def tell(what: str) -> None:
        done[what] += 1
        watch.tell(what, done[what], 2 * len(begun.pairs))

    def each(frame: FrameResult) -> None:
        take(frame)
        tell("frame")

    return pipeline.conclude(begun, each, solution, lambda _: tell("uncertainty"), watch.point_sigma)


class _Pace:
    """Waits until it is time, at so many times the speed of life."""

    def __init__(self, speed: float | None) -> None:
        self._speed = speed
        self._zero: tuple[float, int] | None = None

    def wait(self, time_ns: int) -> None:
        if self._speed is None:
            return
        now = time.monotonic()
        began, zero_ns = self._zero = self._zero or (now, time_ns)
        time.sleep(max(0.0, began + (time_ns - zero_ns) / 1e9 / self._speed - now))
