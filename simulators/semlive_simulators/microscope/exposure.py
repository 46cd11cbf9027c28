"""The work of a frame in pieces, each to be done when its own time has passed: a band of rows on one visit."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive_simulators.microscope.column import Column
from semlive_simulators.specimen.specimen import Motion

_BAND_ROWS = 16
"""Fewest rows rendered at a time: 1.7 s of experiment time at x200, 1 ms of work."""
_BAND_S = 0.3
"""A band of a quick scan lasts at least this long, experiment time: at x10,000 that is 56 rows, in which a band's fixed cost is lost."""


@dataclass(frozen=True, slots=True)
class RowPass:
    """Rows on one visit, or on all at once.

    Attributes:
        first_row: number of the first row.
        end_row: number of the row after the last.
        visit: number of the visit; None renders rows that are visited once in one go.
        begin_s: when the first of these pixels is visited, seconds since the frame began.
        end_s: when the last is done.
    """

    first_row: int
    end_row: int
    visit: int | None
    begin_s: float
    end_s: float


def row_passes(column: Column) -> tuple[RowPass, ...]:
    """All the work of a frame in the order in which it falls due; a row's visits come in order."""
    height, timing = column.scan.height_px, column.timing
    rows = max(_BAND_ROWS, math.ceil(_BAND_S / timing.row_time_s))
    bands = [(first, min(first + rows, height)) for first in range(0, height, rows)]
    if column.is_plain_raster:
        return tuple(RowPass(first, end, None, *column.rows_span_s(first, end)) for first, end in bands)
    starts_s = timing.row_start_s
    found = [
        RowPass(first, end, visit, float(starts_s[visit, first:end].min()), float(starts_s[visit, first:end].max()) + timing.row_time_s)
        for first, end in bands
        for visit in range(column.visits)
    ]
    return tuple(sorted(found, key=lambda one: one.end_s))


class Exposure:
    """A frame that comes into being pass by pass.

    The sum of all visits is kept as it is in `Column.expose`, so the finished image is that of `render_frame` to the last bit.
    """

    def __init__(self, column: Column, frame: int, start_time_s: float) -> None:
        self._column = column
        self._frame = frame
        self._start_time_s = start_time_s
        shape = (column.scan.height_px, column.scan.width_px)
        self.image = np.empty(shape, dtype=column.detector.dtype)
        self._sum: NDArray[np.float64] | None = None if column.is_plain_raster else np.zeros(shape)

    def expose(self, one: RowPass, motion: Motion) -> None:
        """Do one pass; `motion` must cover its time."""
        rows, column = slice(one.first_row, one.end_row), self._column
        if self._sum is None or one.visit is None:
            column.render_rows(self.image[rows], one.first_row, self._start_time_s, motion, self._frame)
            return
        column.expose(self._sum[rows], one.first_row, one.visit, self._start_time_s, motion, self._frame)
        if one.visit == column.visits - 1:
            column.digitise(self.image[rows], one.first_row, self._sum[rows], self._frame)
