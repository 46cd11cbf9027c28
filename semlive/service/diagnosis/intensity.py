"""Intensity data of a log's images at the material points tracked by its disparity maps."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from semlive.data.frame import Frame
from semlive.diagnose.intensity.frames import (
    IntensityFrame,
    IntensityFrames,
    IntensityReference,
    intensity_frame,
    intensity_reference,
    pair_noise,
    to_8bit_levels,
)
from semlive.service.log.image_pairs import ImagedPair

NO_IMAGES = "the log holds no images, so grey levels cannot be compared: contamination, defocus and changes of contrast are not tested"
NO_REFERENCE = "grey levels cannot be compared: the images and the map of the first pair are missing, or it has too few blocks"
NOISE_PAIRS = 12
"""Number of pairs for the estimate of the pixel noise, which is then determined to half a percent."""


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
