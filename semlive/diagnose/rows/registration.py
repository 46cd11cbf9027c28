"""Row series of a pair of frames."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semlive import dic
from semlive.data.disparity import DisparityMap
from semlive.data.frame import Frame
from semlive.data.scan import ScanTiming
from semlive.diagnose.rows.series import RowSeries, row_series
from semlive.errors import BadInput

Image = NDArray[np.uint8] | NDArray[np.uint16]
PIECE_PX = 42.0
"""Width of a row segment: a quarter of the wavelength of 60 Hz at 0.1 ms per pixel; registration needs 40 px."""
MAX_SEGMENTS = 24


def register_pair_rows(first: Frame, second: Frame, within: DisparityMap) -> RowSeries | None:
    """Row series of a pair; None if its rows cannot be registered.

    Args:
        first: first frame of the pair.
        second: second frame.
        within: map from the first to the second.
    """
    return register_image_rows(first.image, second.image, within, first.info.timing)


def register_image_rows(first: Image, second: Image, within: DisparityMap, timing: ScanTiming) -> RowSeries | None:
    """Row series of two images; None if their rows cannot be registered.

    Args:
        first: (height, width) first image of the pair.
        second: (height, width) second image.
        within: map from the first to the second.
        timing: times of their scan.
    """
    pieces = int(min(MAX_SEGMENTS, first.shape[1] // PIECE_PX))
    if pieces < 2:
        return None
    try:
        shifts = dic.register_rows(first, second, within, segments=pieces)
    except BadInput:
        return None
    return row_series(shifts, timing.row_time_s.value, timing.dwell_time_s.value)
