"""What a log's images show beside its maps: rows and grey levels, each image decoded once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from semlive.data.settings import ScanProfile
from semlive.diagnose.intensity.frames import IntensityFrames
from semlive.diagnose.rows.series import RowSeries
from semlive.service.diagnosis.intensity import NO_IMAGES, NO_REFERENCE, IntensityReader
from semlive.service.diagnosis.rows import NO_ROW_IMAGES, NO_ROWS, register_pair_rows
from semlive.service.log.image_pairs import imaged_pairs
from semlive.service.log.pairs import has_images, topic_counts

MAX_PAIRS = 40
"""What jitter, waves and grey levels are known from; 30 MB of rows."""


@dataclass(frozen=True, slots=True, eq=False)
class ImageData:
    """What images show.

    Attributes:
        rows: of each pair.
        no_rows: why there are none; empty if there are.
        grey: of each frame; None where there is nothing to compare.
        no_grey: why there is none; empty if there is.
    """

    rows: tuple[RowSeries, ...]
    no_rows: str
    grey: IntensityFrames | None
    no_grey: str


def channels_of_log(log: Path, scan: ScanProfile, watch: Callable[[str, int, int], None] | None = None) -> ImageData:
    """Of the pairs of a log, evenly chosen where there are many.

    Args:
        log: one file, or a run folder.
        scan: scan settings of the log.
        watch: callback with the activity, the completed amount and the total.

    Raises:
        BadLog: the log cannot be read.
    """
    counts = topic_counts(log)
    if not has_images(log, counts):
        return ImageData((), NO_ROW_IMAGES, None, NO_IMAGES)
    count = (counts or {}).get("/pair", 0)
    every = max(1, -(-count // MAX_PAIRS))
    rows: list[RowSeries] = []
    grey = IntensityReader()
    for done, pair in enumerate(imaged_pairs(log, scan, every), start=1):
        one = register_pair_rows(pair)
        if one is not None:
            rows.append(one)
        grey.take(pair)
        if watch is not None:
            watch("image", done, max(done, count // every))
    seen = grey.series()
    return ImageData(tuple(rows), "" if rows else NO_ROWS, seen, "" if seen is not None else NO_REFERENCE)
