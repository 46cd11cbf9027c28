"""Test for lines in the spectrum over the field: waves over the maps that no baseline and no noise has.

A wave over the field that moves from frame to frame is rougher than the fields of the other tests, so it counted as noise: the noise, and
the size of the subsets that an import estimates from it, were several times too large, and every test passed. The spectrum of noise is
smooth, whatever its window, and that of a step, a spot or a slip band falls with the wavenumber. So a line is a power that exceeds the
largest one on a ring around it, summed over the frames.

Measured with logs of an independent generator: 47 runs without an effect, with one of the catalogue or with an unlisted field at most 2.8
times, waves of 0.05 to 0.1 px over 220 to 400 px 18 to 610 times.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.ndimage import maximum_filter
from scipy.special import gammaincc

from semlive.data.diagnosis.effects import DomainTest
from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.map_residuals import fitted_px, over_grid_px
from semlive.diagnose.baseline.observation import Observation

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
SPATIAL_LINES = "spatial_lines"
MIN_POINTS_PER_SIDE = 16  # of the grid: a ring needs this many wavenumbers
PADDING = 2  # wavenumbers per cycle over the field
MIN_CYCLES, MIN_CYCLES_OVER_COLUMNS = 2.0, 1.0  # slower waves resemble trends; drift within a frame is a function of the row alone
RING_CYCLES = (2.5, 3.6)  # beyond the width of a line, 2 cycles with the window of Hann
MIN_PROMINENCE = 5.0  # power of a line relative to the largest on its ring
MIN_LINE_PX = 2e-3  # root mean square: twice the own bias of the correlation
MODELLED_WIDTH_CYCLES = 1.5  # distance from an identified wave
TREND_ORDER, CLIP = 1, 4.5


def spatial_line_test(baseline: HyperparameterGrid, modelled_hz: Sequence[float] = ()) -> DomainTest:
    """Test the residual of all points of the maps for waves over the field.

    Args:
        baseline: a baseline, with the effects found so far.
        modelled_hz: frequencies of identified waves of the beam, which may have lines.
    """
    observation = baseline.design.observation
    nothing = DomainTest(SPATIAL_LINES, 1.0, 0.0)
    if min(observation.grid.shape) < MIN_POINTS_PER_SIDE:
        return nothing
    spectrum = _spectrum(_residuals(baseline))
    if spectrum is None:
        return nothing
    cycles_y, cycles_x = _wavenumbers(observation.grid.shape)
    cycles = np.hypot(cycles_y, cycles_x)
    tested = (cycles >= MIN_CYCLES) & (cycles_x >= MIN_CYCLES_OVER_COLUMNS)
    tested &= (np.abs(cycles_y) < cycles_y.max() - 1.0) & (cycles_x < cycles_x.max() - 1.0)
    for along_y, along_x in _modelled_lines(observation, modelled_hz):
        tested &= np.hypot(cycles_y - along_y, cycles_x - along_x) > MODELLED_WIDTH_CYCLES
    ring = np.stack([maximum_filter(power, footprint=_ring(), mode="wrap") for power in spectrum.in_noise])
    prominence = np.where(tested & (spectrum.mean_square_px2 > MIN_LINE_PX**2), spectrum.in_noise / ring, 0.0)
    largest, size_px = float(prominence.max()), float(np.sqrt(spectrum.mean_square_px2.flat[np.argmax(prominence)]))
    if largest < MIN_PROMINENCE:
        return nothing
    # The power of n pairs of noise has a gamma distribution. Frames of a pair may share noise, and the ring has a mean below its maximum.
    pairs = len(observation.steps)
    p_value = 2.0 * float(tested.sum()) / PADDING**2 * float(gammaincc(pairs, pairs * largest))
    return DomainTest(SPATIAL_LINES, min(1.0, p_value), size_px)


@dataclass(frozen=True, slots=True, eq=False)
class _Spectrum:
    """Power over the wavenumbers of `_wavenumbers`, along x and along y, mean over the frames.

    Attributes:
        in_noise: (2, k, l) power in units of the median of each frame.
        mean_square_px2: (2, k, l) mean square of a wave with this power, px^2.
    """

    in_noise: Array
    mean_square_px2: Array


@dataclass(frozen=True, slots=True, eq=False)
class _Residuals:
    """Residual of all points in each frame, without the noise of frame 0.

    Attributes:
        values_px: (f, 2, n, m) residual along x and along y, px; 0 where a point is not valid.
        valid: (f, n, m) valid points.
        fitted_px: (f, 2, n, m) displacement from frame 0 by the baseline, px.
    """

    values_px: Array
    valid: Mask
    fitted_px: Array


def _residuals(baseline: HyperparameterGrid) -> _Residuals:
    observation, in_blocks = baseline.design.observation, fitted_px(baseline)
    shape = observation.grid.shape
    values, fitted = np.zeros((2, observation.frames, 2, *shape))
    valid = np.ones((observation.frames, *shape), dtype=np.bool_)
    for frame, rows in enumerate(observation.rows, start=1):
        valid[frame] = rows.dmap.valid
        fitted[frame] = over_grid_px(observation, rows.position_px[observation.valid_blocks], in_blocks[frame] - in_blocks[0])
        values[frame] = np.where(valid[frame], np.stack((rows.dmap.u_px, rows.dmap.v_px)) - fitted[frame], 0.0)
    values -= values.sum(axis=0) / np.maximum(valid.sum(axis=0), 1)
    return _Residuals(values * valid[:, None], valid, fitted)


def _spectrum(residuals: _Residuals) -> _Spectrum | None:
    """Spectrum of residuals; None where a frame has no noise."""
    total, squares, frames = 0.0, 0.0, len(residuals.valid)
    for values, points, fitted in zip(residuals.values_px, residuals.valid, residuals.fitted_px, strict=True):
        power = _power(values, points, fitted)
        level = np.median(power, axis=(1, 2), keepdims=True)
        if not level.min() > 0.0:
            return None
        total, squares = total + power / level, squares + power
    return _Spectrum(np.asarray(total) / frames, np.asarray(squares) / frames)


def _power(values: Array, valid: Mask, fitted: Array) -> Array:
    """(2, k, l) mean square of waves in one frame (2, n, m) without what is constant along rows, trends and the own bias, px^2.

    The bias of the correlation is a wave over the fraction of a pixel, which a strain of 1 % turns into one over 100 px of the field.
    """
    n, m = valid.shape
    y, x = np.meshgrid(np.linspace(-1.0, 1.0, n), np.linspace(-1.0, 1.0, m), indexing="ij")
    polynomials = np.polynomial.legendre.legvander2d(x[valid], y[valid], (TREND_ORDER, TREND_ORDER))
    window = np.outer(np.hanning(n + 2)[1:-1], np.hanning(m + 2)[1:-1]) * valid
    count = np.maximum(valid.sum(axis=1, keepdims=True), 1)
    powers = []
    for value, displacement in zip(values, fitted, strict=True):
        turns = 2.0 * np.pi * displacement[valid]
        trends = np.linalg.qr(np.column_stack((polynomials, np.sin(turns), np.cos(turns))))[0]
        plain = value[valid] - trends @ (trends.T @ value[valid])
        limit = CLIP * 1.4826 * float(np.median(np.abs(plain)))
        field = np.zeros((n, m))
        field[valid] = np.clip(plain, -limit, limit)
        field = np.where(valid, field - field.sum(axis=1, keepdims=True) / count, 0.0)
        powers.append(np.abs(np.asarray(fft.fft2(field * window, (PADDING * n, PADDING * m)), dtype=np.complex128)) ** 2)
    return 2.0 * np.stack(powers) / float(window.sum()) ** 2


def _wavenumbers(shape: tuple[int, int]) -> tuple[Array, Array]:
    """(k, l) cycles over the field along y and along x, of the spectrum of a padded field (n, m)."""
    cycles_y, cycles_x = (np.asarray(fft.fftfreq(PADDING * count, 1.0 / count), dtype=np.float64) for count in shape)
    y, x = np.meshgrid(cycles_y, cycles_x, indexing="ij")
    return y, x


def _ring() -> Mask:
    """Footprint of the ring around a wavenumber."""
    reach = int(np.ceil(PADDING * RING_CYCLES[1]))
    away = np.hypot(*np.mgrid[-reach : reach + 1, -reach : reach + 1]) / PADDING
    return np.asarray((away >= RING_CYCLES[0]) & (away <= RING_CYCLES[1]))


def _modelled_lines(observation: Observation, modelled_hz: Sequence[float]) -> Iterator[tuple[float, float]]:
    """Cycles along y and x of identified waves, with both signs; the phase advances from row to row and along a row."""
    timing = observation.state.frame_time(0).timing
    rows, columns = observation.grid.shape
    for frequency_hz in modelled_hz:
        per_row = frequency_hz * timing.row_time_s.value
        per_px = per_row - round(per_row), frequency_hz * timing.dwell_time_s.value
        cycles = tuple(value * count * observation.grid.step_px for value, count in zip(per_px, (rows, columns), strict=True))
        yield cycles[0], cycles[1]
        yield -cycles[0], -cycles[1]
