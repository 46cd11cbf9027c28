"""The same analysis again, from a log."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from semlive import pipeline
from semlive.data.disparity import DisparityMap
from semlive.data.pair import PairDecision
from semlive.data.results import RunResult
from semlive.data.series import LoadSeries
from semlive.data.settings import AnalysisSettings
from semlive.errors import BadLog
from semlive.formats import message_values as values
from semlive.formats.maps import decode_map
from semlive.formats.messages import DIC_MAP, LoadSampleMessage, PairMessage, ResultMessage, RunMessage
from semlive.service.analysis import INPUT_TOPICS, AnalysisState, feed
from semlive.service.blas import one_blas_thread
from semlive.service.config import parse_config
from semlive.service.log_files import messages


@dataclass(frozen=True, slots=True, eq=False)
class Replayed:
    """A run analysed again.

    Attributes:
        result: from the log's images.
        settings: the run's own.
        recorded: the result that the live run recorded, or None if it did not get there.
    """

    result: RunResult
    settings: AnalysisSettings
    recorded: dict[str, Any] | None


def replay_images(log: Path, method: str | None = None) -> Replayed:
    """Correlate the log's images again and estimate anew.

    Args:
        log: one file, or a run folder of segments.
        method: of estimation, instead of the one that the run's configuration names.

    Raises:
        BadLog: the log cannot be read or holds no pair.
    """
    one_blas_thread()
    state, recorded = AnalysisState(), None
    for message in messages(log):
        if message.topic in INPUT_TOPICS:
            state, _ = feed(state, message)
            state = _estimating_by(state, method)
        elif message.topic == "/result":
            recorded = _recorded(message.payload)
    if state.begun is None or state.settings is None:
        raise BadLog(f"{log}: holds no pair; nothing to replay")
    return Replayed(pipeline.conclude(state.begun), state.settings, recorded)


def _estimating_by(state: AnalysisState, method: str | None) -> AnalysisState:
    if method is None or state.settings is None or state.settings.estimate.method == method:
        return state
    return replace(state, settings=replace(state.settings, estimate=replace(state.settings.estimate, method=method)))


def last_result(log: Path) -> tuple[RunResult, AnalysisSettings]:
    """The run's result, every frame corrected with the newest estimate, from the disparity maps in the log.

    Raises:
        BadLog: the log cannot be read or holds no analysed pair.
    """
    one_blas_thread()
    settings: AnalysisSettings | None = None
    decisions: dict[int, PairDecision] = {}
    maps: dict[int, list[DisparityMap]] = {}
    for message in messages(log):
        if message.topic == "/run":
            settings = _settings(message.payload)
        elif message.topic == "/pair":
            decision = _decision(message.payload)
            decisions[decision.pair] = decision
        elif message.topic == DIC_MAP:
            disparity = decode_map(message.payload)
            maps.setdefault(disparity.current // 2, []).append(disparity)
    if settings is None or not maps:
        raise BadLog(f"{log}: holds no analysed pair; replay it from its images")
    first = min(maps)
    begun = pipeline.begin_from_maps(settings, decisions[first].first, maps[first][0].grid)
    for pair in sorted(maps):
        begun = pipeline.absorb(begun, decisions[pair], tuple(maps[pair]))
    return pipeline.conclude(begun), settings


def load_series(log: Path) -> LoadSeries | None:
    """Load and extension as sampled, or None if the run had no load frame.

    Raises:
        BadLog: the log cannot be read.
    """
    payloads = (message.payload for message in messages(log) if message.topic == "/load_frame/sample")
    samples = [LoadSampleMessage.model_validate_json(payload) for payload in payloads]
    if not samples:
        return None
    time_ns = np.array([sample.time_ns for sample in samples], dtype=np.int64)
    force_n, extension_mm = (np.array([getattr(sample, name) for sample in samples]) for name in ("force_n", "extension_mm"))
    said = [sample.gage_strain for sample in samples]
    gage = None if all(one is None for one in said) else np.array([np.nan if one is None else one for one in said])
    return LoadSeries(time_ns, force_n, extension_mm, gage)


def _settings(payload: bytes) -> AnalysisSettings:
    return parse_config(RunMessage.model_validate_json(payload).config, "the run's configuration").analysis_settings()


def _decision(payload: bytes) -> PairDecision:
    return values.pair_decision(PairMessage.model_validate_json(payload))


def _recorded(payload: bytes) -> dict[str, Any]:
    return dict(ResultMessage.model_validate_json(payload).root)
