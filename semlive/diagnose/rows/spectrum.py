"""Spectrum of row shifts over physical frequency. Columns resolve frequencies that rows alone would alias."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.special import gammaincc

from semlive.diagnose.rows.series import DETREND_ROWS, RowSeries

Array = NDArray[np.float64]
MAX_FREQUENCY_HZ = 200.0
FREQUENCIES_PER_LINE_WIDTH = 3  # tested frequencies within the width of a spectral line
BINS_PER_LINE_WIDTH = 4  # minimum number of bins of the transform within the width of a line
MIN_AMPLITUDE_FRACTION = 0.12  # smallest fraction of a wave's amplitude that remains in a segment
MIN_CYCLES_PER_ROW = 1.5 / DETREND_ROWS  # slower waves are observed by the disparity maps
POWERS_PER_NOISE_LEVEL, MAX_NOISE_LEVELS = 200, 64  # minimum number of powers per noise estimate; maximum number of estimates
SIZES = 6
EXPONENTIAL_MEDIAN = float(np.log(2.0))


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """Spectral power of all pairs, in units of the noise.

    Attributes:
        frequency_hz: (m,) frequencies, Hz.
        power: (k, m) power of each pair along each axis; for noise alone exponentially distributed with mean 1.
        information: (k, m) 1 / variance of the sine and cosine amplitudes, px^-2.
    """

    frequency_hz: Array
    power: Array
    information: Array

    @property
    def total(self) -> Array:
        """(m,) power summed over pairs and axes; Gamma(k) distributed for noise alone."""
        return np.asarray(self.power.sum(axis=0))

    def p_value(self, frequency: int) -> float:
        """Probability of at least this power at any tested frequency without a wave (Bonferroni)."""
        own = float(gammaincc(len(self.power), float(self.total[frequency])))
        return min(1.0, own * len(self.frequency_hz))

    def log_factors(self, sizes_px: tuple[float, float]) -> Array:
        """(m,) log Bayes factor of a wave at each frequency, with independent phases and amplitudes in every pair."""
        each = []
        for size_px in np.geomspace(*sizes_px, SIZES):
            gain = self.information * size_px**2
            each.append(np.sum(self.power * gain / (1.0 + gain) - np.log1p(gain), axis=0))
        return np.asarray(np.logaddexp.reduce(each, axis=0) - np.log(SIZES))


def spectrum(series: Sequence[RowSeries], ratio: Array) -> Spectrum:
    """Spectrum of waves up to 200 Hz that row segments resolve and disparity maps do not.

    Args:
        series: row series of each pair; row times may differ.
        ratio: (pairs, 2) mean square of the row means in units of that by noise. White jitter would contribute at every frequency below
            the row frequency; it is scaled down to the noise.
    """
    longest_s = max(run_series.duration_s for run_series in series)
    candidates_hz = np.arange(1, int(MAX_FREQUENCY_HZ * FREQUENCIES_PER_LINE_WIDTH * longest_s)) / (FREQUENCIES_PER_LINE_WIDTH * longest_s)
    fit = np.all([_fits(run_series, candidates_hz) for run_series in series], axis=0)
    frequency_hz = candidates_hz[fit]
    power, information = [], []
    for run_series, ratio_of_pair in zip(series, np.maximum(ratio, 1.0), strict=True):
        for power_of_axis, weight in _powers(run_series, frequency_hz, ratio_of_pair):
            power.append(power_of_axis)
            information.append(weight)
    return Spectrum(frequency_hz, np.stack(power), np.stack(information))


def _fits(row_series: RowSeries, frequency_hz: Array) -> NDArray[np.bool_]:
    per_row = frequency_hz * row_series.row_time_s
    from_whole = np.abs(per_row - np.round(per_row))
    return np.asarray((row_series.observed_wave(frequency_hz) > MIN_AMPLITUDE_FRACTION) & (from_whole > MIN_CYCLES_PER_ROW), dtype=np.bool_)


def _powers(row_series: RowSeries, frequency_hz: Array, ratio: Array) -> Iterator[tuple[Array, Array]]:
    """Power in units of the noise, and information, along each axis."""
    weight, ratio = row_series.weight, ratio[:, None]
    size = 1 << int(np.ceil(np.log2(BINS_PER_LINE_WIDTH * len(row_series.row_px))))
    mean = np.sum(row_series.shift_px * weight, axis=2) / np.maximum(weight.sum(axis=2), 1e-30)
    rows = np.fft.fft((row_series.shift_px - ((1.0 - ratio**-0.5) * mean)[..., None]) * weight, size, axis=1)
    at = np.round(frequency_hz * row_series.row_time_s * size).astype(np.int64) % size
    total, of_mean = (np.zeros((2, len(frequency_hz)), dtype=np.complex128) for _ in range(2))
    phase_rate, each = -2j * np.pi * row_series.dwell_time_s * frequency_hz, weight.sum(axis=1)
    for piece, middle_px in enumerate(row_series.middle_px):
        phase_factor = np.exp(phase_rate * middle_px)
        for axis in (0, 1):
            total[axis] += rows[axis, at, piece] * phase_factor
            of_mean[axis] += each[axis, piece] * phase_factor
    observed, place = row_series.observed_wave(frequency_hz) ** 2, np.minimum(at, size - at).astype(np.float64)
    for axis in (0, 1):
        total_weight = float(each[axis].sum()) or 1.0
        power = np.abs(total[axis]) ** 2 / total_weight
        level = np.maximum(_level(power, place), 1e-12)
        damped = 1.0 - (1.0 - 1.0 / ratio[axis]) * np.abs(of_mean[axis] / total_weight) ** 2
        yield power / level, 0.5 * total_weight * damped * observed / level


def _level(power: Array, place: Array) -> Array:
    """Noise level at each power, from neighbouring alias frequencies, because interpolation between rows colours the noise."""
    order = np.argsort(place, kind="stable")
    groups = np.array_split(order, int(np.clip(len(power) // POWERS_PER_NOISE_LEVEL, 1, MAX_NOISE_LEVELS)))
    median = np.array([np.median(power[value]) for value in groups])
    middle = np.array([np.median(place[value]) for value in groups])
    return np.interp(place, middle, median) / EXPONENTIAL_MEDIAN


@dataclass(frozen=True, slots=True, eq=False)
class Wave:
    """An identified wave.

    Attributes:
        frequency_hz: frequency, Hz.
        sigma_hz: standard uncertainty of the frequency, Hz.
        amplitude: (pairs, 2) complex amplitude of each pair along x and y, second frame minus first, px.
        sigma_px: (pairs, 2) standard uncertainty of its sine and cosine, px.
        frames: (pairs,) number of frames whose wave power each pair contains, for random phases.
    """

    frequency_hz: float
    sigma_hz: float
    amplitude: NDArray[np.complex128]
    sigma_px: Array
    frames: Array

    def moved(self, pair: int, row_series: RowSeries) -> Array:
        """(2, n, s) shift of the segments of a pair by the wave, px."""
        turning = np.exp(1j * row_series.phase(self.frequency_hz)) * row_series.observed_wave(self.frequency_hz)
        return np.stack([(self.amplitude[pair, axis] * turning).real for axis in (0, 1)])


def refined(series: Sequence[RowSeries], spectrum_of_pairs: Spectrum, at: int) -> Wave:
    """Refine the wave at one frequency of a spectrum between the tested frequencies."""
    start = float(spectrum_of_pairs.frequency_hz[at])
    step = 1.0 / (FREQUENCIES_PER_LINE_WIDTH * max(run_series.duration_s for run_series in series))
    levels = _noise_of(series, spectrum_of_pairs, at)

    def loss(frequency_hz: float) -> float:
        return -_gain(series, frequency_hz, levels)

    best: Any = minimize_scalar(loss, bounds=(start - step, start + step), method="bounded", options={"xatol": 1e-3 * step})
    top, width = float(best.x), 0.2 * step
    curvature = (loss(top - width) + loss(top + width) - 2.0 * loss(top)) / width**2
    amplitude = np.stack([_amplitudes(run_series, top) for run_series in series])
    return Wave(top, float(1.0 / np.sqrt(curvature)) if curvature > 0.0 else step, amplitude, levels, _frames(series, top))


def fit_wave(series: Sequence[RowSeries], frequency_hz: float) -> Wave:
    """A wave of given frequency: amplitudes by least squares, with the uncertainty of the row registration."""
    amplitude = np.stack([_amplitudes(run_series, frequency_hz) for run_series in series])
    observed = np.array([max(float(run_series.observed_wave(frequency_hz)), 1e-6) for run_series in series])
    weight = np.stack([np.maximum(run_series.weight.sum(axis=(1, 2)), 1e-30) for run_series in series])
    return Wave(frequency_hz, 0.0, amplitude, np.sqrt(2.0 / weight) / observed[:, None], _frames(series, frequency_hz))


def _frames(series: Sequence[RowSeries], frequency_hz: float) -> Array:
    return np.array([run_series.frames(frequency_hz) for run_series in series])


def _noise_of(series: Sequence[RowSeries], spectrum_of_pairs: Spectrum, at: int) -> Array:
    return (1.0 / np.sqrt(spectrum_of_pairs.information[:, at])).reshape(len(series), 2)


def _gain(series: Sequence[RowSeries], frequency_hz: float, sigma_px: Array) -> float:
    """Gain in log likelihood by a wave of any amplitude."""
    amplitude = np.stack([_amplitudes(run_series, frequency_hz) for run_series in series])
    return float(np.sum(np.abs(amplitude) ** 2 / (2.0 * sigma_px**2)))


def _amplitudes(row_series: RowSeries, frequency_hz: float) -> NDArray[np.complex128]:
    """(2,) complex least-squares amplitudes along x and y, px."""
    turning = np.exp(-1j * row_series.phase(frequency_hz))
    observed = max(float(row_series.observed_wave(frequency_hz)), 1e-6)
    weight = np.maximum(row_series.weight.sum(axis=(1, 2)), 1e-30)
    return np.asarray(2.0 * np.einsum("ans,ns->a", row_series.shift_px * row_series.weight, turning) / (weight * observed))


def matching_frequencies(spectrum_of_pairs: Spectrum, owns: Callable[[Array], NDArray[np.bool_]]) -> NDArray[np.int64]:
    """Indices of the frequencies of an effect class."""
    return np.flatnonzero(owns(spectrum_of_pairs.frequency_hz))
