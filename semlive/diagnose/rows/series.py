"""Row series for tests: row shifts without components slower than a subset and with outliers clipped."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from semlive.data.disparity import RowShifts

Array = NDArray[np.float64]
DETREND_ROWS = 43  # slower changes are observed by the disparity maps
CLIP = 4.5


@dataclass(frozen=True, slots=True, eq=False)
class RowSeries:
    """Row shifts of one pair in segments, along x and along y.

    Attributes:
        shift_px: (2, n, s) shift of the second frame relative to the first, px; zero without data.
        weight: (2, n, s) 1 / variance from registration, px^-2; zero without data.
        row_px: (n,) rows, px.
        middle_px: (s,) centre columns of the segments, px.
        width_px: width of a segment, px.
        row_time_s: time from row to row, s.
        dwell_time_s: time from column to column, s.
        interpolation_gain: fraction of the white jitter of the second frame that remains after interpolation between rows.
        subrow_position: (n,) interpolation position of the second frame between its rows, 0 to 1; None: on the rows.
    """

    shift_px: Array
    weight: Array
    row_px: Array
    middle_px: Array
    width_px: float
    row_time_s: float
    dwell_time_s: float
    interpolation_gain: float
    subrow_position: Array | None = None

    @property
    def duration_s(self) -> float:
        """Time from the first row to the last, s."""
        return float(np.ptp(self.row_px)) * self.row_time_s

    def phase(self, frequency_hz: float) -> Array:
        """(n, s) phase of a wave at each segment, radians."""
        time_s = self.row_px[:, None] * self.row_time_s + self.middle_px * self.dwell_time_s
        return 2.0 * np.pi * frequency_hz * time_s

    def observed_wave(self, frequency_hz: Array | float) -> Array:
        """Fraction of the amplitude of a wave that remains in the average over a segment."""
        return np.abs(np.sinc(np.asarray(frequency_hz) * self.width_px * self.dwell_time_s))

    def frames(self, frequency_hz: float) -> float:
        """Number of frames whose wave power a pair contains, for random phases: 1 plus the fraction passed by interpolation."""
        if self.subrow_position is None:
            return 2.0
        return 1.0 + float(np.mean(interpolated(frequency_hz * self.row_time_s, self.subrow_position) ** 2))

    def without(self, shift_px: Array) -> RowSeries:
        """The series minus shifts (2, n, s), where it has data."""
        return replace(self, shift_px=np.where(self.weight > 0.0, self.shift_px - shift_px, 0.0))

    def pieces(self, which: Iterable[int]) -> RowSeries:
        """The series restricted to some segments."""
        at = np.array(list(which))
        return replace(self, shift_px=self.shift_px[..., at], weight=self.weight[..., at], middle_px=self.middle_px[at])


def row_series(shifts: RowShifts, row_time_s: float, dwell_time_s: float) -> RowSeries:
    """Row series from row registration.

    Args:
        shifts: shifts of segments narrower than the waves of interest.
        row_time_s: time from row to row, s.
        dwell_time_s: time from column to column, s.
    """
    edges = shifts.edges_px.astype(np.float64)
    valid = shifts.segment_valid
    axes = []
    for value, sigma in ((shifts.segment_u_px, shifts.segment_sigma_u_px), (shifts.segment_v_px, shifts.segment_sigma_v_px)):
        weight = np.where(valid & (sigma > 0.0), 1.0 / np.where(sigma > 0.0, sigma, 1.0) ** 2, 0.0)
        axes.append((_fast(np.where(weight > 0.0, value, 0.0), weight), weight))
    return RowSeries(
        np.stack([value for value, _ in axes]),
        np.stack([weight for _, weight in axes]),
        shifts.row_px.astype(np.float64),
        0.5 * (edges[:-1] + edges[1:] - 1.0),
        float(np.mean(np.diff(edges))),
        row_time_s,
        dwell_time_s,
        shifts.interpolation_noise_gain,
        (shifts.current_row_px % 1.0)[shifts.valid] if shifts.valid.any() else None,
    )


def interpolated(per_row: float, between: Array) -> Array:
    """Amplitude ratio of a wave after cubic B-spline interpolation between rows, for a frequency in cycles per row; 1 on a row.

    The attenuation is largest near half a cycle per row. Without it a vibration of 23.7 Hz at a row time of 0.107 s was estimated a fifth
    too small.
    """
    return np.abs(interpolated_wave(per_row, between))


def interpolated_wave(per_row: Array | float, between: Array) -> NDArray[np.complex128]:
    """Complex amplitude of a wave after cubic B-spline interpolation between rows, relative to that on the row before.

    Args:
        per_row: frequencies, cycles per row.
        between: positions between the rows, 0 to 1.
    """
    t = np.asarray(between, dtype=np.float64)
    before, after = 1.0 - t, t
    weights = (before**3, 4.0 - 6.0 * t**2 + 3.0 * t**3, 4.0 - 6.0 * before**2 + 3.0 * before**3, after**3)
    angle = 2.0 * np.pi * np.asarray(per_row)
    total = sum(weight * np.exp(1j * angle * place) for place, weight in zip((-1.0, 0.0, 1.0, 2.0), weights, strict=True))
    return np.asarray(total / (4.0 + 2.0 * np.cos(angle)), dtype=np.complex128)


def _fast(value: Array, weight: Array) -> Array:
    """(n, s) values minus their weighted running mean along the rows, clipped to the range of noise."""
    mean = uniform_filter1d(value * weight, DETREND_ROWS, axis=0, mode="nearest")
    size = uniform_filter1d(weight, DETREND_ROWS, axis=0, mode="nearest")
    fast = np.where(weight > 0.0, value - mean / np.where(size > 0.0, size, 1.0), 0.0)
    scaled = fast * np.sqrt(weight)
    inside = np.abs(scaled[weight > 0.0])
    limit = CLIP * 1.4826 * float(np.median(inside)) if inside.size else 0.0
    return np.clip(scaled, -limit, limit) / np.sqrt(np.where(weight > 0.0, weight, 1.0))
