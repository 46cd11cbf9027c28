"""Verdict on the rows: waves by their frequency, jitter by the common shift of the segments of a row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainccinv

from semlive.data.diagnosis.channels import RowDiagnosis
from semlive.data.diagnosis.effects import DomainTest, IdentifiedEffect, ModelEffect, Outcome, ParameterEstimate
from semlive.diagnose.maps.effect_selection import MIN_LOG_ODDS, SIGNIFICANCE_LEVEL, SIGNIFICANT_LOG_FACTOR
from semlive.diagnose.rows.cross_validation import held_out_row_misfit, is_useful
from semlive.diagnose.rows.jitter import CommonRowVariance, common_row_variance
from semlive.diagnose.rows.series import RowSeries
from semlive.diagnose.rows.spectrum import Spectrum, Wave, fit_wave, matching_frequencies, refined, spectrum
from semlive.errors import IllPosed
from semlive.model.effects.rows import PERIODIC_EFFECTS, ROW_JITTER, RowEffectClass

Array = NDArray[np.float64]
MAX_WAVES = 5  # waves
MAX_SPECTRUM_POINTS = 400
MIN_ROWS = 100
# Drift and interpolation change the amplitude of a wave within a frame, which gives it side lines: 1.5 to 1.7 % of 0.05 px, 0.7 lines away.
SIDE_LINE_FRACTION, SIDE_LINE_WIDTHS = 0.05, 1.5


@dataclass(frozen=True, slots=True, eq=False)
class IdentifiedWave:
    """A wave with its statistics at the time of selection."""

    family: RowEffectClass
    wave: Wave
    log_factor: float
    p_value: float
    rivals: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Screening:
    """One evaluation of all row tests."""

    series: tuple[RowSeries, ...]
    common: CommonRowVariance
    spectrum: Spectrum
    odds: dict[str, float]

    @property
    def has_jitter(self) -> bool:
        return self.odds[ROW_JITTER.name] >= SIGNIFICANT_LOG_FACTOR and 2.0 * self.common.p_value() <= SIGNIFICANCE_LEVEL

    def most_significant(self) -> tuple[RowEffectClass, int, float]:
        """The most likely wave: its class, its index in the spectrum and its p-value."""
        family = max(PERIODIC_EFFECTS, key=lambda candidate: self.odds[candidate.name])
        own = matching_frequencies(self.spectrum, family.matches_frequency) if family.matches_frequency else np.zeros(0, dtype=np.int64)
        at = int(own[np.argmax(self.spectrum.total[own])])
        return family, at, self.spectrum.p_value(at)


def diagnose_rows(series: Sequence[RowSeries], seed: int = 0, model_effects: Sequence[ModelEffect] = ()) -> RowDiagnosis:
    """Identify effects that row registration observes and disparity maps do not.

    Args:
        series: row series of each pair.
        seed: seed of the random rolls for the null distribution.
        model_effects: row effects already in the model.

    Raises:
        IllPosed: there are too few rows.
    """
    if not series or min(len(run_series.row_px) for run_series in series) < MIN_ROWS:
        raise IllPosed(f"rows: fewer than {MIN_ROWS} in a frame, too few to identify an effect")
    residual_series = tuple(series)
    for model_effect in model_effects:
        frequency_hz = dict(model_effect.values).get("frequency_hz")
        if frequency_hz is not None:
            residual_series = _without(residual_series, fit_wave(residual_series, frequency_hz))
    already = {model_effect.name for model_effect in model_effects}
    first = screening = _screen(residual_series, seed)
    waves, side_lines = list[IdentifiedWave](), 0
    while True:
        family, at, p_value = screening.most_significant()
        significant = screening.odds[family.name] >= SIGNIFICANT_LOG_FACTOR and 2.0 * p_value <= SIGNIFICANCE_LEVEL
        if not significant or len(waves) + side_lines == MAX_WAVES:
            break
        rivals = tuple(
            effect_class.name
            for effect_class in PERIODIC_EFFECTS
            if effect_class is not family and screening.odds[effect_class.name] > screening.odds[family.name] - MIN_LOG_ODDS
        )
        wave = refined(screening.series, screening.spectrum, at)
        sized = any(_amplitude(wave, axis)[0] > 0.0 for axis in (0, 1))
        if not sized or any(_is_side_line(wave, stronger.wave, residual_series) for stronger in waves):
            side_lines += 1
        else:
            waves.append(IdentifiedWave(family, wave, screening.odds[family.name], min(1.0, 2.0 * p_value), rivals))
        screening = _screen(_without(screening.series, wave), seed)
    has_jitter = screening.has_jitter and ROW_JITTER.name not in already
    return _verdict(first, screening, waves, has_jitter, significant)


def _screen(series: tuple[RowSeries, ...], seed: int) -> _Screening:
    common = common_row_variance(series, seed)
    odds = {ROW_JITTER.name: common.log_factor(ROW_JITTER.sizes_px)}
    power_spectrum = spectrum(series, common.levels())
    for family in PERIODIC_EFFECTS:
        own = matching_frequencies(power_spectrum, family.matches_frequency) if family.matches_frequency else np.zeros(0, dtype=np.int64)
        each = power_spectrum.log_factors(family.sizes_px)[own]
        odds[family.name] = float(np.logaddexp.reduce(each) - np.log(len(each))) if len(each) else -np.inf
    return _Screening(series, common, power_spectrum, odds)


def _without(series: Sequence[RowSeries], wave: Wave) -> tuple[RowSeries, ...]:
    return tuple(run_series.without(wave.moved(pair, run_series)) for pair, run_series in enumerate(series))


def _is_side_line(wave: Wave, stronger: Wave, series: Sequence[RowSeries]) -> bool:
    """Whether a change of a stronger wave within a frame explains a wave: much weaker, and less than two lines away."""
    line_hz = 1.0 / max(run_series.duration_s for run_series in series)
    sizes = [float(np.sqrt(np.mean(np.abs(one.amplitude) ** 2))) for one in (wave, stronger)]
    return abs(wave.frequency_hz - stronger.frequency_hz) < SIDE_LINE_WIDTHS * line_hz and sizes[0] < SIDE_LINE_FRACTION * sizes[1]


def _verdict(first: _Screening, last: _Screening, waves: Sequence[IdentifiedWave], has_jitter: bool, significant: bool) -> RowDiagnosis:
    effects = list(_effects_of_waves(waves))
    if has_jitter:
        effects.append(_jitter(last))
    gap = held_out_row_misfit(first.series, [wave.wave for wave in waves], last.common if has_jitter else None) if effects else None
    undecided = next((wave for wave in waves if wave.rivals), None)
    if significant:  # a further wave beyond the maximum number
        outcome = Outcome.UNKNOWN
    elif not effects:
        outcome = Outcome.NONE
    elif gap is not None and not is_useful(gap):
        outcome = Outcome.REJECTED
    else:
        outcome = Outcome.AMBIGUOUS if undecided else Outcome.IDENTIFIED
    names = (undecided.family.name, *undecided.rivals) if undecided is not None and outcome is Outcome.AMBIGUOUS else ()
    noise_px = float(np.sqrt(np.mean(first.common.variance_px2)))
    frequency_hz, power = _thinned(first.spectrum)
    return RowDiagnosis(
        outcome, tuple(effects), names, gap, _where(first), tuple(first.odds.items()), len(first.series),
        max(len(run_series.row_px) for run_series in first.series), noise_px, frequency_hz, power, _detection_threshold(first.spectrum),
    )  # fmt: skip


def _where(screening: _Screening) -> tuple[DomainTest, ...]:
    """The two domain tests, with family-wise p-values."""
    at = int(np.argmax(screening.spectrum.total))
    excess = np.clip(screening.spectrum.power[:, at] - 1.0, 0.0, None) / screening.spectrum.information[:, at]
    waves_px = float(np.sqrt(np.mean(excess)))
    common_px = float(np.sqrt(np.mean(screening.common.jitter_px()[0] ** 2)))
    return (
        DomainTest("row_waves", min(1.0, 2.0 * screening.spectrum.p_value(at)), waves_px),
        DomainTest("row_common", min(1.0, 2.0 * screening.common.p_value()), common_px),
    )


def _effects_of_waves(waves: Sequence[IdentifiedWave]) -> tuple[IdentifiedEffect, ...]:
    """One effect per class; further waves of a class add their parameters to it."""
    effects: list[IdentifiedEffect] = []
    for wave in waves:
        amplitudes = [_amplitude(wave.wave, axis) for axis in (0, 1)]
        size_px = float(np.hypot(amplitudes[0][0], amplitudes[1][0]))
        index = next((at for at, previous in enumerate(effects) if previous.name == wave.family.name), None)
        overtones = () if index is None else effects[index].parameters
        more = f"_{len(overtones) // 3 + 1}" if overtones else ""
        parameters = (
            *overtones,
            ParameterEstimate(f"frequency{more}_hz", wave.wave.frequency_hz, wave.wave.sigma_hz, "Hz"),
            ParameterEstimate(f"amplitude{more}_x_px", *amplitudes[0], "px"),
            ParameterEstimate(f"amplitude{more}_y_px", *amplitudes[1], "px"),
        )
        values = tuple((item.name, item.value) for item in parameters if item.unit == "Hz")
        model_effect = ModelEffect(wave.family.name, values, size_px)
        if index is None:
            effects.append(IdentifiedEffect(wave.family.name, parameters, size_px, wave.log_factor, wave.p_value, False, model_effect))
        else:
            previous = effects[index]
            effects[index] = IdentifiedEffect(
                previous.name, parameters, previous.peak_px + size_px, previous.log_bayes_factor, previous.p_value, False, model_effect
            )
    return tuple(effects)


def _amplitude(wave: Wave, axis: int) -> tuple[float, float]:
    """Amplitude of the beam deflection and its standard uncertainty, from differences of frames, px.

    With random phases of the frames a pair has the amplitude A sqrt(2 - 2 cos), with a mean square of 2 A^2 and a scatter of 0.71 of that.
    Pairs with equal amplitudes share one phase difference and count as one pair.
    """
    square = 2.0 * np.abs(wave.amplitude[:, axis]) ** 2 / wave.frames
    noise = 4.0 * wave.sigma_px[:, axis] ** 2 / wave.frames
    mean = max(float(np.mean(square - noise)), 0.0)
    n = len(square)
    if mean == 0.0:
        return 0.0, float(np.sqrt(np.mean(noise) / (2.0 * np.sqrt(n))))
    by_noise = float(np.sqrt(np.mean(noise**2 + 2.0 * noise * mean) / n))
    scatter = float(np.var(square, ddof=1)) - by_noise**2 * n if n > 1 else 0.0
    alone = 1.0 + (n - 1.0) * float(np.clip(scatter / (0.5 * mean**2), 0.0, 1.0))
    sigma2 = np.hypot(by_noise, mean * np.sqrt(0.5 / alone))
    size = float(np.sqrt(0.5 * mean))
    return size, float(0.5 * sigma2 / (2.0 * size))


def _jitter(screening: _Screening) -> IdentifiedEffect:
    sd, sigma = screening.common.jitter_px()
    parameters = tuple(
        ParameterEstimate(f"sd_{axis}_px", float(value), float(undecided), "px")
        for axis, value, undecided in zip("xy", sd, sigma, strict=True)
    )
    size_px = float(np.hypot(*sd))
    p_value = min(1.0, 2.0 * screening.common.p_value())
    return IdentifiedEffect(
        ROW_JITTER.name,
        parameters,
        3.0 * size_px,
        screening.odds[ROW_JITTER.name],
        p_value,
        False,
        ModelEffect(ROW_JITTER.name, (), max(size_px, 1e-6)),
    )


def _thinned(power_spectrum: Spectrum) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Frequency and value of the largest power in each of up to `MAX_SPECTRUM_POINTS` equal bands."""
    power = power_spectrum.total / len(power_spectrum.power)
    bands = np.array_split(np.arange(len(power)), min(MAX_SPECTRUM_POINTS, len(power)))
    peaks = [int(band[np.argmax(power[band])]) for band in bands if len(band)]
    return tuple(float(power_spectrum.frequency_hz[at]) for at in peaks), tuple(float(power[at]) for at in peaks)


def _detection_threshold(power_spectrum: Spectrum) -> float:
    k = len(power_spectrum.power)
    return float(gammainccinv(k, 0.5 * SIGNIFICANCE_LEVEL / len(power_spectrum.frequency_hz))) / k
