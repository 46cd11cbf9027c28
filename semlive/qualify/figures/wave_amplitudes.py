"""Amplitudes of waves of the rows, from the amplitude of the difference of both frames of each pair."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from semlive.data.diagnosis.effects import IdentifiedEffect, ParameterEstimate
from semlive.data.scan import ScanTiming
from semlive.data.settings import DicSettings
from semlive.diagnose.rows.spectrum import Wave, fit_wave
from semlive.qualify.figures.intervals import TAILS, Interval, quantiles
from semlive.qualify.figures.row_response import MIN_AMPLITUDE_PX, Pattern, measure_response
from semlive.qualify.figures.waves import RowPairs, is_wave, waves_of

Array = NDArray[np.float64]
DRAWS, FREQUENCIES = 4000, 400
RESPONSES, MAX_CHANGE, MIN_SIZES, MAX_RATIO = 4, 0.02, 3, 0.7
"""Measurements of the response, each with the amplitude by the last one; relative change below which they end; number of amplitudes from
which their limit is extrapolated, and largest ratio of two changes for it.
"""
SCATTERS = (0.02, 0.04, 0.08)
"""Relative scatter of the differences of the pairs of a wave that continues from frame to frame, all equally likely: it changes with the
pattern under the rows.
"""
AMPLITUDE_ERROR = 0.02
"""Relative standard uncertainty of an amplitude that is known by its phase: 0.21 px along y were measured 2.6 % too small."""
RESPONSE_ERROR = 0.1
"""Standard uncertainty of a correction for the response of the registration, relative to the correction."""
AMPLITUDES, PHASES, LARGEST_RATIO, MIN_SIGMA_SHARE = 200, 256, 3.0, 0.02
"""Amplitudes of a wave with independent phases, phases over half a turn, largest amplitude relative to the largest difference, and smallest
standard uncertainty relative to it: differences of neighbouring phases are 0.037 of it or less.
"""
MIN_FACTOR, MIN_SIZE_PX = 1e-3, 1e-9
"""Smallest factor from an amplitude to a difference, where both frames have the same phase, and size, of a pair without data."""
NOT_EXCLUDED = 0.147
"""Likelihood of no wave, relative to the largest, above which a 95 % interval contains 0: exp(-1.96^2 / 2)."""


@dataclass(frozen=True, slots=True, eq=False)
class _Differences:
    """Amplitudes of the differences of both frames.

    Attributes:
        size: (k, 2) amplitude of each pair along x and y, px.
        sigma: (k, 2) standard uncertainty of its sine and cosine, px.
        frames: (k,) number of frames whose wave power each pair contains.
        relative_sigma: (2,) standard uncertainty common to all pairs, relative.
    """

    size: Array
    sigma: Array
    frames: Array
    relative_sigma: Array

    @property
    def stronger(self) -> int:
        """The axis with the larger amplitude."""
        return int(np.argmax(self.size.mean(axis=0)))


def amplitude_interval(axis: int, frequency: ParameterEstimate, pairs: RowPairs, in_maps: Wave | None = None) -> Interval:
    """Amplitude of a wave along one axis with its 95 % interval.

    A wave that continues from frame to frame has almost the same phase difference in all pairs, from which nothing but the interval of the
    frames determines its amplitude; without it the stated 0.15 to 0.31 px did not contain a hum of 0.5 px. The phases of other waves are
    independent. The interval is that of both possibilities, each with its probability.

    Args:
        axis: 0 along x, 1 along y.
        frequency: of the wave, Hz.
        pairs: rows of the pairs.
        in_maps: the wave in the maps within the pairs; None for that in their rows.
    """
    found = _differences(frequency, pairs, in_maps)
    independent = _independent(found, axis)
    if not np.all(pairs.interval_s > 0.0):
        return independent.interval()
    rng = np.random.default_rng(5)
    sigma_hz = pairs.frequency_sigma_hz(frequency) if in_maps is None else frequency.sigma
    frequencies = frequency.value + sigma_hz * rng.standard_normal(FREQUENCIES)
    factors = np.maximum([_factor(pairs.turns(one), found.frames) for one in frequencies], MIN_FACTOR)
    log_evidence = _coherent_log_evidence(found, factors)
    odds = float(np.logaddexp.reduce(log_evidence)) - np.log(FREQUENCIES) - _independent(found, found.stronger).log_evidence
    count = round(DRAWS * float(special.expit(odds)))
    which = rng.choice(FREQUENCIES, count, p=special.softmax(log_evidence))
    value, low, high = quantiles(np.concatenate((_coherent(found, axis, factors[which], rng), independent.drawn(DRAWS - count, rng))))
    return value, 0.0 if independent.contains_zero else low, high


def _differences(frequency: ParameterEstimate, pairs: RowPairs, in_maps: Wave | None) -> _Differences:
    wave = in_maps or fit_wave(pairs.series, frequency.value)
    response = pairs.response if in_maps is None else None
    size, gain, sigma = np.abs(wave.amplitude), np.ones(2), np.zeros(2)
    if response is not None and response.is_of(frequency.value):
        gain = response.gain(size, wave.frames)
        sigma = np.hypot(response.sigma, RESPONSE_ERROR * np.max(np.abs(1.0 - gain), axis=0))
    return _Differences(np.maximum(size / gain, MIN_SIZE_PX), wave.sigma_px / gain, wave.frames, np.hypot(sigma, AMPLITUDE_ERROR))


def with_response(
    pairs: RowPairs, effects: Sequence[IdentifiedEffect], pattern: Pattern, timing: ScanTiming, settings: DicSettings
) -> RowPairs:
    """The rows of the pairs with the response of the registration to the strongest wave, if there is one.

    Args:
        pairs: rows of the pairs.
        effects: effects of the rows.
        pattern: of the first frame.
        timing: times of its scan.
        settings: correlation of the pairs.
    """
    waves = [wave for effect in effects if is_wave(effect) for wave in waves_of(effect)]
    if not waves:
        return pairs
    pairs = replace(pairs, pattern=pattern)
    strongest = max(waves, key=lambda wave: wave.size_px).frequency
    others_hz = [wave.frequency.value for wave in waves if wave.frequency is not strongest]
    registered, sizes = fit_wave(pairs.series, strongest.value), list[Array]()
    for _ in range(RESPONSES):
        sizes.append(_sizes_px(strongest, pairs))
        wave_px = _limit_px(sizes)
        response = measure_response(pattern, timing, settings, registered, wave_px, pairs.moved_px, others_hz)
        if response is None:
            return pairs
        changed = np.inf if pairs.response is None else np.abs(wave_px - pairs.response.wave_px).max() / wave_px.max()
        pairs = replace(pairs, response=response)
        if wave_px.max() < MIN_AMPLITUDE_PX or changed < MAX_CHANGE:
            break
    return pairs


def _limit_px(sizes: Sequence[Array]) -> Array:
    """Limit of amplitudes that converge, by the last three (Aitken)."""
    if len(sizes) < MIN_SIZES:
        return sizes[-1]
    before, last = sizes[-2] - sizes[-3], sizes[-1] - sizes[-2]
    ratio = np.clip(np.sum(before * last) / max(float(np.sum(before**2)), 1e-12), 0.0, MAX_RATIO)
    return sizes[-1] + last * ratio / (1.0 - ratio)


def _sizes_px(frequency: ParameterEstimate, pairs: RowPairs) -> Array:
    return np.maximum([amplitude_interval(axis, frequency, pairs)[0] for axis in (0, 1)], 1e-4)


@dataclass(frozen=True, slots=True, eq=False)
class _Posterior:
    """Amplitudes with equal distances, and the log likelihood of each."""

    amplitude: Array
    log_likelihood: Array

    @property
    def weight(self) -> Array:
        """Probability of each amplitude."""
        return np.asarray(special.softmax(self.log_likelihood))

    @property
    def contains_zero(self) -> bool:
        """Whether no wave is not excluded."""
        return bool(self.log_likelihood[0] - self.log_likelihood.max() > np.log(NOT_EXCLUDED))

    @property
    def log_evidence(self) -> float:
        """Log likelihood of any amplitude, equally likely in the logarithm."""
        return float(np.logaddexp.reduce(self.log_likelihood[1:] - np.log(self.amplitude[1:]))) + float(np.log(self.amplitude[1]))

    def drawn(self, count: int, rng: np.random.Generator) -> Array:
        """Random amplitudes."""
        below = np.concatenate(((0.0,), np.cumsum(self.weight)))[:-1]
        return np.interp(rng.uniform(size=count), below + 0.5 * self.weight, self.amplitude)

    def interval(self) -> Interval:
        """Median with the 95 % interval."""
        value, low, high = (float(np.interp(share, np.cumsum(self.weight), self.amplitude)) for share in (0.5, *TAILS))
        return value, 0.0 if self.contains_zero else low, high


def _independent(found: _Differences, axis: int) -> _Posterior:
    """Amplitude of a wave with independent phases.

    The size of a difference is the amplitude times a factor of 0 to 2 that follows from the phase difference, which is uniform, with noise.
    Sizes close to the largest possible one are frequent, so that the largest size determines the amplitude better than their mean does: a
    vibration of 0.61 px was stated as 0.36 to 0.57 px from the mean square of nine pairs.
    """
    size = found.size[:, axis]
    sigma = np.maximum(np.hypot(found.sigma[:, axis], found.relative_sigma[axis] * size), MIN_SIGMA_SHARE * size.max())
    amplitude = np.linspace(0.0, LARGEST_RATIO * float(size.max()), AMPLITUDES)
    turns = (np.arange(PHASES) + 0.5) / (2.0 * PHASES)
    factors = np.stack([_factor(np.full(len(size), turn), found.frames) for turn in turns])
    log_density = _log_density(size, amplitude[:, None, None] * factors, sigma)  # (amplitudes, phases, pairs)
    return _Posterior(amplitude, (special.logsumexp(log_density, axis=1) - np.log(PHASES)).sum(axis=1))


def _coherent_log_evidence(found: _Differences, factors: Array) -> Array:
    """(f,) log likelihood of any amplitude, equally likely in the logarithm, of a wave that continues, for factors (f, k), by Laplace."""
    size, noise, by_scatter = found.size[:, found.stronger], found.sigma[:, found.stronger], []
    for scatter in SCATTERS:
        sigma = np.hypot(noise, scatter * size)
        information = np.sum((factors / sigma) ** 2, axis=1)
        amplitude = np.sum(factors * size / sigma**2, axis=1) / information
        log_likelihood = _log_density(size, amplitude[:, None] * factors, sigma).sum(axis=1)
        by_scatter.append(log_likelihood + 0.5 * np.log(2.0 * np.pi / information) - np.log(amplitude))
    return np.asarray(special.logsumexp(by_scatter, axis=0) - np.log(len(SCATTERS)))


def _coherent(found: _Differences, axis: int, factors: Array, rng: np.random.Generator) -> Array:
    """Random amplitudes of a wave that continues, one for each of the factors (d, k)."""
    size, noise2 = found.size[:, axis], 2.0 * found.sigma[:, axis] ** 2
    square = float(np.mean(np.maximum(size**2 - noise2, 0.0)))
    error = float(np.hypot(np.sqrt(np.mean(noise2) / len(size)), found.relative_sigma[axis] * np.sqrt(square)))
    drawn = np.abs(np.sqrt(square) + error * rng.standard_normal(len(factors)))
    return np.asarray(drawn / np.sqrt(np.mean(factors**2, axis=1)))


def _log_density(size: Array, true: Array, sigma: Array) -> Array:
    """Log of Rice's density; the scaled Bessel function contains the exponential of the product."""
    return np.asarray(np.log(size / sigma**2 * special.i0e(size * true / sigma**2)) - 0.5 * ((size - true) / sigma) ** 2)


def _factor(turns: Array, frames: Array) -> Array:
    """(k,) amplitude of the difference of two frames, the second interpolated, per amplitude of the wave."""
    remaining = np.sqrt(np.maximum(frames - 1.0, 0.0))
    return np.sqrt(np.maximum(1.0 + remaining**2 - 2.0 * remaining * np.cos(2.0 * np.pi * turns), 0.0))
