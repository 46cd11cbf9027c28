"""Exposure of a frame in passes, each of which is computed after its time has passed: a band of rows on one visit."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive_simulators.microscope.column import Column
from semlive_simulators.specimen.specimen import Motion

_MIN_BAND_ROWS = 16
"""Smallest number of rows of a band: 1.7 s of experiment time at x200, 1 ms of computation."""
_MIN_BAND_S = 0.3
"""Smallest duration of a band, experiment time: 56 rows at x10,000, with which the fixed cost of a band is negligible."""


@dataclass(frozen=True, slots=True)
class RowPass:
    """Rows on one visit, or on all at once.

    Attributes:
        first_row: number of the first row.
        end_row: number of the row after the last.
        visit: number of the visit; None renders rows with a single visit directly.
        begin_s: time of the first pixel, seconds since the frame began.
        end_s: end of the last pixel, seconds since the frame began.
    """

    first_row: int
    end_row: int
    visit: int | None
    begin_s: float
    end_s: float


def row_passes(column: Column) -> tuple[RowPass, ...]:
    """All passes of a frame in the order of their end; the visits of a row are in order."""
    height, timing = column.scan.height_px, column.timing
    rows = max(_MIN_BAND_ROWS, math.ceil(_MIN_BAND_S / timing.row_time_s))
    bands = [(first, min(first + rows, height)) for first in range(0, height, rows)]
    if column.is_plain_raster:
        return tuple(RowPass(first, end, None, *column.rows_span_s(first, end)) for first, end in bands)
    starts_s = timing.row_start_s
    passes = [
        RowPass(first, end, visit, float(starts_s[visit, first:end].min()), float(starts_s[visit, first:end].max()) + timing.row_time_s)
        for first, end in bands
        for visit in range(column.visits)
    ]
    return tuple(sorted(passes, key=lambda row_pass: row_pass.end_s))


class Exposure:
    """A frame that is exposed pass by pass.

    The sum of all visits is that of `Column.expose`, so the image equals that of `render_frame` to the last bit.
    """

    def __init__(self, column: Column, frame: int, start_time_s: float) -> None:
        self._column = column
        self._frame = frame
        self._start_time_s = start_time_s
        shape = (column.scan.height_px, column.scan.width_px)
        self.image = np.empty(shape, dtype=column.detector.dtype)
        self._sum: NDArray[np.float64] | None = None if column.is_plain_raster else np.zeros(shape)

    def expose(self, row_pass: RowPass, motion: Motion) -> None:
        """Compute one pass; `motion` must cover its time."""
        rows, column = slice(row_pass.first_row, row_pass.end_row), self._column
        if self._sum is None or row_pass.visit is None:
            column.render_rows(self.image[rows], row_pass.first_row, self._start_time_s, motion, self._frame)
            return
        column.expose(self._sum[rows], row_pass.first_row, row_pass.visit, self._start_time_s, motion, self._frame)
        if row_pass.visit == column.visits - 1:
            column.digitise(self.image[rows], row_pass.first_row, self._sum[rows], self._frame)
