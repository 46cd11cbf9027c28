"""Pairs among frames in the order of their capture, by the shift from each frame to the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from semlive.data.frame import Frame
from semlive.qualify.figures.setups import setup_of

MAX_PAIR_SHIFT_PX = 4.0
"""Largest shift within a pair: a stage move of a calibration is larger, the drift during a frame of a usable microscope is smaller."""
MIN_RESPONSE = 0.03
"""Smallest phase correlation of two frames of one field; unrelated speckle frames of 512 x 442 px have at most 0.015."""
WORKING_PX = 1024


@dataclass(frozen=True, slots=True)
class FrameStep:
    """Coarse shift from a frame to the next.

    Attributes:
        shift_px: shift (x, y), px.
        response: peak of the phase correlation, 0 to 1.
        comparable: whether both frames have the same size and scan.
    """

    shift_px: tuple[float, float]
    response: float
    comparable: bool

    @property
    def within_pair(self) -> bool:
        """Whether the two frames may be a pair: same scan, same field, without a move between them."""
        return self.comparable and self.response >= MIN_RESPONSE and float(np.hypot(*self.shift_px)) <= MAX_PAIR_SHIFT_PX


def frame_step(before: Frame, after: Frame) -> FrameStep:
    """Shift from one frame to the next by phase correlation of frames of at most 1024 px."""
    same_scan = before.info.timing.integrations == after.info.timing.integrations and setup_of(before.info).is_same(setup_of(after.info))
    if before.image.shape != after.image.shape or not same_scan:
        return FrameStep((0.0, 0.0), 0.0, False)
    binning = max(1, -(-max(before.image.shape) // WORKING_PX))
    first, second = (_binned(frame, binning) for frame in (before, after))
    window = cv2.createHanningWindow((first.shape[1], first.shape[0]), cv2.CV_32F)
    (x, y), response = cv2.phaseCorrelate(first, second, window)
    return FrameStep((binning * x, binning * y), float(response), True)


def _binned(frame: Frame, binning: int) -> np.ndarray:
    height, width = frame.image.shape
    image = frame.image.astype(np.float32)
    return image if binning == 1 else cv2.resize(image, (width // binning, height // binning), interpolation=cv2.INTER_AREA)


def pair_frames(steps: Sequence[FrameStep]) -> tuple[tuple[int, int], ...]:
    """Indices of the frames of each pair: consecutive frames without a move between them, each frame in one pair.

    Args:
        steps: from each frame to the next.
    """
    pairs: list[tuple[int, int]] = []
    at = 0
    while at < len(steps):
        if steps[at].within_pair:
            pairs.append((at, at + 1))
            at += 1
        at += 1
    return tuple(pairs)
