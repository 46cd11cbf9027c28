"""Amplitudes of waves of the rows in the maps within pairs, whose subsets average them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap
from semlive.diagnose.rows.spectrum import MAX_FREQUENCY_HZ, MIN_CYCLES_PER_ROW
from semlive.qualify.figures.noise import detrended, trend_columns

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
MIN_CYCLES = 1.0
"""Fewest cycles over a map. Fewer than three that are equal in all columns are drift, because polynomials follow them."""
MIN_REMAINING = 0.25
"""Smallest remaining amplitude in the mean over a subset: with 21 px, 0.038 cycles per row; the rows show faster waves than 0.035."""
DRIFT_ORDER = 6
"""Order of the polynomial of the row that drift may follow: the remainder of a cubic resembles two cycles, and drift that decays within a
frame was 11 times of 15 a vibration of this length.
"""
PER_CYCLE = 3
"""Tested frequencies per cycle over a map."""
TAPERED = 0.25
"""Share of the points at each edge whose weight is smaller: slow noise leaks less into fast waves."""


@dataclass(frozen=True, slots=True, eq=False)
class MapSampling:
    """How the points of a map sample a wave.

    Attributes:
        row_px: (n,) rows of the points, px.
        column_px: (m,) columns of the points, px.
        subset_px: edge of the subsets, px.
        row_s: time from row to row, s.
        dwell_s: time from column to column, s.
    """

    row_px: Array
    column_px: Array
    subset_px: int
    row_s: float
    dwell_s: float

    @property
    def cycle_hz(self) -> float:
        """A cycle over the rows of the points, Hz."""
        return 1.0 / (float(np.ptp(self.row_px)) * self.row_s)

    def slow(self, frequency_hz: Array) -> Array:
        """Cycles per row with which the rows sample a wave."""
        return np.asarray(frequency_hz * self.row_s - np.round(frequency_hz * self.row_s))

    def remaining(self, frequency_hz: Array, subset_px: int) -> Array:
        """Fraction of the amplitude of a wave that remains in the mean over a subset."""
        return np.asarray(np.abs(np.sinc(self.slow(frequency_hz) * subset_px) * np.sinc(frequency_hz * self.dwell_s * subset_px)))

    def tested_hz(self) -> Array:
        """(f,) frequencies of the waves that the maps resolve, Hz."""
        step_hz = self.cycle_hz / PER_CYCLE
        frequency_hz = step_hz * np.arange(1.0, MAX_FREQUENCY_HZ / step_hz)
        slow, spacing_px = self.slow(frequency_hz), float(np.diff(self.row_px).max())
        cycles = np.hypot(slow * np.ptp(self.row_px), frequency_hz * self.dwell_s * np.ptp(self.column_px))
        resolved = (np.abs(slow) <= min(MIN_CYCLES_PER_ROW, 0.5 / spacing_px)) & (
            self.remaining(frequency_hz, self.subset_px) >= MIN_REMAINING
        )
        return np.asarray(frequency_hz[resolved & (cycles >= MIN_CYCLES)])

    def amplitudes(self, one: StillMap, frequency_hz: Array) -> Complex:
        """(2, f) amplitudes of the motion of the rows along x and y by waves of (f,) frequencies, Hz, from a map, px."""
        weight = np.outer(_taper(len(self.row_px)), _taper(len(self.column_px))) * one.valid
        over_rows = np.exp(-2j * np.pi * np.outer(self.row_px, self.slow(frequency_hz)))
        over_columns = np.exp(-2j * np.pi * np.outer(self.column_px, frequency_hz * self.dwell_s))
        total = np.stack([np.sum(((field * weight).T @ over_rows) * over_columns, axis=0) for field in one.fields_px])
        return np.asarray(2.0 * total / weight.sum() / self.remaining(frequency_hz, self.subset_px))

    def fitted(self, one: StillMap, frequency_hz: float) -> tuple[Complex, float]:
        """Least squares of a wave together with the drift.

        Args:
            one: a map.
            frequency_hz: frequency, Hz.

        Returns:
            (2,) amplitudes of the motion of the rows along x and y, px, and the variance of both components that the wave explains, px^2.
        """
        at, values = np.array(frequency_hz), one.fields_px[:, one.valid].T
        phase = 2.0 * np.pi * np.add.outer(self.slow(at) * self.row_px, at * self.dwell_s * self.column_px)[one.valid]
        columns = np.column_stack((np.cos(phase), np.sin(phase)))
        columns -= one.drift @ (one.drift.T @ columns)
        right = columns.T @ values
        found = np.linalg.solve(columns.T @ columns, right)
        return np.asarray((found[0] - 1j * found[1]) / self.remaining(at, self.subset_px)), float(np.sum(found * right)) / len(values)


@dataclass(frozen=True, slots=True, eq=False)
class StillMap:
    """A map within a pair without drift.

    Attributes:
        fields_px: (2, n, m) displacement along x and y, outliers clipped, px; zero without data.
        valid: (n, m) points with data, p of them.
        drift: (p, k) orthonormal functions that drift may follow at these points.
    """

    fields_px: Array
    valid: NDArray[np.bool_]
    drift: Array

    @classmethod
    def of(cls, disparity: DisparityMap) -> StillMap | None:
        """A map without its trend and without further polynomials of the row; None for too few points."""
        fields, valid = detrended(disparity), disparity.valid
        if fields is None:
            return None
        y = disparity.grid.mesh()[1][valid]
        place = 2.0 * (y - y.min()) / max(float(np.ptp(y)), 1.0) - 1.0
        drift = np.linalg.qr(np.column_stack((trend_columns(disparity), legendre.legvander(place, DRIFT_ORDER)[:, 4:])))[0]
        still = np.stack(fields)
        still[:, valid] -= (drift @ (drift.T @ still[:, valid].T)).T
        return cls(still, valid, drift)


def _taper(count: int) -> Array:
    """(count,) weights, 1 in the middle half, smaller towards the ends."""
    place = (np.arange(count) + 0.5) / count
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.minimum(np.minimum(place, 1.0 - place) / TAPERED, 1.0)))
