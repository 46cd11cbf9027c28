"""Scan: interval of frames against the stated frame time, waves and jitter of rows, settling at the row start, effects of a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from semlive.data.diagnosis.channels import RowDiagnosis
from semlive.data.diagnosis.effects import IdentifiedEffect, Outcome, ParameterEstimate
from semlive.data.frame import FrameInfo
from semlive.data.scan import Provenance
from semlive.qualify.figures.intervals import NORMAL_95, Interval, about
from semlive.qualify.figures.slow_waves import SlowWave
from semlive.qualify.figures.wave_amplitudes import amplitude_interval
from semlive.qualify.figures.waves import MIN_SHARE, RowPairs, is_beyond_response, is_wave, stated_waves
from semlive.qualify.values import Figure, Result, Trend, Undetermined

STATED_TIMES = (Provenance.FILE, Provenance.DERIVED)
MAX_ROW_TIME = 1.5
"""Largest expected ratio of the true to the stated row time."""
TIMES_REMEDY = "export files that contain dwell, row and frame time and the time of the scan, or give them in frames.csv"
ROWS_REMEDY = "take pairs of at least 100 rows, one right after the other"


def interval_results(pairs: Sequence[tuple[FrameInfo, FrameInfo]]) -> list[Result]:
    """Interval of the frames of a pair in units of the stated frame time: 1 for a continuous scan, and never less.

    A ratio below 1 proves a wrong frame or row time. A larger ratio is a pause between the frames, or a row time that is too short in the
    file; a second dwell separates both, because the pause does not change with the dwell.
    """
    first = pairs[0][0]
    times = (first.start_time_ns.source, first.timing.frame_time_s.source)
    if any(source not in (*STATED_TIMES, Provenance.CONFIG) for source in times):
        return [Undetermined("frame_interval", "the files do not contain the times of the scans", TIMES_REMEDY)]
    ratio, sigma = [], []
    for before, after in pairs:
        duration_s = before.timing.duration_s
        ratio.append((after.start_time_ns.value - before.start_time_ns.value) * 1e-9 / duration_s)
        sigma.append(np.hypot(before.start_sigma_s, after.start_sigma_s) / duration_s)
    value, error = float(np.median(ratio)), NORMAL_95 * float(np.median(sigma)) / np.sqrt(len(ratio))
    note = "interval of the frames of a pair in units of the frame time in the file; below 1 the row time in the file is too long"
    return [Figure("frame_interval", "frame interval", value, value - error, value + error, "", Trend.NONE, note)]


def slowest_row_time(intervals: Sequence[Result]) -> float:
    """Largest true over stated row time that the interval of the frames permits.

    The rows of a frame may take all of the time to the next one. A row time that is longer by more than half is not expected.
    """
    ratios = [result.value for result in intervals if isinstance(result, Figure)]
    return min(max((1.0, *ratios)), MAX_ROW_TIME)


def row_results(rows: RowDiagnosis | None, reason: str, pairs: RowPairs, slow: SlowWave | None = None) -> list[Result]:
    """Frequencies and amplitudes of waves, and jitter, of the rows; or why they are not determined.

    Args:
        rows: verdict on the rows; None without one.
        reason: why there is no verdict.
        pairs: rows of the pairs.
        slow: wave near a multiple of the row rate in the maps within the pairs; None without one.
    """
    if rows is None:
        return [Undetermined("rows", reason, ROWS_REMEDY)]
    if rows.outcome is Outcome.NONE and slow is None:
        p_value = min((test.p_value for test in rows.where), default=1.0)
        return [
            Undetermined(
                "row_waves", f"no hum, vibration or row jitter is significant (p = {p_value:.2g})", "none is needed", by_pairs=False
            )
        ]
    found = [] if slow is None else _slow_results(slow, pairs)
    effects = rows.effects if slow is None else (*rows.effects, slow.effect)
    for effect in rows.effects:
        # A slow wave makes smaller waves and jitter of the rows: one of 0.48 px made five waves of up to 0.016 px, among them hum.
        if slow is not None and (effect.name == slow.effect.name or effect.peak_px < slow.effect.peak_px):
            continue
        if not is_wave(effect):
            found += _above_share(_jitter_figures(effect)) if is_beyond_response(effect, pairs) else []
            continue
        for wave in stated_waves(effect, effects, pairs):
            half_hz = NORMAL_95 * pairs.frequency_sigma_hz(wave.frequency)
            found.append(_figure(effect.name, wave.frequency, about(wave.frequency.value, half_hz)))
            sizes = enumerate((wave.along_x, wave.along_y))
            found += _above_share([_figure(effect.name, size, amplitude_interval(axis, wave.frequency, pairs)) for axis, size in sizes])
    return found


def _slow_results(slow: SlowWave, pairs: RowPairs) -> list[Result]:
    """Frequency and amplitudes of a wave near a multiple of the row rate."""
    name, (frequency, *sizes) = slow.effect.name, slow.effect.parameters
    figures = list[Figure]()
    for axis, size in enumerate(sizes):
        value, low, high = amplitude_interval(axis, frequency, pairs, slow.wave)
        error = NORMAL_95 * slow.relative_sigma * value
        interval = value, max(value - float(np.hypot(value - low, error)), 0.0), value + float(np.hypot(high - value, error))
        figures.append(_figure(name, size, interval))
    return [_parameter(name, frequency), *_above_share(figures)]


def _above_share(sizes: Sequence[Figure]) -> list[Figure]:
    """Sizes along x and y; the lower end of one that may be a consequence of the other is 0."""
    largest = max(size.value for size in sizes)
    return [size if size.value >= MIN_SHARE * largest else replace(size, low=min(size.low, 0.0)) for size in sizes]


def effect_figures(effect: IdentifiedEffect) -> list[Figure]:
    """One figure for each parameter of an effect."""
    return [_parameter(effect.name, parameter) for parameter in effect.parameters]


def _jitter_figures(jitter: IdentifiedEffect) -> list[Figure]:
    """Standard deviations along x and y with the intervals of their squares, whose errors are normal.

    Without this 0.0029 px along y excluded zero, with jitter along x alone.
    """
    figures = list[Figure]()
    for size in jitter.parameters:
        square, sigma2 = size.value**2, max(2.0 * size.value * size.sigma, size.sigma**2)
        low, high = (float(np.sqrt(max(square + side * NORMAL_95 * sigma2, 0.0))) for side in (-1.0, 1.0))
        figures.append(_figure(jitter.name, size, (size.value, low, high)))
    return figures


def peak_figure(effect: IdentifiedEffect) -> Figure:
    """Largest displacement by an effect of the maps, with the relative uncertainty of its amplitudes."""
    amplitudes, covariance = np.array(effect.amplitudes_px), np.array(effect.covariance_px2)
    square = float(amplitudes @ amplitudes)
    relative = float(np.sqrt(amplitudes @ covariance @ amplitudes)) / square if square else 0.0
    interval = about(effect.peak_px, NORMAL_95 * relative * effect.peak_px)
    return Figure(f"{effect.name}_peak", f"{effect.name.replace('_', ' ')}: largest displacement", *interval, "px")


def _parameter(effect: str, parameter: ParameterEstimate) -> Figure:
    return _figure(effect, parameter, about(parameter.value, NORMAL_95 * parameter.sigma))


def _figure(effect: str, parameter: ParameterEstimate, interval: Interval) -> Figure:
    name = f"{effect}_{parameter.name}"
    trend = Trend.LARGER if parameter.unit == "px" else Trend.NONE
    return Figure(name, f"{effect.replace('_', ' ')}: {parameter.name.replace('_', ' ')}", *interval, parameter.unit, trend)
