"""Parallel correlation: several processes correlate parts of a log, which are combined to one replay."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from semlive import pipeline
from semlive.data.disparity import DisparityMap
from semlive.data.pair import Pair, PairDecision
from semlive.data.settings import AnalysisSettings
from semlive.errors import BadLog, SemliveError
from semlive.formats.log import conversions as values
from semlive.formats.log.messages import PairMessage, from_json
from semlive.service.analysis.worker import INPUT_TOPICS, WorkerState, process_message
from semlive.service.log.files import messages
from semlive.service.log.pairs import log_settings
from semlive.service.replay.replay import ReplayCallbacks, ReplayRequest, ReplayResult, finish_replay, requested_settings
from semlive.service.runtime.blas import limit_blas_threads

PairMaps = tuple[PairDecision, tuple[DisparityMap, ...]]


def pair_numbers(request: ReplayRequest) -> tuple[int, ...]:
    """Return the numbers of the pairs of a replay.

    Raises:
        BadLog: the log cannot be read or holds no pair.
    """
    numbers = tuple(decision.pair for decision in _decisions(request))
    if not numbers:
        raise BadLog(f"{request.log}: holds no pair; nothing to replay.")
    return numbers


def correlate_pairs(request: ReplayRequest, numbers: Sequence[int]) -> list[PairMaps]:
    """Correlate some pairs, with the same maps as a replay of all pairs; pairs that cannot be correlated are skipped.

    The reference is the first pair of the log, so every process correlates it.

    Raises:
        BadInput: the log cannot be read.
    """
    limit_blas_threads()
    settings = requested_settings(log_settings(request.log), request)
    decisions = _decisions(request)
    requested = frozenset((decisions[0].pair, *numbers))
    results: list[PairMaps] = []
    state: pipeline.AnalysisState | None = None
    for pair in _pairs(request, settings, requested):
        try:
            if state is None:
                state = pipeline.start(settings, pair.first)
            maps = pipeline.correlate(state, pair)
            if not state.pairs:
                state = pipeline.accumulate(state, pair.decision, maps)
        except SemliveError:
            if state is None or not state.pairs:
                raise
            continue
        if pair.decision.pair in numbers:
            results.append((pair.decision, maps))
    return results


def replay_from_maps(request: ReplayRequest, pairs: Iterable[PairMaps], callbacks: ReplayCallbacks | None = None) -> ReplayResult:
    """Replay maps that were computed elsewhere; the pairs must be in order.

    Raises:
        BadLog: there is no pair.
    """
    limit_blas_threads()
    own = log_settings(request.log)
    return finish_replay(request, own, requested_settings(own, request), pairs, callbacks or ReplayCallbacks())


def _decisions(request: ReplayRequest) -> tuple[PairDecision, ...]:
    decisions = (_decision(message.payload) for message in messages(request.log) if message.topic == "/pair")
    return tuple(decision for decision in decisions if request.until is None or decision.pair <= request.until)


def _pairs(request: ReplayRequest, settings: AnalysisSettings, numbers: frozenset[int]) -> Iterator[Pair]:
    """Yield the requested pairs with their images, decoded as in the live run."""
    state = WorkerState()
    for message in messages(request.log):
        if message.topic == "/pair":
            decision = _decision(message.payload)
            if decision.pair not in numbers:
                continue
            frames = {frame.info.export: frame for frame in state.frames}
            if not {decision.first.export, decision.second.export} <= frames.keys():
                raise BadLog(f"{request.log}: pair {decision.pair} names images that are not in the log; recover the log first.")
            yield Pair(decision, frames[decision.first.export], frames[decision.second.export])
        elif message.topic in INPUT_TOPICS - {"/state"}:
            state, _ = process_message(state, message)
            if message.topic == "/run":
                state = replace(state, settings=settings)


def _decision(payload: bytes) -> PairDecision:
    message = from_json("/pair", payload)
    assert isinstance(message, PairMessage)  # by its topic
    return values.pair_decision(message)
