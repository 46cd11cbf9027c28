"""A vibration or hum near a multiple of the row rate, found in the maps within pairs.

The rows sample it as a slow wave. Subsets follow it in part, so that it is noise of the maps, and the registration of the rows against
the map of the pair removes it. In a map it is a plane wave: the rows give the distance from a multiple of the row rate, and the columns
the multiple.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from semlive.data.diagnosis.effects import IdentifiedEffect, ModelEffect, ParameterEstimate
from semlive.data.disparity import DisparityMap
from semlive.data.scan import ScanTiming
from semlive.diagnose.maps.effect_selection import MIN_LOG_ODDS
from semlive.diagnose.rows.spectrum import EXPONENTIAL_MEDIAN, Spectrum, Wave
from semlive.model.effects.rows import VIBRATION, periodic_effect_of
from semlive.qualify.figures.map_sampling import PER_CYCLE, MapSampling, StillMap
from semlive.qualify.figures.noise import displacement_scatter

Array = NDArray[np.float64]
MIN_FREQUENCIES = 30
"""Fewest tested frequencies, for the level of the noise."""
MIN_LOG_FACTOR = 15.0
"""As for the waves in the maps of a diagnosis."""
MIN_PAIRS, MIN_POWER = 3, 12.0
"""Pairs that show the wave, and its power in each of them along x and y in units of the noise: noise alone has it with 8e-5."""
MIN_EXPLAINED = 0.7
"""Smallest share of the unexplained variance of the maps that the wave explains."""
MAX_STEP = 0.98
"""Largest distance between the frequencies of least squares and of the spectrum, in tested frequencies. The wave is slower than the tested
ones beyond it: one of 1.5 cycles was stated 0.25 cycles too far from the multiple.
"""
FREQUENCY_ERROR = 0.004
"""Standard uncertainty of the frequency in cycles over a map: 13 waves of 0.1 to 0.5 px had errors of up to 0.004."""
RESPONSE_ERROR = 0.03
"""Relative standard uncertainty of an amplitude per ratio of its lost part to the remaining one: a wave of 0.23 px, of which 0.48
remains in a subset, was measured 3.9 % too large, and one of 0.06 px, of which 0.9 remains, 0.4 %.
"""


@dataclass(frozen=True, slots=True, eq=False)
class SlowWave:
    """A wave near a multiple of the row rate.

    Attributes:
        effect: its frequency, Hz, and its amplitudes along x and y, px.
        wave: its amplitudes in the pairs.
        relative_sigma: relative standard uncertainty of its amplitudes by the mean over the subsets.
    """

    effect: IdentifiedEffect
    wave: Wave
    relative_sigma: float


def slow_wave(maps: Sequence[DisparityMap], timing: ScanTiming, white_px: float) -> SlowWave | None:
    """The wave near a multiple of the row rate that explains the noise of maps beyond that of the image; None if there is none.

    Charging, drift that bends and other changes within pairs are no line at one frequency: the wave has to explain most of that noise.

    Args:
        maps: map within each pair, of one grid.
        timing: times of the scan.
        white_px: standard deviation of a component of the maps by image noise, px.
    """
    still, grid, scatter = [StillMap.of(disparity) for disparity in maps], maps[0].grid, displacement_scatter(maps)
    sampling = MapSampling(grid.y_px, grid.x_px, grid.subset_px, timing.row_time_s.value, timing.dwell_time_s.value)
    frequency_hz, pairs = sampling.tested_hz(), [one for one in still if one is not None]
    if scatter is None or len(frequency_hz) < MIN_FREQUENCIES or len(pairs) < len(maps) or any(one.grid != grid for one in maps):
        return None
    spectrum = _spectrum(sampling, pairs, frequency_hz)
    at, log_factors = int(np.argmax(spectrum.total)), spectrum.log_factors(VIBRATION.sizes_px)
    log_factor = float(np.logaddexp.reduce(log_factors) - np.log(len(log_factors)))
    shown = int(np.sum(spectrum.power[:, at].reshape(-1, 2).sum(axis=1) >= MIN_POWER))
    if log_factor < MIN_LOG_FACTOR or shown < MIN_PAIRS or not _is_certain(spectrum, at, sampling.row_s):
        return None
    frequency = _frequency(sampling, pairs, spectrum, at)
    if frequency is None:
        return None
    fits = [sampling.fitted(one, frequency.value) for one in pairs]
    unexplained_px2 = float(scatter.observed.mean(axis=0).sum()) - 2.0 * white_px**2
    if float(np.mean([explained for _, explained in fits])) < MIN_EXPLAINED * unexplained_px2:
        return None
    remaining = float(sampling.remaining(np.array(frequency.value), sampling.subset_px))
    sigma_px = (1.0 / np.sqrt(spectrum.information[:, at])).reshape(-1, 2)
    wave = Wave(frequency.value, frequency.sigma, np.stack([amplitude for amplitude, _ in fits]), sigma_px, np.full(len(maps), 2.0))
    return SlowWave(_effect(frequency, wave, log_factor, spectrum.p_value(at)), wave, RESPONSE_ERROR * (1.0 - remaining) / remaining)


def _spectrum(sampling: MapSampling, pairs: Sequence[StillMap], frequency_hz: Array) -> Spectrum:
    """Power along x and y of each pair in units of the noise, whose level in the maps is the median over all frequencies."""
    power = np.abs(np.concatenate([sampling.amplitudes(one, frequency_hz) for one in pairs])) ** 2
    remaining2 = sampling.remaining(frequency_hz, sampling.subset_px) ** 2
    level = np.median(power * remaining2, axis=1, keepdims=True) / EXPONENTIAL_MEDIAN / remaining2
    return Spectrum(frequency_hz, power / level, 2.0 / level)


def _frequency(sampling: MapSampling, pairs: Sequence[StillMap], spectrum: Spectrum, at: int) -> ParameterEstimate | None:
    """Frequency near one of a spectrum at which a wave explains most of all maps; None if that is beyond the neighbouring ones."""
    start_hz, half_hz = float(spectrum.frequency_hz[at]), sampling.cycle_hz / PER_CYCLE

    def loss(frequency_hz: float) -> float:
        return -sum(sampling.fitted(one, frequency_hz)[1] for one in pairs)

    best: Any = minimize_scalar(loss, bounds=(start_hz - half_hz, start_hz + half_hz), method="bounded", options={"xatol": 3e-3 * half_hz})
    if abs(float(best.x) - start_hz) > MAX_STEP * half_hz:
        return None
    by_noise = np.sqrt(1.5 / float(spectrum.total[at])) / np.pi  # of a wave in white noise, cycles
    return ParameterEstimate("frequency_hz", float(best.x), sampling.cycle_hz * float(np.hypot(FREQUENCY_ERROR, by_noise)), "Hz")


def _is_certain(spectrum: Spectrum, at: int, row_s: float) -> bool:
    """Whether frequencies near the other multiples of the row rate are less likely by `MIN_LOG_ODDS`."""
    elsewhere = np.abs(spectrum.frequency_hz - spectrum.frequency_hz[at]) > 0.5 / row_s
    return not bool(np.any(spectrum.total[elsewhere] > spectrum.total[at] - MIN_LOG_ODDS))


def _effect(frequency: ParameterEstimate, wave: Wave, log_factor: float, p_value: float) -> IdentifiedEffect:
    """The wave as an effect; with random phases a pair has a mean square amplitude of 2 A^2."""
    family = periodic_effect_of(frequency.value)
    sizes_px = np.sqrt(0.5 * np.mean(np.abs(wave.amplitude) ** 2, axis=0))
    along = [
        ParameterEstimate(f"amplitude_{axis}_px", float(size), float(size) / float(np.sqrt(8.0 * len(wave.amplitude))), "px")
        for axis, size in zip("xy", sizes_px, strict=True)
    ]
    peak_px = float(np.hypot(*sizes_px))
    model = ModelEffect(family.name, (("frequency_hz", frequency.value),), peak_px)
    return IdentifiedEffect(family.name, (frequency, *along), peak_px, log_factor, p_value, strain=False, model_effect=model)
