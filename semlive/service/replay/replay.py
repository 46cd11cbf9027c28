"""Replay: the analysis of a log, from its images or from its disparity maps."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

from semlive import dic, pipeline
from semlive.data.pair import PairDecision
from semlive.data.results import FrameResult, RunResult
from semlive.data.settings import AnalysisSettings
from semlive.errors import BadConfig, BadLog, PoorCalibration
from semlive.estimate.method import MethodSolution
from semlive.formats.log.conversions import pair_decision
from semlive.formats.log.messages import PairMessage, ResultMessage, from_json
from semlive.model import RasterTerm
from semlive.service.analysis.messages import INPUT_TOPICS
from semlive.service.analysis.step import WorkerState, background_work, process_message
from semlive.service.config.overrides import SettingOverride, apply_overrides
from semlive.service.diagnosis.model_file import compatible_model
from semlive.service.log.files import messages
from semlive.service.log.opened_log import OpenedLog
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
    "require_calibration",
    "result_from_maps",
]


class Source(StrEnum):
    """Source of a replay."""

    IMAGES = "images"
    DISPARITY = "disparity"


RASTER_TERMS = tuple(term.value for term in RasterTerm)
"""Optional terms of the estimate that change the raster."""


@dataclass(frozen=True, slots=True)
class ReplayRequest:
    """Request of a replay.

    Attributes:
        log: one file, or a run folder of segments.
        method: estimation method instead of that of the log; None for that of the log.
        changes: changes of settings.
        source: images or disparity maps; None takes the images if the log has any.
        until: number of the last pair; None takes all.
        speed: multiple of real time; None for the highest possible speed.
        model: file with effects that are fitted to all disparity maps and subtracted from them, instead of the effects of the run;
            None for those of the run.
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
        progress: callback with the activity, the completed amount and the total.
        pair: callback with a pair and the state after it; this needs an estimate for each pair.
        frame: callback with every frame, corrected with the newest estimate; the result then does not contain the frames.
        point_sigma: frames contain the uncertainty of their correction at every point.
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
        unchanged: the settings are those of the log and all pairs were used, so both results should be equal.
    """

    result: RunResult
    settings: AnalysisSettings
    recorded: dict[str, Any] | None
    analysis: pipeline.AnalysisState
    solution: MethodSolution
    unchanged: bool = True


def replay(request: ReplayRequest, callbacks: ReplayCallbacks | None = None) -> ReplayResult:
    """Analyse a log again with the functions of the live run.

    Memory does not grow with the fields: maps and arrays derived from them are stored in temporary files beyond the first 256 MB, and
    frames are passed to `callbacks.frame` one by one. Only scalars of each pair accumulate.

    Raises:
        BadInput: the log cannot be read, holds nothing to replay, or a setting does not fit it.
    """
    limit_blas_threads()
    callbacks = callbacks or ReplayCallbacks()
    own = log_settings(request.log)
    settings = requested_settings(own, request)
    images_exist = has_images(request.log)
    by_images = not settings.model.effects and images_exist
    source = request.source or (Source.IMAGES if by_images else Source.DISPARITY)
    refused = [change.key for change in request.changes if change.of_images]
    if source is Source.DISPARITY and refused:
        raise BadConfig(
            f"--set {refused[0]}: changes what is correlated, but this replay "
            "starts from disparity maps; give a log with images and --from-images."
        )
    if source is Source.IMAGES and not images_exist:
        raise BadLog(f"{request.log}: holds no images; replay it from its disparity maps.")
    notes, store = LogNotes(), MapStore()
    with store.flushing():
        analysis = (_from_images if source is Source.IMAGES else _from_maps)(request, settings, notes, callbacks, store)
        return _finished(request, own, settings, source, analysis, notes, callbacks)


def finish_replay(
    request: ReplayRequest,
    own: AnalysisSettings,
    settings: AnalysisSettings,
    pairs: Iterable[tuple[PairDecision, Maps]],
    callbacks: ReplayCallbacks,
) -> ReplayResult:
    """Replay pairs whose maps were computed elsewhere, in order.

    Args:
        request: log and last pair; its other values are applied already.
        own: settings of the log.
        settings: settings of the replay.
        pairs: decisions and maps.
        callbacks: receive progress and results.

    Raises:
        BadLog: there is no pair.
    """
    store = MapStore()
    with store.flushing():
        analysis = _accumulated(request, settings, _stored_pairs(request, pairs, store), 0, callbacks, store)
        return _finished(request, own, settings, Source.IMAGES, analysis, LogNotes(recorded=recorded_result(request.log)), callbacks)


def _finished(
    request: ReplayRequest,
    own: AnalysisSettings,
    settings: AnalysisSettings,
    source: Source,
    analysis: pipeline.AnalysisState | None,
    notes: LogNotes,
    callbacks: ReplayCallbacks,
) -> ReplayResult:
    if analysis is None:
        what = "no pair; nothing to replay" if source is Source.IMAGES else "no analysed pair; replay it from its images"
        raise BadLog(f"{request.log}: holds {what}.")
    analysis = pipeline.apply_effect_model(analysis)
    solution = pipeline.solve(analysis)
    result = _concluded(analysis, solution, callbacks)
    unchanged = settings == own and request.until is None
    return ReplayResult(result, settings, notes.recorded, analysis, solution, unchanged)


def require_calibration(log: Path, done: ReplayResult) -> None:
    """Refuse the corrected strain of a run under load whose translations do not determine the distortion.

    Raises:
        PoorCalibration: the translations had one direction only, or were too small.
    """
    reason = pipeline.calibration_refusal(done.result, done.settings)
    if reason is not None:
        accept = "or take what was measured under load all the same with --set estimate.accept_poor_calibration=true"
        raise PoorCalibration(f"{log}: the calibration is refused: {reason}, {accept}.{_missing_effect_advice(log, done)}")


def _missing_effect_advice(log: Path, done: ReplayResult) -> str:
    """The next command where a missing effect may be the cause of a refused calibration; else empty.

    A drift of the raster takes the same displacements as larger translations would show. A residual beyond noise makes the drift rough.
    """
    solved = replace(done.analysis, solution=done.solution)
    used = [term.name for term in done.result.estimate.terms if term.included and term.name in RASTER_TERMS]
    rival = pipeline.term_rival(solved) if used else None
    causes = [f"the estimate uses {name}, which another effect may imitate" for name in used] if rival is None else [rival.text]
    if pipeline.residual_notes(solved):
        causes.append("the residual of the maps is more than noise")
    if not causes:
        return ""
    return (
        f" An effect that is missing in the model may cause this ({', '.join(causes)}): identify it with `semlive diagnose {log} "
        f"-o model.json`, then repeat the replay with `--model model.json`."
    )


def result_from_maps(log: Path, callbacks: ReplayCallbacks | None = None) -> tuple[RunResult, AnalysisSettings]:
    """Return the result of a run from the disparity maps in its log, with every frame corrected with the newest estimate.

    Args:
        log: one file, or a run folder of segments.
        callbacks: receive progress and results; None for none.

    Raises:
        BadLog: the log cannot be read or holds no analysed pair.
    """
    done = replay(ReplayRequest(log, source=Source.DISPARITY), callbacks)
    return done.result, done.settings


def requested_settings(own: AnalysisSettings, request: ReplayRequest) -> AnalysisSettings:
    """Return the settings of the log with the requested changes.

    Raises:
        BadConfig: a value is out of range, or the model has another magnification or scan.
        BadInput: a mask has another size than the frames.
    """
    if request.method is not None and own.estimate.method != request.method:
        own = replace(own, estimate=replace(own.estimate, method=request.method))
    if request.model is not None:
        own = replace(own, model=compatible_model(OpenedLog(request.log), request.model).effect_model)
    changed = apply_overrides(own, request.changes)
    if changed.dic.mask is not None and changed.dic.mask != own.dic.mask:
        _require_mask_size(request.log, changed)
    return changed


def _require_mask_size(log: Path, settings: AnalysisSettings) -> None:
    """Verify the size of a mask before the images of the log are read.

    Raises:
        BadInput: it is not that of the frames of the log.
    """
    for message in messages(log):
        if message.topic == "/pair":
            pair = from_json(message.topic, message.payload)
            assert isinstance(pair, PairMessage)  # by its topic
            first = pair_decision(pair).first
            dic.mask_of(settings.dic, (first.height_px, first.width_px))
            return


def _from_maps(
    request: ReplayRequest, settings: AnalysisSettings, notes: LogNotes, callbacks: ReplayCallbacks, store: MapStore
) -> pipeline.AnalysisState | None:
    pairs = pairs_with_maps(request.log, messages(request.log), notes)
    return _accumulated(request, settings, prefetch(_stored_pairs(request, pairs, store)), _count(request), callbacks, store)


def _stored_pairs(
    request: ReplayRequest, pairs: Iterable[tuple[PairDecision, Maps]], store: MapStore
) -> Iterator[tuple[PairDecision, Maps]]:
    """Yield the pairs up to the last requested one, with their maps in the store."""
    for decision, maps in pairs:
        if request.until is not None and decision.pair > request.until:
            return
        yield decision, tuple(store.store_map(disparity) for disparity in maps)


def _count(request: ReplayRequest) -> int:
    """Return the expected number of pairs; 0 if the log has no summary."""
    count = (topic_counts(request.log) or {}).get("/pair", 0)
    return count if request.until is None else min(count, request.until + 1)


def _accumulated(
    request: ReplayRequest,
    settings: AnalysisSettings,
    pairs: Iterable[tuple[PairDecision, Maps]],
    count: int,
    callbacks: ReplayCallbacks,
    store: MapStore,
) -> pipeline.AnalysisState | None:
    pace, state = _Pace(request.speed), None

    def step(before: pipeline.AnalysisState, decision: PairDecision, maps: Maps) -> pipeline.AnalysisState:
        pace.wait(decision.second.end_time_ns)
        after = pipeline.accumulate(before, decision, maps) if callbacks.pair is None else _live_step(before, decision, maps)
        return offload_pair(after, decision.pair, maps, store)

    for done, state in enumerate(pipeline.follow(settings, pairs, step), start=1):
        if callbacks.pair is not None:
            callbacks.pair(state.pairs[-1], state)
        callbacks.report_progress("pair", done, count)
    return state


def _live_step(state: pipeline.AnalysisState, decision: PairDecision, maps: Maps) -> pipeline.AnalysisState:
    """Add a pair as a live run does, with the review that may be due."""
    return pipeline.review_hyperparameters(pipeline.add_pair(state, decision, maps)[0])[0]


def _from_images(
    request: ReplayRequest, settings: AnalysisSettings, notes: LogNotes, callbacks: ReplayCallbacks, store: MapStore
) -> pipeline.AnalysisState | None:
    state, pace = WorkerState(), _Pace(request.speed)
    count = _count(request)
    for message in messages(request.log):
        if message.topic in INPUT_TOPICS - {"/state"}:
            before = state.analysis
            state, _ = process_message(state, message)
            if message.topic == "/run":
                state = replace(state, settings=settings)
            if state.analysis is not None and state.analysis is not before:
                decision = state.analysis.pairs[-1]
                analysis = offload_pair(state.analysis, decision.pair, (), store)
                state = replace(state, analysis=analysis)
                pace.wait(decision.second.end_time_ns)
                if callbacks.pair is not None:
                    state, _ = background_work(state)
                    callbacks.pair(decision, state.analysis or analysis)
                callbacks.report_progress("pair", len(analysis.pairs), count)
                if request.until is not None and decision.pair >= request.until:
                    break
        elif message.topic == "/result":
            result = from_json(message.topic, message.payload)
            notes.recorded = dict(result.root) if isinstance(result, ResultMessage) else None
    return state.analysis


def _concluded(analysis: pipeline.AnalysisState, solution: MethodSolution, callbacks: ReplayCallbacks) -> RunResult:
    if callbacks.frame is None:
        return pipeline.finalise(analysis, solution=solution)
    pass_on, done = callbacks.frame, {"uncertainty": 0, "frame": 0}

    def report(what: str) -> None:
        done[what] += 1
        callbacks.report_progress(what, done[what], 2 * len(analysis.pairs))

    def each(frame: FrameResult) -> None:
        pass_on(frame)
        report("frame")

    return pipeline.finalise(analysis, each, solution, lambda _: report("uncertainty"), callbacks.point_sigma)


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
