"""Analysis data of a log: settings, pairs with disparity maps, load, recorded result. One pair is in memory at a time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Channel, Statistics

from semlive.data.disparity import DisparityMap
from semlive.data.frame import FrameInfo
from semlive.data.loading import LoadSeries
from semlive.data.pair import PairDecision
from semlive.data.settings import AnalysisSettings
from semlive.errors import BadLog
from semlive.formats.log import conversions as values
from semlive.formats.log.maps import decode_map
from semlive.formats.log.messages import (
    DIC_MAP,
    SEM_ORIGINAL,
    ClockOffsetMessage,
    LoadSampleMessage,
    PairMessage,
    ResultMessage,
    RunMessage,
    from_json,
)
from semlive.formats.log.reader import LogMessage
from semlive.formats.log.segment_scan import summary
from semlive.service.log.files import messages, open_segment, segments
from semlive.service.log.opened_log import OpenedLog
from semlive.service.log.settings import settings_of

Maps = tuple[DisparityMap, ...]


@dataclass(slots=True)
class LogNotes:
    """Messages that are collected while the pairs of a log are read.

    Attributes:
        recorded: the newest recorded result.
        sem_clock: the newest message about the clock of the microscope.
    """

    recorded: dict[str, Any] | None = None
    sem_clock: ClockOffsetMessage | None = None


def first_run(log: Path) -> RunMessage:
    """Return the first `/run` message of a log.

    Raises:
        BadLog: the log cannot be read or has none.
    """
    return OpenedLog(log).run


def first_frame(log: Path) -> FrameInfo | None:
    """Return the metadata of frame 0; None if the log has no pair.

    Raises:
        BadLog: the log cannot be read.
    """
    found = OpenedLog(log).first("/pair")
    if found is None:
        return None
    message = from_json("/pair", found.payload)
    assert isinstance(message, PairMessage)  # by its topic
    return message.first


def log_settings(log: Path) -> AnalysisSettings:
    """Return the analysis settings of the run of a log.

    Raises:
        BadInput: the log cannot be read.
    """
    return settings_of(first_run(log))


def pairs_with_maps(log: Path, stream: Iterable[LogMessage], notes: LogNotes) -> Iterator[tuple[PairDecision, Maps]]:
    """Yield the pairs in order, each with its disparity maps.

    Args:
        log: path of the log, for error messages.
        stream: all messages of the log, in order.
        notes: receives other messages while the log is read.

    Raises:
        BadLog: the log cannot be read.
    """
    decisions: dict[int, PairDecision] = {}
    pair, maps = -1, []
    for message in stream:
        if message.topic == DIC_MAP:
            disparity_map = decode_map(message.payload)
            if disparity_map.current // 2 < pair or any(
                (disparity_map.reference, disparity_map.current) == (m.reference, m.current) for m in maps
            ):
                continue  # repeated after a restart of the analysis
            if maps and disparity_map.current // 2 > pair:
                yield _decision_of(log, decisions, pair), tuple(maps)
                maps = []
            pair = disparity_map.current // 2
            maps.append(disparity_map)
        else:
            _note(message.topic, message.payload, decisions, notes)
    if maps:
        yield _decision_of(log, decisions, pair), tuple(maps)


def _note(topic: str, payload: bytes, decisions: dict[int, PairDecision], notes: LogNotes) -> None:
    if topic == "/pair":
        message = from_json(topic, payload)
        assert isinstance(message, PairMessage)  # by its topic
        decisions[message.pair] = values.pair_decision(message)
    elif topic == "/result":
        result = from_json(topic, payload)
        notes.recorded = dict(result.root) if isinstance(result, ResultMessage) else None
    elif topic == "/clock/offset":
        offset = from_json(topic, payload)
        if isinstance(offset, ClockOffsetMessage) and offset.clock == "sem":
            notes.sem_clock = offset


def _decision_of(log: Path, decisions: dict[int, PairDecision], pair: int) -> PairDecision:
    decision = decisions.pop(pair, None)
    if decision is None:
        raise BadLog(f"{log}: holds maps of pair {pair} but not the pair itself; recover the log first.")
    return decision


def recorded_result(log: Path) -> dict[str, Any] | None:
    """Return the newest result in the log, None if its run did not finish.

    Raises:
        BadLog: the log cannot be read.
    """
    notes = LogNotes()
    for message in messages(log):
        if message.topic == "/result":
            _note(message.topic, message.payload, {}, notes)
    return notes.recorded


def has_images(log: Path, counts: Mapping[str, int] | None = None) -> bool:
    """Whether the log holds exported images.

    Args:
        log: one file, or a run folder.
        counts: result of `topic_counts` if the caller has it.

    Raises:
        BadLog: the log cannot be read.
    """
    counts = counts or topic_counts(log)
    if counts is not None:
        return counts.get(SEM_ORIGINAL, 0) > 0
    return any(message.topic == SEM_ORIGINAL for message in messages(log))


def topic_counts(log: Path) -> dict[str, int] | None:
    """Return the number of messages by topic, from the summaries at the ends of the segments; None if a segment has none."""
    totals: dict[str, int] = {}
    for path in segments(log):
        try:
            with open_segment(path) as stream:
                records = summary(stream)
        except OSError:
            return None
        topics = {record.id: record.topic for record in records if isinstance(record, Channel)}
        counts = next((record.channel_message_counts for record in records if isinstance(record, Statistics)), None)
        if counts is None or not counts.keys() <= topics.keys():
            return None
        for channel, count in counts.items():
            totals[topics[channel]] = totals.get(topics[channel], 0) + count
    return totals


def load_series(log: Path) -> LoadSeries | None:
    """Return load and extension as sampled, or None if the run had no load frame.

    Raises:
        BadLog: the log cannot be read.
    """
    payloads = (message.payload for message in messages(log) if message.topic == "/load_frame/sample")
    samples = [LoadSampleMessage.model_validate_json(payload) for payload in payloads]
    if not samples:
        return None
    time_ns = np.array([sample.time_ns for sample in samples], dtype=np.int64)
    force_n, extension_mm = (np.array([getattr(sample, name) for sample in samples]) for name in ("force_n", "extension_mm"))
    gage_strains = [sample.gage_strain for sample in samples]
    gage = (
        None
        if all(strain is None for strain in gage_strains)
        else np.array([np.nan if strain is None else strain for strain in gage_strains])
    )
    return LoadSeries(time_ns, force_n, extension_mm, gage)
