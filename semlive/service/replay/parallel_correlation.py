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


def pair_numbers(asked: ReplayRequest) -> tuple[int, ...]:
    """Return the numbers of the pairs of a replay.

    Raises:
        BadLog: the log cannot be read or holds no pair.
    """
    found = tuple(one.pair for one in _decisions(asked))
    if not found:
        raise BadLog(f"{asked.log}: holds no pair; nothing to replay.")
    return found


def correlate_pairs(request: ReplayRequest, numbers: Sequence[int]) -> list[PairMaps]:
    """Some pairs' maps from the images, exactly those that the whole run has; pairs that cannot be correlated are left out.

    The reference is the log's first pair, so it is correlated in every part.

    Raises:
        BadInput: the log cannot be read.
    """
    limit_blas_threads()
    settings = requested_settings(log_settings(request.log), request)
    decisions = _decisions(request)
    wanted = frozenset((decisions[0].pair, *numbers))
    found: list[PairMaps] = []
    begun: pipeline.AnalysisState | None = None
    for pair in _pairs(request, settings, wanted):
        try:
            if begun is None:
                begun = pipeline.start(settings, pair.first)
            maps = pipeline.correlate(begun, pair)
            if not begun.pairs:
                begun = pipeline.accumulate(begun, pair.decision, maps)
        except SemliveError:
            if begun is None or not begun.pairs:
                raise
            continue
        if pair.decision.pair in numbers:
            found.append((pair.decision, maps))
    return found


def replay_from_maps(asked: ReplayRequest, pairs: Iterable[PairMaps], watch: ReplayCallbacks | None = None) -> ReplayResult:
    """The replay whose maps are made elsewhere; pairs come in their order.

    Raises:
        BadLog: there is no pair.
    """
    limit_blas_threads()
    own = log_settings(asked.log)
    return finish_replay(asked, own, requested_settings(own, asked), pairs, watch or ReplayCallbacks())


def _decisions(asked: ReplayRequest) -> tuple[PairDecision, ...]:
    found = (_decision(message.payload) for message in messages(asked.log) if message.topic == "/pair")
    return tuple(one for one in found if asked.until is None or one.pair <= asked.until)


def _pairs(asked: ReplayRequest, settings: AnalysisSettings, wanted: frozenset[int]) -> Iterator[Pair]:
    """Yield the requested pairs with their images, decoded as in the live run."""
    state = WorkerState()
    for message in messages(asked.log):
        if message.topic == "/pair":
            decision = _decision(message.payload)
            if decision.pair not in wanted:
                continue
            frames = {frame.info.export: frame for frame in state.frames}
            if not {decision.first.export, decision.second.export} <= frames.keys():
                raise BadLog(f"{asked.log}: pair {decision.pair} names images that are not in the log; recover the log first.")
            yield Pair(decision, frames[decision.first.export], frames[decision.second.export])
        elif message.topic in INPUT_TOPICS - {"/state"}:
            state, _ = process_message(state, message)
            if message.topic == "/run":
                state = replace(state, settings=settings)


def _decision(payload: bytes) -> PairDecision:
    told = from_json("/pair", payload)
    assert isinstance(told, PairMessage)  # by its topic
    return values.pair_decision(told)
