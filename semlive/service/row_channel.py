"""Rows of a log's images, registered against the disparity maps that the log holds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from semlive import dic
from semlive.data.disparity import DisparityMap
from semlive.data.frame import ExportedFile, Frame
from semlive.data.pair import PairDecision
from semlive.data.settings import ScanProfile
from semlive.diagnose.row_series import RowSeries, row_series
from semlive.errors import BadImage, BadInput
from semlive.formats import message_values as values
from semlive.formats import read_frame
from semlive.formats.maps import decode_map
from semlive.formats.messages import DIC_MAP, SEM_ORIGINAL, SEM_SIDECAR, FileMessage, PairMessage, from_json
from semlive.service.log_files import messages
from semlive.service.log_pairs import has_images, log_settings, topic_counts

PIECE_PX = 42.0
"""Of a row: a quarter of the wave that 60 Hz makes at 0.1 ms a pixel; registration needs 40 px."""
MOST_PIECES = 24
MOST_PAIRS = 40
"""What jitter and waves are known from; 30 MB of rows."""
NO_IMAGES = (
    "the log holds no images, so rows cannot be registered: "
    "hum, vibration and jitter, of which disparity maps show a sixtieth, are not looked for"
)


def rows_of_log(log: Path, watch: Callable[[str, int, int], None] | None = None) -> tuple[tuple[RowSeries, ...], str]:
    """Rows of the pairs of a log, evenly chosen where there are many, and why there are none if there are none.

    Raises:
        BadLog: the log cannot be read.
    """
    if not has_images(log):
        return (), NO_IMAGES
    settings = log_settings(log)
    count = (topic_counts(log) or {}).get("/pair", 0)
    every = max(1, -(-count // MOST_PAIRS))
    found: list[RowSeries] = []
    for decision, within, first, second in _pairs(log, settings.scan):
        if decision.pair % every == 0:
            one = _registered(decision, within, first, second)
            if one is not None:
                found.append(one)
        if watch is not None:
            watch("rows", len(found), max(len(found), count // every))
    return tuple(found), "" if found else "no pair of the log could be registered row by row"


def _registered(decision: PairDecision, within: DisparityMap, first: Frame, second: Frame) -> RowSeries | None:
    pieces = int(min(MOST_PIECES, decision.first.width_px // PIECE_PX))
    if pieces < 2:
        return None
    try:
        shifts = dic.register_rows(first.image, second.image, within, segments=pieces)
    except BadInput:
        return None
    timing = decision.first.timing
    return row_series(shifts, timing.row_time_s.value, timing.dwell_time_s.value)


def _pairs(log: Path, settings: ScanProfile) -> Iterator[tuple[PairDecision, DisparityMap, Frame, Frame]]:
    """Each pair with the map within it and its frames; only those frames are decoded."""
    announced: FileMessage | None = None
    sidecar: bytes | None = None
    files: dict[int, ExportedFile] = {}
    waiting: dict[int, tuple[PairDecision, ExportedFile, ExportedFile]] = {}
    for message in messages(log):
        if message.topic == SEM_SIDECAR:
            sidecar = message.payload
        elif message.topic == "/sem/file":
            told = from_json(message.topic, message.payload)
            if isinstance(told, FileMessage) and told.decision == "arrived":
                announced, sidecar = told, None
        elif message.topic == SEM_ORIGINAL:
            if announced is not None and announced.export == message.sequence:
                files[message.sequence] = _file(message.sequence, announced, message.payload, sidecar)
            announced, sidecar = None, None
        elif message.topic == "/pair":
            decision = _decision(message.payload)
            both = decision.first.export, decision.second.export
            if all(one in files for one in both):
                waiting[decision.pair] = (decision, files[both[0]], files[both[1]])
            files = {number: one for number, one in files.items() if number > both[1]}
        elif message.topic == DIC_MAP and waiting:
            within = decode_map(message.payload)
            if within.reference == within.current - 1 and within.current // 2 in waiting:
                decision, *both_files = waiting.pop(within.current // 2)
                try:
                    first, second = (read_frame(one, settings) for one in both_files)
                except BadImage:
                    continue
                yield decision, within, first, second


def _decision(payload: bytes) -> PairDecision:
    told = from_json("/pair", payload)
    assert isinstance(told, PairMessage)  # by its topic
    return values.pair_decision(told)


def _file(export: int, told: FileMessage, data: bytes, sidecar: bytes | None) -> ExportedFile:
    return ExportedFile(export, told.name, data, told.sha256, told.mtime_ns, told.arrival_time_ns, sidecar, told.settled_time_ns)
