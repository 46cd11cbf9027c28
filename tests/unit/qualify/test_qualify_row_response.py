"""Amplitudes of strong waves of the rows are right, in frames of Gaussian spots that are evaluated exactly at every pixel."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from semlive import dic
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.data.settings import DicSettings
from semlive.diagnose.rows.registration import register_image_rows
from semlive.diagnose.rows.series import RowSeries
from semlive.diagnose.rows.verdict import diagnose_rows
from semlive.qualify.figures.pixel_noise import pixel_noise
from semlive.qualify.figures.row_response import Pattern
from semlive.qualify.figures.wave_amplitudes import amplitude_interval, with_response
from semlive.qualify.figures.waves import RowPairs, is_wave, stated_waves, waves_of

HEIGHT_PX, WIDTH_PX, SPOTS, SPOT_PX, NOISE_GREY = 300, 256, 2200, 1.9, 4.0
ROW_S, DWELL_S, WAVE_HZ = 0.0135, 4e-5, 22.97
"""0.31 cycles per row."""
SIZES_PX = np.array((0.2, 0.47))
FILE = Provenance.FILE
TIMING = ScanTiming(Sourced(DWELL_S, FILE), Sourced(ROW_S, FILE), Sourced(ROW_S * HEIGHT_PX, FILE), Sourced(1, FILE))
SETTINGS = DicSettings(subset_px=31, step_px=10, roi_px=None, method="subset")
REACH = 9


def _frame(phase: float, sizes_px: np.ndarray, seed: int) -> np.ndarray:
    """Frame of one specimen with a wave of the rows."""
    places, noise = np.random.default_rng(5), np.random.default_rng((seed, 6))
    rows, columns = np.indices((HEIGHT_PX, WIDTH_PX), dtype=np.float64)
    wave = np.cos(2.0 * np.pi * WAVE_HZ * (rows * ROW_S + columns * DWELL_S) + phase)
    x_px, y_px, grey = columns + sizes_px[0] * wave, rows + sizes_px[1] * wave, np.full(rows.shape, 40.0)
    for _ in range(SPOTS):
        x, y, size = places.uniform(0, WIDTH_PX), places.uniform(0, HEIGHT_PX), places.uniform(20.0, 110.0)
        near = np.s_[max(int(y) - REACH, 0) : int(y) + REACH + 2, max(int(x) - REACH, 0) : int(x) + REACH + 2]
        grey[near] += size * np.exp(-0.5 * ((x_px[near] - x) ** 2 + (y_px[near] - y) ** 2) / SPOT_PX**2)
    return np.clip(np.round(grey + NOISE_GREY * noise.standard_normal(grey.shape)), 0, 255).astype(np.uint8)


@cache
def _measured() -> tuple[RowPairs, Pattern]:
    """Five pairs in which the wave has another phase in every frame."""
    phases, series = np.random.default_rng(7).uniform(0.0, 2.0 * np.pi, (5, 2)), list[RowSeries]()
    first = _frame(float(phases[0, 0]), SIZES_PX, 0)
    for pair, (before, after) in enumerate(phases):
        images = [_frame(phase, SIZES_PX, 2 * pair + at) for at, phase in enumerate((before, after))]
        found = register_image_rows(images[0], images[1], dic.match(images[0], images[1], settings=SETTINGS), TIMING)
        assert found is not None
        series.append(found)
    return RowPairs(series, np.zeros(len(series)), np.zeros((len(series), 2))), Pattern.of(first, pixel_noise(first)[0])


def test_a_strong_wave_has_its_amplitude_and_causes_no_further_one() -> None:
    pairs, pattern = _measured()
    effects = diagnose_rows(pairs.series).effects
    waves = [wave for effect in effects if is_wave(effect) for wave in waves_of(effect)]
    strongest = max(waves, key=lambda wave: wave.size_px).frequency
    assert strongest.value == pytest.approx(WAVE_HZ, abs=0.01)
    assert len(waves) > 1  # twice the frequency, and more
    plain = amplitude_interval(1, strongest, pairs)[0]
    assert plain < 0.85 * SIZES_PX[1]
    corrected = with_response(pairs, effects, pattern, TIMING, SETTINGS)
    for axis, true_px in enumerate(SIZES_PX):
        value, low, high = amplitude_interval(axis, strongest, corrected)
        assert low <= true_px <= high
        assert value == pytest.approx(true_px, rel=(0.15, 0.08)[axis])
    stated = [wave.frequency.value for effect in effects if is_wave(effect) for wave in stated_waves(effect, effects, corrected)]
    assert stated == [strongest.value]


def test_a_texture_has_the_spectrum_of_the_pattern() -> None:
    pattern = _measured()[1]
    texture = pattern.texture(np.random.default_rng(4))
    assert np.std(texture) == pytest.approx(np.std(pattern.image.astype(float)), rel=0.1)
    along = [float(np.std(np.diff(texture, axis=axis)) / np.std(np.diff(pattern.image.astype(float), axis=axis))) for axis in (0, 1)]
    assert along == pytest.approx([0.5, 0.5], rel=0.2)  # at half of the distance, with the noise in the frame


def test_motion_turns_a_wave_by_the_alias_on_rows_and_by_less_between_them() -> None:
    pattern = _measured()[1]
    assert pattern.turned(0.31, 3.0) == pytest.approx(0.93 - 1.0, abs=1e-6)
    assert 0.4 * 0.035 < pattern.turned(0.35, 0.1) < 0.8 * 0.035
    assert pattern.turned(-0.35, 0.1) == pytest.approx(-pattern.turned(0.35, 0.1), rel=0.01)
    assert pattern.turned(0.02, 0.1) == pytest.approx(0.002, rel=0.25)


def test_without_a_wave_nothing_is_measured() -> None:
    pairs, pattern = _measured()
    assert with_response(pairs, (), pattern, TIMING, SETTINGS) is pairs
