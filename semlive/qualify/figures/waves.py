"""Amplitudes of waves of the rows, from the amplitude of the difference of both frames of each pair."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from semlive.data.diagnosis.effects import IdentifiedEffect, ParameterEstimate
from semlive.diagnose.rows.series import RowSeries
from semlive.diagnose.rows.spectrum import Wave, fit_wave
from semlive.qualify.figures.intervals import TAILS, Interval, quantiles
from semlive.qualify.values import Figure, Result

Array = NDArray[np.float64]
DRAWS = 2000
MAX_COHERENT_SCATTER = 0.15
"""Largest scatter of the differences of the pairs, relative to their mean, of a wave that continues from frame to frame. With independent
phases it is 0.48 +- 0.08 for nine pairs.
"""
MIN_COHERENT_PAIRS = 4
MIN_SHARE = 0.08
"""Smallest amplitude relative to the strongest one that is stated. A wave along y moves rows against each other, which makes waves of up to
5 % of its amplitude at other frequencies; jitter of 0.27 px along x was measured with 0.005 px along y.
"""
ADJACENT_LINES, MIN_SHARE_ADJACENT = 2.0, 0.5
"""Distance in the spectrum of the rows, in cycles per frame, within which part of a wave appears at another frequency, and the smallest
share that is stated there: a vibration of 0.61 px at 37.2 Hz appeared with 0.05 px at 143.2 Hz, whose alias is 1.2 cycles away.
"""
ALIAS_ERROR = 1e-3
"""Error of a frequency in widths of a spectral line, times the cycles per row of its alias. The removal of the trend over 43 rows displaces
slow waves: 50 Hz at 3.05 cycles per row were found at 49.9994 Hz with a stated uncertainty of 0.0001 Hz and a line of 0.037 Hz.
"""
AMPLITUDE_ERROR = 0.02
"""Relative standard uncertainty of an amplitude that is known by its phase: 0.21 px along y were measured 2.6 % too small."""
DRIFT_BIAS_PER_PX = 0.15
"""Standard uncertainty of the mean motion within a pair per squared amplitude of a wave, 1/px: 60 Hz with 0.21 px along y moved the mean of
all nine pairs by 0.011 px, and 50 Hz with 0.40 px along x by 0.036 px.
"""
AMPLITUDES, PHASES, LARGEST_RATIO, MIN_SIGMA_SHARE = 200, 256, 3.0, 0.02
"""Amplitudes of a wave with independent phases, phases over half a turn, largest amplitude relative to the largest difference, and smallest
standard uncertainty relative to it: differences of neighbouring phases are 0.037 of it or less.
"""
NOT_EXCLUDED = 0.147
"""Likelihood of no wave, relative to the largest, above which a 95 % interval contains 0: exp(-1.96^2 / 2)."""


@dataclass(frozen=True, slots=True)
class StatedWave:
    """A wave of an effect: frequency, and amplitudes along x and y."""

    frequency: ParameterEstimate
    along_x: ParameterEstimate
    along_y: ParameterEstimate

    @property
    def size_px(self) -> float:
        """Amplitude."""
        return float(np.hypot(self.along_x.value, self.along_y.value))


def _waves_of(effect: IdentifiedEffect) -> list[StatedWave]:
    return [StatedWave(*effect.parameters[at : at + 3]) for at in range(0, len(effect.parameters) - 2, 3)]


def stated_waves(effect: IdentifiedEffect, effects: Sequence[IdentifiedEffect], pairs: RowPairs) -> list[StatedWave]:
    """The waves of an effect that are not a consequence of the strongest wave of all effects."""
    strongest = max((wave for one in effects if is_wave(one) for wave in _waves_of(one)), key=lambda wave: wave.size_px)
    return [wave for wave in _waves_of(effect) if wave is strongest or _is_stated(wave, strongest, pairs)]


def _is_stated(wave: StatedWave, strongest: StatedWave, pairs: RowPairs) -> bool:
    share = wave.size_px / strongest.size_px
    lines = abs(pairs.alias_cycles(wave.frequency.value) - pairs.alias_cycles(strongest.frequency.value))
    return share >= (MIN_SHARE if lines > ADJACENT_LINES else MIN_SHARE_ADJACENT)


def strongest_wave_px(effects: Sequence[IdentifiedEffect]) -> float:
    """Largest amplitude of a wave of the rows; 0 without."""
    return max((wave.size_px for effect in effects if is_wave(effect) for wave in _waves_of(effect)), default=0.0)


def row_motion_px(row_effects: Sequence[IdentifiedEffect]) -> float:
    """Largest displacement by waves and jitter of the rows; 0 without."""
    return max((effect.peak_px for effect in row_effects), default=0.0)


def certain_effects(map_effects: Sequence[IdentifiedEffect], row_effects: Sequence[IdentifiedEffect]) -> tuple[IdentifiedEffect, ...]:
    """Effects of the maps that are larger than the motion of the rows.

    Smaller ones may be caused by it: five of seven random microscopes with waves or jitter of 0.09 to 0.8 px had such effects, a wrong row
    time or a charge among them, of 0.03 to 0.11 px, which were not there.
    """
    return tuple(effect for effect in map_effects if effect.peak_px > row_motion_px(row_effects))


def is_wave(effect: IdentifiedEffect) -> bool:
    """Whether an effect of the rows is periodic."""
    return effect.parameters[0].unit == "Hz"


@dataclass(frozen=True, slots=True)
class RowMotion:
    """Motion of the rows by the strongest wave and by jitter, and what it adds to the uncertainty of other figures.

    Attributes:
        wave_px: amplitude of the strongest wave.
        jitter_px: standard deviation of the jitter.
        rows: number of rows of a frame.
    """

    wave_px: float
    jitter_px: float
    rows: int

    @classmethod
    def of(cls, results: Sequence[Result], rows: int) -> RowMotion:
        """From the figures of the rows."""
        sizes: dict[str, list[float]] = {}
        for result in results:
            if isinstance(result, Figure) and result.unit == "px":
                sizes.setdefault(result.name[: -len("_x_px")], []).append(result.value)
        jitter, waves = [0.0], [0.0]
        for name, both in sizes.items():
            (jitter if name.endswith("_sd") else waves).append(float(np.linalg.norm(both)))
        return cls(max(waves), max(jitter), rows)

    @property
    def mean_sigma_px(self) -> float:
        """Standard uncertainty of the mean motion between two frames; points of one row move together."""
        return float(np.hypot(DRIFT_BIAS_PER_PX * self.wave_px**2, np.sqrt(2.0 / self.rows) * self.jitter_px))

    @property
    def rotation_sigma_rad(self) -> float:
        """Standard uncertainty of a rotation between two frames, half of that of the slope of the rows' motion along x."""
        return float(np.sqrt(6.0) * self.jitter_px / self.rows**1.5)


AT_REST = RowMotion(0.0, 0.0, 1)


@dataclass(frozen=True, slots=True, eq=False)
class RowPairs:
    """Rows of the pairs.

    Attributes:
        series: row series of each pair.
        interval_s: (k,) from the start of the first frame to that of the second; 0 if it is unknown.
        moved_px: (k, 2) mean motion along x and y from the first frame to the second.
    """

    series: Sequence[RowSeries]
    interval_s: Array
    moved_px: Array

    def frequency_sigma_hz(self, frequency: ParameterEstimate) -> float:
        """Standard uncertainty of a frequency, with the error of slow aliases."""
        longest = max(self.series, key=lambda one: one.duration_s)
        per_row = frequency.value * longest.row_time_s
        alias = max(abs(per_row - round(per_row)), ALIAS_ERROR)
        return float(np.hypot(frequency.sigma, ALIAS_ERROR / alias / longest.duration_s))

    def alias_cycles(self, frequency_hz: float) -> float:
        """Cycles per frame with which the rows sample a wave, whatever its direction."""
        longest = max(self.series, key=lambda one: one.duration_s)
        per_row = frequency_hz * longest.row_time_s
        return abs(per_row - round(per_row)) * longest.duration_s / longest.row_time_s

    def turns(self, frequency_hz: float) -> Array:
        """(k,) phase of a wave in the second frame minus that in the first at the same points, turns.

        Rows sample the wave, so that a motion by a part of a row changes the phase by that of its alias.
        """
        row_s, dwell_s = (np.array([getattr(one, name) for one in self.series]) for name in ("row_time_s", "dwell_time_s"))
        per_row = frequency_hz * row_s
        alias = per_row - np.round(per_row)
        return np.asarray(frequency_hz * (self.interval_s + dwell_s * self.moved_px[:, 0]) + alias * self.moved_px[:, 1])


def amplitude_interval(axis: int, frequency: ParameterEstimate, pairs: RowPairs, in_maps: Wave | None = None) -> Interval:
    """Amplitude of a wave along one axis with its 95 % interval.

    A wave that continues from frame to frame has almost the same phase difference in all pairs, from which nothing but the interval of the
    frames determines its amplitude; without it the stated 0.15 to 0.31 px did not contain a hum of 0.5 px. One with other phase differences
    has the posterior of `_independent`.

    Args:
        axis: 0 along x, 1 along y.
        frequency: of the wave, Hz.
        pairs: rows of the pairs.
        in_maps: the wave in the maps within the pairs; None for that in their rows.
    """
    wave = in_maps or fit_wave(pairs.series, frequency.value)
    size, noise = np.abs(wave.amplitude), wave.sigma_px * np.sqrt(2.0)
    factor = _factor(pairs.turns(frequency.value), wave.frames)
    stronger = int(np.argmax(size.mean(axis=0)))
    relative = size[:, stronger] / np.maximum(factor, 1e-3)
    coherent = (
        len(size) >= MIN_COHERENT_PAIRS
        and bool(np.all(pairs.interval_s > 0.0))
        and np.std(relative) <= MAX_COHERENT_SCATTER * np.mean(relative)
    )
    if not coherent:
        return _independent(size[:, axis], np.hypot(wave.sigma_px[:, axis], AMPLITUDE_ERROR * size[:, axis]), wave.frames)
    rng = np.random.default_rng(5)
    sigma_hz = pairs.frequency_sigma_hz(frequency) if in_maps is None else frequency.sigma
    frequencies = frequency.value + sigma_hz * rng.standard_normal(DRAWS)
    factors = np.stack([_factor(pairs.turns(one), wave.frames) for one in frequencies])
    square = np.mean(np.maximum(size[:, axis] ** 2 - noise[:, axis] ** 2, 0.0))
    error = float(np.sqrt(np.mean(noise[:, axis] ** 2) / len(size)))
    error = float(np.hypot(error, AMPLITUDE_ERROR * np.sqrt(square)))
    drawn = np.abs(np.sqrt(square) + error * rng.standard_normal(DRAWS)) / np.sqrt(np.mean(factors**2, axis=1))
    value, low, high = quantiles(drawn)
    return value, 0.0 if square <= (2.0 * error) ** 2 else low, high


def _independent(size: Array, sigma: Array, frames: Array) -> Interval:
    """Amplitude of a wave with independent phases, with its 95 % interval.

    The size of a difference is the amplitude times a factor of 0 to 2 that follows from the phase difference, which is uniform, with noise.
    Sizes close to the largest possible one are frequent, so that the largest size determines the amplitude better than their mean does: a
    vibration of 0.61 px was stated as 0.36 to 0.57 px from the mean square of nine pairs.

    Args:
        size: (k,) amplitude of the difference of each pair, px.
        sigma: (k,) standard uncertainty of its sine and cosine, px.
        frames: (k,) number of frames whose wave power each pair contains.
    """
    sigma = np.maximum(sigma, MIN_SIGMA_SHARE * size.max())
    amplitude = np.linspace(0.0, LARGEST_RATIO * float(size.max()), AMPLITUDES)
    factors = np.stack([_factor(np.full(len(frames), turn), frames) for turn in (np.arange(PHASES) + 0.5) / (2.0 * PHASES)])
    true = amplitude[:, None, None] * factors  # (amplitudes, phases, pairs)
    # Rice's density; the scaled Bessel function contains the exponential of the product.
    log_density = np.log(special.ive(0, size * true / sigma**2)) - 0.5 * ((size - true) / sigma) ** 2
    log_likelihood = special.logsumexp(log_density, axis=1).sum(axis=1)
    weight = np.exp(log_likelihood - log_likelihood.max())
    value, low, high = (float(np.interp(share, np.cumsum(weight) / weight.sum(), amplitude)) for share in (0.5, *TAILS))
    return value, 0.0 if weight[0] > NOT_EXCLUDED else low, high


def _factor(turns: Array, frames: Array) -> Array:
    """(k,) amplitude of the difference of two frames, the second interpolated, per amplitude of the wave."""
    remaining = np.sqrt(np.maximum(frames - 1.0, 0.0))
    return np.sqrt(np.maximum(1.0 + remaining**2 - 2.0 * remaining * np.cos(2.0 * np.pi * turns), 0.0))
