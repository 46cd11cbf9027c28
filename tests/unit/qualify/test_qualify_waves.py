"""Waves of the rows: frequency and amplitude are inside their intervals, whether or not the phase continues from frame to frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from semlive.data.diagnosis.effects import IdentifiedEffect, ModelEffect, ParameterEstimate
from semlive.diagnose.rows.series import RowSeries
from semlive.qualify.figures.scan import peak_figure
from semlive.qualify.figures.wave_amplitudes import amplitude_interval
from semlive.qualify.figures.waves import RowMotion, RowPairs, certain_effects, stated_waves
from semlive.qualify.values import Figure

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


FREQUENCY = ParameterEstimate("frequency_hz", MAINS_HZ, 1e-5, "Hz")


@pytest.mark.parametrize("axis", [0, 1])
def test_a_hum_that_continues_has_the_amplitude_that_its_phase_gives(axis: int) -> None:
    pairs = _pairs(np.full(PAIRS, MAINS_HZ * INTERVAL_S))
    _, low, high = amplitude_interval(axis, FREQUENCY, pairs)
    assert low <= AMPLITUDES_PX[axis] <= high
    assert high < 2.0 * AMPLITUDES_PX[axis]


def test_intervals_of_independent_phases_contain_the_amplitude() -> None:
    """Of 60 runs with 95 % of right intervals, 53 to 60 contain the truth with a probability of 98 %."""
    rng, inside, widths = np.random.default_rng(9), 0, []
    for _ in range(60):
        value, low, high = amplitude_interval(0, FREQUENCY, _pairs(rng.uniform(size=PAIRS)))
        inside += low <= AMPLITUDES_PX[0] <= high
        widths.append((high - low) / value)
    assert inside >= 53
    assert np.median(widths) < 0.5  # 0.46 +- 0.12 from the mean square


def test_a_pair_without_data_and_equal_phases_of_both_frames_give_an_interval() -> None:
    pairs = _pairs(np.zeros(4))
    empty = replace(pairs.series[0], shift_px=np.zeros((2, ROWS, 12)), weight=np.zeros((2, ROWS, 12)))
    equal = replace(pairs, series=[empty, *pairs.series[1:]], interval_s=np.full(4, 4.0 / MAINS_HZ))
    value, low, high = amplitude_interval(0, replace(FREQUENCY, sigma=0.0), equal)
    assert np.isfinite([value, low, high]).all()
    assert low <= value <= high


def test_the_frequency_of_a_slow_alias_is_less_certain() -> None:
    pairs = _pairs(np.zeros(2))
    slow, fast = pairs.frequency_sigma_hz(FREQUENCY), pairs.frequency_sigma_hz(ParameterEstimate("frequency_hz", 57.0, 1e-5, "Hz"))
    assert slow > 5e-4 > 2e-4 > fast


def _hum(*waves: tuple[float, float]) -> IdentifiedEffect:
    parameters = tuple(
        ParameterEstimate(f"{name}_{number}", value, 1e-3, unit)
        for number, (frequency_hz, size_px) in enumerate(waves)
        for name, value, unit in (("frequency", frequency_hz, "Hz"), ("x", 0.1 * size_px, "px"), ("y", size_px, "px"))
    )
    return IdentifiedEffect("mains_hum", parameters, 0.2, 50.0, 1e-3, strain=False, model_effect=ModelEffect("mains_hum", (), 0.2))


ADJACENT_HZ = 50.0 + (1.0 + 1.0 / ROWS) / ROW_S
"""A cycle per frame from the alias of 50 Hz."""


@pytest.mark.parametrize(
    ("further", "stated"), [((100.0, 0.008), False), ((100.0, 0.03), True), ((ADJACENT_HZ, 0.03), False), ((ADJACENT_HZ, 0.15), True)]
)
def test_a_wave_that_a_stronger_one_makes_is_not_stated(further: tuple[float, float], stated: bool) -> None:
    hum = _hum((50.0, 0.2), further)
    waves = stated_waves(hum, [hum], _pairs(np.zeros(1)))
    assert [wave.frequency.value for wave in waves] == [50.0, *([further[0]] if stated else [])]


def test_the_mean_motion_is_as_uncertain_as_its_rows() -> None:
    def figure(name: str, value: float, unit: str = "px") -> Figure:
        return Figure(name, name, value, value, value, unit)

    jitter = [figure("row_jitter_sd_x_px", 0.3), figure("row_jitter_sd_y_px", 0.4)]
    assert RowMotion.of(jitter, 200).mean_sigma_px == pytest.approx(0.05)
    hum = [figure("mains_hum_frequency_hz", 50.0, "Hz"), figure("mains_hum_amplitude_x_px", 0.4), figure("mains_hum_amplitude_y_px", 0.3)]
    assert RowMotion.of(hum, 200).mean_sigma_px == pytest.approx(0.15 * 0.25)
    assert RowMotion.of([], 200).mean_sigma_px == 0.0


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
