"""Row registration of a log's images, based on its disparity maps."""

from __future__ import annotations

from semlive import dic
from semlive.diagnose.rows.series import RowSeries, row_series
from semlive.errors import BadInput
from semlive.service.log.image_pairs import ImagedPair

PIECE_PX = 42.0
"""Width of a row segment: a quarter of the wavelength of 60 Hz at 0.1 ms per pixel; registration needs 40 px."""
MAX_SEGMENTS = 24
NO_ROW_IMAGES = (
    "the log holds no images, so rows cannot be registered: "
    "hum, vibration and jitter, which disparity maps attenuate to a sixtieth, are not tested"
)
NO_ROWS = "no pair of the log could be registered row by row"


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
