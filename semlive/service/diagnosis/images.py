"""Row series, and intensity data at the material points tracked by disparity maps, from the images of a log; each is decoded once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from semlive.data.disparity import DisparityMap
from semlive.data.frame import Frame
from semlive.data.pair import PairDecision
from semlive.data.settings import ScanProfile
from semlive.diagnose.intensity.frames import (
    IntensityFrame,
    IntensityFrames,
    IntensityReference,
    intensity_frame,
    intensity_reference,
    pair_noise,
    to_8bit_levels,
)
from semlive.diagnose.rows.registration import register_pair_rows
from semlive.diagnose.rows.series import RowSeries
from semlive.formats.log.messages import SEM_ORIGINAL
from semlive.formats.log.reader import LogMessage
from semlive.service.log.image_pairs import ImagedPair, PairFiles

MAX_PAIRS = 40
"""Maximum number of pairs for the row and intensity channels; 30 MB of row data."""
NO_ROW_IMAGES = (
    "the log holds no images, so rows cannot be registered: "
    "hum, vibration and jitter, which disparity maps attenuate to a sixtieth, are not tested"
)
NO_ROWS = "no pair of the log could be registered row by row"
NO_IMAGES = "the log holds no images, so grey levels cannot be compared: contamination, defocus and changes of contrast are not tested"
NO_REFERENCE = "grey levels cannot be compared: the images and the map of the first pair are missing, or it has too few blocks"
NOISE_PAIRS = 12
"""Number of pairs for the estimate of the pixel noise, which is then determined to half a percent."""


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


@dataclass(slots=True)
class IntensityReader:
    """Collects the intensity data of pairs, beginning with the first pair of the run.

    Attributes:
        reference: frames 0 and 1; None before the first pair.
        begin_ns: start of frame 0.
        frames: frames so far.
        noise: pixel noise of the first pairs.
    """

    reference: IntensityReference | None = None
    begin_ns: int = 0
    frames: list[IntensityFrame] = field(default_factory=list)
    noise: list[tuple[float, float]] = field(default_factory=list)

    def take(self, pair: ImagedPair) -> None:
        """Add a pair; pairs are ignored without the first one, the reference."""
        number, within = pair.decision.pair, pair.within
        first, second = to_8bit_levels(pair.first), to_8bit_levels(pair.second)
        if number == 0 and within is not None:
            self.reference = intensity_reference(first, second, within)
            self.begin_ns = pair.first.info.start_time_ns.value
        if self.reference is None:
            return
        for frame, image, at in ((pair.first, first, 2 * number), (pair.second, second, 2 * number + 1)):
            self._frame(pair, frame, image, at)
        if within is not None and len(self.noise) < NOISE_PAIRS:
            self.noise.append(pair_noise(self.reference.blocks, first, second, within))

    def series(self) -> IntensityFrames | None:
        """Intensity data of all frames; None without the first pair."""
        if self.reference is None:
            return None
        return IntensityFrames(self.reference, tuple(self.frames), np.array(self.noise).reshape(-1, 2))

    def _frame(self, pair: ImagedPair, frame: Frame, image: np.ndarray, number: int) -> None:
        disparity = pair.map_of(0, number)
        if self.reference is not None and disparity is not None:
            start_s = (frame.info.start_time_ns.value - self.begin_ns) * 1e-9
            self.frames.append(intensity_frame(self.reference, image, disparity, start_s, frame.info.timing.row_time_s.value))


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
        row_data = None if pair.within is None else register_pair_rows(pair.first, pair.second, pair.within)
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
