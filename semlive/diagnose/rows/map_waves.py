"""Waves near multiples of the row rate, found in the maps within pairs.

Such a wave has almost the same phase in neighbouring rows. Its image is smooth, subsets do not average it, and row registration, which
compares rows with the pair's own map, removes it. In time it is a plane wave over rows and columns: the columns give the multiple, the rows
the distance from it. Maps within pairs contain no motion, and drift within a frame is a function of the row alone, so rows are centred.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from semlive.data.diagnosis.channels import RowDiagnosis
from semlive.data.diagnosis.effects import DomainTest, IdentifiedEffect, ModelEffect, Outcome, ParameterEstimate
from semlive.diagnose.maps.effect_selection import MIN_LOG_ODDS, SIGNIFICANCE_LEVEL
from semlive.diagnose.rows.map_series import MapSeries
from semlive.diagnose.rows.spectrum import (
    EXPONENTIAL_MEDIAN,
    FREQUENCIES_PER_LINE_WIDTH,
    MAX_FREQUENCY_HZ,
    MIN_AMPLITUDE_FRACTION,
    MIN_CYCLES_PER_ROW,
    Spectrum,
    matching_frequencies,
)
from semlive.model.effects.rows import PERIODIC_EFFECTS, RowEffectClass, periodic_effect_of

Array = NDArray[np.float64]
MIN_LOG_FACTOR = 15.0  # noise of engines with other windows reached 9.5; a wave of 0.05 px in five pairs has more than 1000
BANDS, NOISE_ORDER = 6, 4  # bands of the distance from a multiple, and order of the even polynomial through the logarithms of their medians
MIN_CYCLES_OVER_COLUMNS = 1.0  # a slower wave resembles drift, which is constant along a row
MIN_FREQUENCIES = 30  # near a multiple, for the level of the noise
MIN_WINDOW = 0.05  # smallest power of the subset's window that scales the noise
MIN_FRACTION_OVER_ROWS = 0.25  # beyond, the noise of the maps falls faster with frequency than its level is known
MAX_EXTRA_CYCLES, CYCLE_STEPS, SAME_CYCLES = 0.6, 25, 0.1  # cycles over the columns more or less than those of a frequency
TAPERED = 0.5  # share of rows and columns with reduced weight: slow noise leaks less into fast waves


@dataclass(frozen=True, slots=True, eq=False)
class MapWave:
    """An identified wave.

    Attributes:
        family: its class.
        frequency_hz: frequency, Hz.
        sigma_hz: standard uncertainty of the frequency, Hz.
        amplitude_px: (2,) amplitude of the beam deflection along x and y, for random phases of the frames, px.
        sigma_px: (2,) their standard uncertainties, px.
        log_factor: log Bayes factor of the class.
        p_value: probability of the power at any tested frequency without a wave.
        certain: whether the neighbouring multiples of the row rate are less likely by `MIN_LOG_ODDS`.
        of_beam: whether the wave has as many cycles over the columns as a wave of its frequency; a wave over the field may have any number.
    """

    family: RowEffectClass
    frequency_hz: float
    sigma_hz: float
    amplitude_px: Array
    sigma_px: Array
    log_factor: float
    p_value: float
    certain: bool
    of_beam: bool

    def effect(self) -> IdentifiedEffect:
        """The wave as an effect."""
        parameters = (
            ParameterEstimate("frequency_hz", self.frequency_hz, self.sigma_hz, "Hz"),
            ParameterEstimate("amplitude_x_px", float(self.amplitude_px[0]), float(self.sigma_px[0]), "px"),
            ParameterEstimate("amplitude_y_px", float(self.amplitude_px[1]), float(self.sigma_px[1]), "px"),
        )
        size_px = float(np.hypot(*self.amplitude_px))
        model_effect = ModelEffect(self.family.name, (("frequency_hz", self.frequency_hz),), size_px)
        return IdentifiedEffect(self.family.name, parameters, size_px, self.log_factor, self.p_value, False, model_effect)


def diagnose_map_waves(series: Sequence[MapSeries]) -> RowDiagnosis | None:
    """Verdict on one wave near a multiple of the row rate; None if the maps resolve none."""
    spectrum = map_spectrum(series)
    if spectrum is None:
        return None
    odds = {family.name: _class_odds(spectrum, family) for family in PERIODIC_EFFECTS}
    family = max(PERIODIC_EFFECTS, key=lambda candidate: odds[candidate.name])
    own = matching_frequencies(spectrum, family.matches_frequency) if family.matches_frequency else np.arange(len(spectrum.frequency_hz))
    at = int(own[np.argmax(spectrum.total[own])])
    p_value = spectrum.p_value(at)
    wave = None
    if odds[family.name] >= MIN_LOG_FACTOR and 2.0 * p_value <= SIGNIFICANCE_LEVEL:
        wave = _refined(series, spectrum, at, family, odds[family.name])
    outcome = Outcome.NONE if wave is None else Outcome.IDENTIFIED if wave.certain and wave.of_beam else Outcome.UNKNOWN
    excess = np.clip(spectrum.power[:, at] - 1.0, 0.0, None) / spectrum.information[:, at]
    test = DomainTest("map_waves", min(1.0, 2.0 * p_value), float(np.sqrt(np.mean(excess))))
    noise_px = float(np.sqrt(np.mean([np.var(one.shift_px[:, one.valid]) for one in series])))
    effects = (wave.effect(),) if wave is not None and wave.of_beam else ()
    sizes = len(series), max(len(one.row_px) for one in series)
    return RowDiagnosis(outcome, effects, (), None, (test,), tuple(odds.items()), *sizes, noise_px, (), (), 0.0)


def map_spectrum(series: Sequence[MapSeries]) -> Spectrum | None:
    """Spectrum of the waves that maps resolve and rows do not; None if there is none."""
    if not series:
        return None
    first = series[0]
    duration_s = float(np.ptp(first.row_px)) * first.row_time_s
    step_hz = 1.0 / (FREQUENCIES_PER_LINE_WIDTH * duration_s)
    count = int(MIN_CYCLES_PER_ROW / first.row_time_s / step_hz)
    near_hz = step_hz * np.arange(-count, count + 1)
    per_row, spacing_px = near_hz * first.row_time_s, [float(np.diff(at_px).max()) for at_px in (first.row_px, first.column_px)]
    near_hz = near_hz[(np.sinc(per_row * first.subset_px) > MIN_FRACTION_OVER_ROWS) & (2.0 * np.abs(per_row) * spacing_px[0] < 1.0)]
    fastest_hz = min(MAX_FREQUENCY_HZ, 0.5 / (spacing_px[1] * first.dwell_time_s))
    slowest_hz = MIN_CYCLES_OVER_COLUMNS / (float(np.ptp(first.column_px)) * first.dwell_time_s)
    multiples = np.arange(1, int(fastest_hz * first.row_time_s) + 1)
    tested = [near_hz + multiple / first.row_time_s for multiple in multiples]
    retained = [hz[(hz >= slowest_hz) & (first.remaining(hz) > MIN_AMPLITUDE_FRACTION)] for hz in tested]
    groups = [hz for hz in retained if 2 * len(hz) >= len(near_hz) >= MIN_FREQUENCIES]
    if not groups:
        return None
    frequency_hz = np.concatenate(groups)
    flat = [_powers(one, axis, frequency_hz) for one in series for axis in (0, 1)]
    power = np.stack([power for power, _ in flat])
    level = np.median(power, axis=1, keepdims=True) + 1e-18
    # The shape of the noise over frequency is common to all maps: that of one map alone, from few lines, doubles the false alarms.
    shape = np.concatenate([_noise_shape(part) for part in np.split(power / level, np.cumsum([len(hz) for hz in groups])[:-1], axis=1)])
    level = level * np.maximum(shape, 1e-9) / EXPONENTIAL_MEDIAN
    return Spectrum(frequency_hz, power / level, np.stack([weight for _, weight in flat]) / level)


def _noise_shape(power: Array) -> Array:
    """(m,) median power (k, m) near one multiple over the distance from it, because the window of an engine may differ.

    With three bands of constant power the rise towards the farthest frequencies was taken for a wave: with 20 pairs of noise alone, ln B
    reached 11 with square windows and 17 with smoothed maps, with 32 pairs 28; with the polynomial 6 at most.
    """
    middle = 0.5 * (power.shape[1] - 1)
    distance = np.abs(np.arange(power.shape[1]) - middle) / middle
    band = np.minimum((BANDS * distance).astype(np.int64), BANDS - 1)
    at = np.sqrt([np.mean(distance[band == value] ** 2) for value in range(BANDS)])
    level = np.log([np.median(power[:, band == value]) + 1e-30 for value in range(BANDS)])
    orders = np.arange(0, NOISE_ORDER + 1, 2)
    coefficients = np.linalg.lstsq(at[:, None] ** orders, level, rcond=None)[0]
    return np.exp(distance[:, None] ** orders @ coefficients)


def _powers(series: MapSeries, axis: int, frequency_hz: Array) -> tuple[Array, Array]:
    """Power at each frequency, scaled by the window of the subsets, and information on the amplitudes for a power of 1."""
    taper = np.outer(_taper(len(series.row_px)), _taper(len(series.column_px))) * series.valid
    squares = float(np.sum(taper**2))
    rows = frequency_hz * series.row_time_s
    over_rows = np.exp(-2j * np.pi * np.outer(series.row_px, rows - np.round(rows)))
    over_columns = np.exp(-2j * np.pi * np.outer(series.column_px, frequency_hz * series.dwell_time_s))
    total = np.sum(((series.shift_px[axis] * taper).T @ over_rows) * over_columns, axis=0)
    remaining = series.remaining(frequency_hz)
    window = np.maximum(remaining**2, MIN_WINDOW)
    return np.abs(total) ** 2 / squares / window, 0.5 * float(taper.sum()) ** 2 / squares * remaining**2 / window


def _class_odds(spectrum: Spectrum, family: RowEffectClass) -> float:
    own = matching_frequencies(spectrum, family.matches_frequency) if family.matches_frequency else np.zeros(0, dtype=np.int64)
    each = spectrum.log_factors(family.sizes_px)[own]
    return float(np.logaddexp.reduce(each) - np.log(len(each))) if len(each) else -np.inf


def _refined(series: Sequence[MapSeries], spectrum: Spectrum, at: int, family: RowEffectClass, log_factor: float) -> MapWave:
    """The wave at one frequency of a spectrum, refined between the tested frequencies."""
    first = series[0]
    start_hz, second = _likeliest_multiple(series, float(spectrum.frequency_hz[at]))
    step_hz = 1.0 / (FREQUENCIES_PER_LINE_WIDTH * float(np.ptp(first.row_px)) * first.row_time_s)
    noise_px = (1.0 / np.sqrt(spectrum.information[:, at])).reshape(len(series), 2)

    def amplitudes(frequency_hz: float) -> Array:
        return np.stack([one.amplitude(frequency_hz)[0] for one in series])

    def loss(frequency_hz: float) -> float:
        return -0.5 * float(np.sum(np.sum(amplitudes(frequency_hz) ** 2, axis=-1) / noise_px**2))

    best: Any = minimize_scalar(loss, bounds=(start_hz - step_hz, start_hz + step_hz), method="bounded", options={"xatol": 1e-3 * step_hz})
    top_hz, width_hz = float(best.x), 0.2 * step_hz
    curvature = (loss(top_hz - width_hz) + loss(top_hz + width_hz) - 2.0 * loss(top_hz)) / width_hz**2
    # A pair shows the difference of two waves of random phase: on average 2 A^2.
    square = 0.5 * (np.sum(amplitudes(top_hz) ** 2, axis=-1) - 2.0 * noise_px**2)
    mean = np.clip(square.mean(axis=0), 0.0, None)
    spread = np.sqrt(0.5 * mean**2 + 2.0 * noise_px.mean(axis=0) ** 2 * mean + noise_px.mean(axis=0) ** 4) / np.sqrt(len(series))
    amplitude_px = np.sqrt(mean)
    sigma_px = np.minimum(spread / np.maximum(2.0 * amplitude_px, 1e-12), np.sqrt(spread))
    others = np.abs(spectrum.frequency_hz - spectrum.frequency_hz[at]) > 0.5 / first.row_time_s
    rival = float(spectrum.total[others].max()) if others.any() else 0.0
    tested = start_hz == float(spectrum.frequency_hz[at])
    certain = float(spectrum.total[at]) * (1.0 - second) > MIN_LOG_ODDS and (not tested or bool(spectrum.total[at] - rival > MIN_LOG_ODDS))
    family = family if tested else periodic_effect_of(top_hz)
    sigma_hz = float(1.0 / np.sqrt(curvature)) if curvature > 0.0 else step_hz
    p_value = min(1.0, 2.0 * spectrum.p_value(at))
    return MapWave(family, top_hz, sigma_hz, amplitude_px, sigma_px, log_factor, p_value, certain, _is_of_beam(series, top_hz, noise_px))


def _is_of_beam(series: Sequence[MapSeries], frequency_hz: float, noise_px: Array) -> bool:
    """Whether no other number of cycles over the columns explains the maps better than that of the frequency.

    The rows give the distance from a multiple of the row rate, and the columns the multiple. Waves over the field with 0.23 and 0.48 cycles
    more than any multiple, moire patterns of an independent generator, were identified as vibrations.
    """
    extra = np.linspace(-MAX_EXTRA_CYCLES, MAX_EXTRA_CYCLES, CYCLE_STEPS)
    explained = np.array([sum(one.amplitude(frequency_hz, float(cycles))[1] for one in series) for cycles in extra])
    own, best = float(explained[CYCLE_STEPS // 2]), int(np.argmax(explained))
    amplitudes_px = np.stack([one.amplitude(frequency_hz)[0] for one in series])
    log_likelihood = 0.5 * float(np.sum(np.sum(amplitudes_px**2, axis=-1) / noise_px**2))
    return abs(float(extra[best])) <= SAME_CYCLES or log_likelihood * (float(explained[best]) / own - 1.0) < MIN_LOG_FACTOR


def _likeliest_multiple(series: Sequence[MapSeries], frequency_hz: float) -> tuple[float, float]:
    """The frequency near a multiple of the row rate that explains most of the maps, of those with the same alias up to a tested one.

    Slower waves than the tested ones turn less than once over the columns, and leak into the next multiple: 9.50 Hz was found at 18.84 Hz.

    Returns:
        The frequency, Hz, and the sum of squares that the second best explains, relative to that of the best; 0 if there is no other.
    """
    row_rate_hz = 1.0 / series[0].row_time_s
    candidates = frequency_hz - row_rate_hz * np.arange(round(frequency_hz / row_rate_hz))
    explained = np.array([sum(one.amplitude(float(hz))[1] for one in series) for hz in candidates])
    order = np.argsort(explained)[::-1]
    return float(candidates[order[0]]), float(explained[order[1]] / explained[order[0]]) if len(order) > 1 else 0.0


def _taper(count: int) -> Array:
    """(count,) window with cosine ends of Tukey (1967), without scipy.signal, whose import takes a second."""
    place, ends = np.arange(count, dtype=np.float64), int(np.floor(TAPERED * (count - 1) / 2.0)) + 1
    window = np.ones(count)
    window[:ends] = 0.5 * (1.0 + np.cos(np.pi * (-1.0 + 2.0 * place[:ends] / TAPERED / (count - 1))))
    window[-ends:] = 0.5 * (1.0 + np.cos(np.pi * (-2.0 / TAPERED + 1.0 + 2.0 * place[-ends:] / TAPERED / (count - 1))))
    return window
