"""Time series of limited length for display."""

from __future__ import annotations

from dataclasses import dataclass, replace

MAX_ROWS = 1500
_FIRST_WIDTH_S = 0.1


@dataclass(frozen=True, slots=True)
class LoadRow:
    """Readings of the load frame within a short interval.

    Attributes:
        time_s: time of the last reading, seconds after the start of the run.
        low_n: smallest force.
        high_n: largest force.
        extension_mm: last extension.
        target_n: last target.
    """

    time_s: float
    low_n: float
    high_n: float
    extension_mm: float
    target_n: float


@dataclass(frozen=True, slots=True)
class DownsampledSeries:
    """Rows of equal duration; if there are too many, neighbours are merged and the duration doubles.

    Attributes:
        width_s: duration of a row, s.
        rows: complete rows.
        current_bin: the row to which readings are added.
    """

    width_s: float = _FIRST_WIDTH_S
    rows: tuple[LoadRow, ...] = ()
    current_bin: LoadRow | None = None


def append(trace: DownsampledSeries, row: LoadRow) -> DownsampledSeries:
    """Return the series with one more reading."""
    if trace.current_bin is None:
        return replace(trace, current_bin=row)
    if int(row.time_s / trace.width_s) == int(trace.current_bin.time_s / trace.width_s):
        return replace(trace, current_bin=_joined(trace.current_bin, row))
    rows = (*trace.rows, trace.current_bin)
    if len(rows) <= MAX_ROWS:
        return replace(trace, rows=rows, current_bin=row)
    width_s = 2.0 * trace.width_s
    wider: list[LoadRow] = []
    for each in rows:
        if wider and int(each.time_s / width_s) == int(wider[-1].time_s / width_s):
            wider[-1] = _joined(wider[-1], each)
        else:
            wider.append(each)
    return DownsampledSeries(width_s, tuple(wider), row)


def _joined(first: LoadRow, second: LoadRow) -> LoadRow:
    return replace(second, low_n=min(first.low_n, second.low_n), high_n=max(first.high_n, second.high_n))
