"""Row series and intensity data from the images of a log; each image is decoded once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from semlive import dic
from semlive.data.disparity import DisparityMap
from semlive.data.pair import PairDecision
from semlive.data.settings import ScanProfile
from semlive.diagnose.intensity.frames import IntensityFrames
from semlive.diagnose.rows.series import RowSeries, row_series
from semlive.errors import BadInput
from semlive.formats.log.messages import SEM_ORIGINAL
from semlive.formats.log.reader import LogMessage
from semlive.service.diagnosis.intensity import NO_IMAGES, NO_REFERENCE, IntensityReader
from semlive.service.log.image_pairs import ImagedPair, PairFiles

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


class ImageChannels:
    """Collects the image channels of the pairs of a log while it is read, of every n-th pair in long logs.

    Args:
        scan: scan settings of the log.
        pairs: number of pairs of the log; 0 if it has no summary.
        watch: callback with the activity, the completed amount and the total.
    """

    def __init__(self, scan: ScanProfile, pairs: int, watch: Callable[[str, int, int], None] | None = None) -> None:
        every = max(1, -(-pairs // MAX_PAIRS))
        self._files, self._expected, self._watch = PairFiles(scan, every), pairs // every, watch
        self._rows: list[RowSeries] = []
        self._grey = IntensityReader()
        self._done, self._images_exist = 0, False

    def noting(self, stream: Iterable[LogMessage]) -> Iterator[LogMessage]:
        """Yield the messages of a log, and keep their files."""
        for message in stream:
            self._images_exist = self._images_exist or message.topic == SEM_ORIGINAL
            self._files.note(message)
            yield message

    def take(self, decision: PairDecision, maps: tuple[DisparityMap, ...]) -> None:
        """Add a pair with complete maps; its frames are decoded here."""
        pair = self._files.imaged_pair(decision, maps)
        if pair is None:
            return
        row_data = register_pair_rows(pair)
        if row_data is not None:
            self._rows.append(row_data)
        self._grey.take(pair)
        self._done += 1
        if self._watch is not None:
            self._watch("image", self._done, max(self._done, self._expected))

    def data(self) -> ImageData:
        """The channels of all pairs so far."""
        if not self._images_exist:
            return ImageData((), NO_ROW_IMAGES, None, NO_IMAGES)
        intensity = self._grey.series()
        return ImageData(tuple(self._rows), "" if self._rows else NO_ROWS, intensity, "" if intensity is not None else NO_REFERENCE)


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
