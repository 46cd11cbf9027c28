"""Row series of a pair of frames."""

from __future__ import annotations

from semlive import dic
from semlive.data.disparity import DisparityMap
from semlive.data.frame import Frame
from semlive.diagnose.rows.series import RowSeries, row_series
from semlive.errors import BadInput

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
    pieces = int(min(MAX_SEGMENTS, first.info.width_px // PIECE_PX))
    if pieces < 2:
        return None
    try:
        shifts = dic.register_rows(first.image, second.image, within, segments=pieces)
    except BadInput:
        return None
    timing = first.info.timing
    return row_series(shifts, timing.row_time_s.value, timing.dwell_time_s.value)
