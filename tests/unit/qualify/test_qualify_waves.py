"""Waves of the rows: frequency and amplitude are inside their intervals, whether or not the phase continues from frame to frame."""

from __future__ import annotations

import numpy as np
import pytest

from semlive.data.diagnosis.effects import IdentifiedEffect, ModelEffect, ParameterEstimate
from semlive.diagnose.rows.series import RowSeries
from semlive.qualify.scan import peak_figure
from semlive.qualify.waves import RowPairs, amplitude_interval, certain_effects, stated_waves, strongest_px

ROWS, ROW_S, DWELL_S, INTERVAL_S, MAINS_HZ = 400, 0.061, 1e-4, 27.362, 50.0
AMPLITUDES_PX = np.array([0.5, 0.25])
PAIRS = 9


def _pairs(turns: np.ndarray) -> RowPairs:
    """Pairs whose second frame has the wave with another phase, by turns (k,), and noise."""
    rng, row_px, middle_px = np.random.default_rng(8), np.arange(float(ROWS)), np.arange(21.0, 504.0, 42.0)
    series = []
    for turn in turns:
        at = 2.0 * np.pi * (rng.uniform() + MAINS_HZ * (row_px[:, None] * ROW_S + middle_px * DWELL_S))
        wave = np.sin(at + 2.0 * np.pi * turn) - np.sin(at)
        shift = AMPLITUDES_PX[:, None, None] * wave + 0.1 * rng.standard_normal((2, ROWS, 12))
        series.append(RowSeries(shift, np.full(shift.shape, 100.0), row_px, middle_px, 1e-3, ROW_S, DWELL_S, 1.0))
    return RowPairs(series, np.full(len(turns), INTERVAL_S), np.zeros((len(turns), 2)))


def _given(value: float, sigma: float, name: str = "amplitude_x_px") -> ParameterEstimate:
    return ParameterEstimate(name, value, sigma, "px")


FREQUENCY = ParameterEstimate("frequency_hz", MAINS_HZ, 1e-5, "Hz")


@pytest.mark.parametrize("axis", [0, 1])
def test_a_hum_that_continues_has_the_amplitude_that_its_phase_gives(axis: int) -> None:
    pairs = _pairs(np.full(PAIRS, MAINS_HZ * INTERVAL_S))
    _, low, high = amplitude_interval(_given(0.46 * AMPLITUDES_PX[axis], 0.08), axis, FREQUENCY, pairs)
    assert low <= AMPLITUDES_PX[axis] <= high
    assert high < 2.0 * AMPLITUDES_PX[axis]


def test_independent_phases_have_the_interval_of_the_diagnosis() -> None:
    pairs = _pairs(np.random.default_rng(9).uniform(size=PAIRS))
    assert amplitude_interval(_given(0.48, 0.05), 0, FREQUENCY, pairs)[0] == 0.48


def test_the_frequency_of_a_slow_alias_is_less_certain() -> None:
    pairs = _pairs(np.zeros(2))
    slow, fast = pairs.frequency_sigma_hz(FREQUENCY), pairs.frequency_sigma_hz(ParameterEstimate("frequency_hz", 57.0, 1e-5, "Hz"))
    assert slow > 5e-4 > 2e-4 > fast


def test_a_wave_that_a_stronger_one_makes_is_not_stated() -> None:
    parameters = tuple(
        ParameterEstimate(f"{name}_{number}", value, 1e-3, unit)
        for number, size in ((1, 0.2), (2, 0.008))
        for name, value, unit in (("frequency", 50.0 * number, "Hz"), ("x", 0.1 * size, "px"), ("y", size, "px"))
    )
    hum = IdentifiedEffect("mains_hum", parameters, 0.2, 50.0, 1e-3, strain=False, model_effect=ModelEffect("mains_hum", (), 0.2))
    assert [frequency.value for frequency, *_ in stated_waves(hum, strongest_px([hum]))] == [50.0]


def test_the_largest_displacement_of_an_effect_has_the_uncertainty_of_its_amplitude() -> None:
    model = ModelEffect("wrong_row_time", (), 0.1)
    effect = IdentifiedEffect("wrong_row_time", (), 0.15, 50.0, 1e-3, False, model, amplitudes_px=(0.25,), covariance_px2=((0.0001,),))
    figure = peak_figure(effect)
    assert figure.high - figure.value == pytest.approx(1.96 * 0.15 * 0.04, rel=1e-3)


def test_effects_of_the_maps_within_the_motion_of_the_rows_are_not_certain() -> None:
    sizes = (("mains_hum", 0.4), ("wrong_row_time", 0.1), ("distortion_scale_drift", 0.6))
    hum, *in_maps = (IdentifiedEffect(name, (), px, 50.0, 1e-3, False, ModelEffect(name, (), px)) for name, px in sizes)
    assert [effect.name for effect in certain_effects(in_maps, [hum])] == ["distortion_scale_drift"]
    assert certain_effects(in_maps, []) == tuple(in_maps)
