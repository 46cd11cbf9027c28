"""Amplitudes of waves of the rows, from the amplitude of the difference of both frames of each pair."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.data.diagnosis.effects import IdentifiedEffect, ParameterEstimate
from semlive.diagnose.rows.series import RowSeries
from semlive.diagnose.rows.spectrum import fit_wave
from semlive.qualify.intervals import NORMAL_95, Interval, about, quantiles

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
ALIAS_ERROR = 1e-3
"""Error of a frequency in widths of a spectral line, times the cycles per row of its alias. The removal of the trend over 43 rows displaces
slow waves: 50 Hz at 3.05 cycles per row were found at 49.9994 Hz with a stated uncertainty of 0.0001 Hz and a line of 0.037 Hz.
"""
AMPLITUDE_ERROR = 0.02
"""Relative standard uncertainty of an amplitude that is known by its phase: 0.21 px along y were measured 2.6 % too small."""
DRIFT_BIAS_PER_PX = 0.15
"""Standard uncertainty of the mean motion within a pair per squared amplitude of a wave, 1/px: 60 Hz with 0.21 px along y moved the mean of
all nine pairs by 0.011 px.
"""


def stated_waves(effect: IdentifiedEffect, strongest_px: float) -> Iterator[tuple[ParameterEstimate, ParameterEstimate, ParameterEstimate]]:
    """Frequency and amplitudes along x and y of each wave of an effect that is not a consequence of the strongest one."""
    for at in range(0, len(effect.parameters) - 2, 3):
        frequency, along_x, along_y = effect.parameters[at : at + 3]
        if np.hypot(along_x.value, along_y.value) >= MIN_SHARE * strongest_px:
            yield frequency, along_x, along_y


def strongest_px(effects: Sequence[IdentifiedEffect]) -> float:
    """Amplitude of the strongest wave; 0 without a wave."""
    waves = (wave for effect in effects if is_wave(effect) for wave in stated_waves(effect, 0.0))
    return max((float(np.hypot(along_x.value, along_y.value)) for _, along_x, along_y in waves), default=0.0)


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

    def turns(self, frequency_hz: float) -> Array:
        """(k,) phase of a wave in the second frame minus that in the first at the same points, turns.

        Rows sample the wave, so that a motion by a part of a row changes the phase by that of its alias.
        """
        row_s, dwell_s = (np.array([getattr(one, name) for one in self.series]) for name in ("row_time_s", "dwell_time_s"))
        per_row = frequency_hz * row_s
        alias = per_row - np.round(per_row)
        return np.asarray(frequency_hz * (self.interval_s + dwell_s * self.moved_px[:, 0]) + alias * self.moved_px[:, 1])


def amplitude_interval(given: ParameterEstimate, axis: int, frequency: ParameterEstimate, pairs: RowPairs) -> Interval:
    """Amplitude of a wave along one axis with its 95 % interval.

    A wave with independent phases in all frames has the interval of its diagnosis. One that continues from frame to frame has almost the
    same phase difference in all pairs, from which nothing but the interval of the frames determines its amplitude; without it the stated
    0.15 to 0.31 px did not contain a hum of 0.5 px.

    Args:
        given: amplitude by the diagnosis, px.
        axis: 0 along x, 1 along y.
        frequency: of the wave, Hz.
        pairs: rows of the pairs.
    """
    wave = fit_wave(pairs.series, frequency.value)
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
        return about(given.value, NORMAL_95 * given.sigma)
    rng = np.random.default_rng(5)
    frequencies = frequency.value + pairs.frequency_sigma_hz(frequency) * rng.standard_normal(DRAWS)
    factors = np.stack([_factor(pairs.turns(one), wave.frames) for one in frequencies])
    square = np.mean(np.maximum(size[:, axis] ** 2 - noise[:, axis] ** 2, 0.0))
    error = float(np.sqrt(np.mean(noise[:, axis] ** 2) / len(size)))
    error = float(np.hypot(error, AMPLITUDE_ERROR * np.sqrt(square)))
    drawn = np.abs(np.sqrt(square) + error * rng.standard_normal(DRAWS)) / np.sqrt(np.mean(factors**2, axis=1))
    value, low, high = quantiles(drawn)
    return value, 0.0 if square <= (2.0 * error) ** 2 else low, high


def _factor(turns: Array, frames: Array) -> Array:
    """(k,) amplitude of the difference of two frames, the second interpolated, per amplitude of the wave."""
    remaining = np.sqrt(np.maximum(frames - 1.0, 0.0))
    return np.sqrt(np.maximum(1.0 + remaining**2 - 2.0 * remaining * np.cos(2.0 * np.pi * turns), 0.0))
