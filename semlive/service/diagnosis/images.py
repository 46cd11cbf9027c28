"""Row series and intensity data from the images of a log; each image is decoded once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from semlive import dic
from semlive.data.settings import ScanProfile
from semlive.diagnose.intensity.frames import IntensityFrames
from semlive.diagnose.rows.series import RowSeries, row_series
from semlive.errors import BadInput
from semlive.service.diagnosis.intensity import NO_IMAGES, NO_REFERENCE, IntensityReader
from semlive.service.log.image_pairs import ImagedPair, imaged_pairs
from semlive.service.log.pairs import has_images, topic_counts

MAX_PAIRS = 40
"""Maximum number of pairs for the row and intensity channels; 30 MB of row data."""
PIECE_PX = 42.0
"""Width of a row segment: a quarter of the wavelength of 60 Hz at 0.1 ms per pixel; registration needs 40 px."""
MAX_SEGMENTS = 24
NO_ROW_IMAGES = (
    "the log holds no images, so rows cannot be registered: "
    "hum, vibration and jitter, which disparity maps attenuate to a sixtieth, are not tested"
)
NO_ROWS = "no pair of the log could be registered row by row"


@dataclass(frozen=True, slots=True, eq=False)
class ImageData:
    """Data from the images of a log.

    Attributes:
        rows: row series of each pair.
        no_rows: reason for missing row series; empty if there are some.
        grey: intensity data of all frames; None without a reference.
        no_grey: reason for missing intensity data; empty if there are some.
    """

    rows: tuple[RowSeries, ...]
    no_rows: str
    grey: IntensityFrames | None
    no_grey: str


def channels_of_log(log: Path, scan: ScanProfile, watch: Callable[[str, int, int], None] | None = None) -> ImageData:
    """Read the image channels of the pairs of a log, of every n-th pair in long logs.

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
        row_data = register_pair_rows(pair)
        if row_data is not None:
            rows.append(row_data)
        grey.take(pair)
        if watch is not None:
            watch("image", done, max(done, count // every))
    intensity = grey.series()
    return ImageData(tuple(rows), "" if rows else NO_ROWS, intensity, "" if intensity is not None else NO_REFERENCE)


def register_pair_rows(pair: ImagedPair) -> RowSeries | None:
    """Row series of a pair; None if its rows cannot be registered."""
    decision, within = pair.decision, pair.within
    pieces = int(min(MAX_SEGMENTS, decision.first.width_px // PIECE_PX))
    if within is None or pieces < 2:
        return None
    try:
        shifts = dic.register_rows(pair.first.image, pair.second.image, within, segments=pieces)
    except BadInput:
        return None
    timing = decision.first.timing
    return row_series(shifts, timing.row_time_s.value, timing.dwell_time_s.value)
