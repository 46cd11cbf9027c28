"""The stated 95 % intervals hold the true value as often as they should, on synthetic data with known truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from semlive.qualify.figures.drift import DECAYED_PX, DriftRates, decay_results, fit_decay, rate_results
from semlive.qualify.figures.intervals import length_quantiles, magnitude_interval, mean_interval, scatter_interval
from semlive.qualify.figures.scan import slowest_row_time
from semlive.qualify.values import Figure, Undetermined

RUNS = 300
BINOMIAL = 3.0 * np.sqrt(0.95 * 0.05 / RUNS)
"""Three standard deviations of an observed coverage of 95 %."""


@pytest.mark.parametrize(("samples", "independent"), [(2, 60.0), (5, 60.0), (9, 400.0)])
def test_a_scatter_is_inside_its_interval(samples: int, independent: float) -> None:
    rng = np.random.default_rng(1)
    inside = 0
    for _ in range(RUNS):
        variances = 0.02**2 * rng.chisquare(independent, samples) / independent
        _, low, high = scatter_interval(variances, independent)
        inside += low <= 0.02 <= high
    assert abs(inside / RUNS - 0.95) <= BINOMIAL


@pytest.mark.parametrize("length", [0.0, 1.5, 20.0])
def test_a_length_is_inside_its_interval(length: float) -> None:
    rng = np.random.default_rng(2)
    inside = 0
    for _ in range(RUNS):
        _, low, high = magnitude_interval(np.array([length, 0.0]) + rng.standard_normal(2), np.ones(2), 1)
        inside += low <= length <= high
    assert inside / RUNS >= 0.95 - BINOMIAL


def _rates(rng: np.random.Generator, count: int, decay_s: float, scatter: float) -> DriftRates:
    time_s = np.arange(0.0, 60.0 * count, 60.0)
    final, start = np.array([0.002, -0.004]), np.array([0.02, 0.05])
    rate = final + start * np.exp(-time_s / decay_s)[:, None] + scatter * rng.standard_normal((count, 2))
    return DriftRates(time_s, rate, np.full((count, 2), 1e-5), 27.0, 28.0)


@pytest.mark.parametrize("scatter", [1e-3, 1e-4])
def test_decay_time_final_rate_and_waiting_time_are_inside_their_intervals(scatter: float) -> None:
    rng = np.random.default_rng(3)
    decay_s, count = 300.0, 60
    true = {
        "drift_decay": decay_s,
        "drift_rate_final": float(np.hypot(0.002, 0.004)),
        "waiting_time": decay_s * np.log(27.0 * np.hypot(0.02, 0.05) / DECAYED_PX),
    }
    inside = dict.fromkeys(true, 0)
    for _ in range(count):
        found = {item.name: item for item in decay_results(_rates(rng, 12, decay_s, scatter))}
        for name, value in true.items():
            figure = found[name]
            assert isinstance(figure, Figure)
            inside[name] += figure.low <= value <= figure.high
    assert all(0.85 <= held / count <= 1.0 for held in inside.values()), inside


def test_a_row_time_that_is_not_excluded_is_in_the_upper_end_of_the_waiting_time() -> None:
    rates = _rates(np.random.default_rng(5), 12, 300.0, 1e-4)
    (stated, slow) = (next(item for item in decay_results(rates, slowest) if item.name == "waiting_time") for slowest in (1.0, 1.5))
    assert isinstance(stated, Figure)
    assert isinstance(slow, Figure)
    assert (slow.value, slow.low) == (stated.value, stated.low)
    assert slow.high - stated.high == pytest.approx(300.0 * np.log(1.5), rel=0.1)


def test_a_constant_rate_has_no_decay() -> None:
    rng = np.random.default_rng(4)
    found = sum(fit_decay(_rates(rng, 10, 1e9, 1e-3)) is not None for _ in range(50))
    assert found <= 3
    (reason,) = decay_results(_rates(rng, 3, 300.0, 1e-3))
    assert isinstance(reason, Undetermined)
    assert "at least 4 pairs" in reason.remedy


def test_the_interval_of_a_length_that_may_be_zero_begins_at_zero() -> None:
    rng = np.random.default_rng(5)
    draws = rng.standard_normal((2000, 2))
    assert length_quantiles(draws)[1] == 0.0
    _, low, high = length_quantiles(draws + np.array([6.0, 0.0]))
    assert 3.5 < low < 6.0 < high < 8.5


def test_the_mean_of_a_frame_is_inside_the_interval_of_its_parts() -> None:
    rng = np.random.default_rng(6)
    inside = 0
    for _ in range(RUNS):
        parts = 42.0 + rng.standard_normal(16)
        _, low, high = mean_interval(float(parts.mean()), parts)
        inside += low <= 42.0 <= high
    assert abs(inside / RUNS - 0.95) <= BINOMIAL


def test_a_longer_row_time_than_stated_makes_the_drift_of_a_frame_larger() -> None:
    rates = DriftRates(np.zeros(1), np.array([[0.03, 0.04]]), np.full((1, 2), 1e-5), 20.0, 21.0)
    found = {item.name: item for item in rate_results(rates, 0.1, 10.0, timed=True, stretch=(1.25, 0.01))}
    for name, true in (("drift_in_frame", 1.25), ("drift_strain", 1.25 * 0.05 * 0.1), ("drift_rate", 0.05)):
        figure = found[name]
        assert isinstance(figure, Figure)
        assert figure.value == pytest.approx(true)
        assert (figure.high - figure.low) / figure.value > (0.03 if name != "drift_rate" else 0.0)


def test_a_pause_between_frames_may_be_a_longer_row_time() -> None:
    rates = DriftRates(np.zeros(1), np.array([[0.03, 0.04]]), np.full((1, 2), 1e-5), 20.0, 25.0)
    interval = Figure("frame_interval", "frame interval", 1.25, 1.24, 1.26, "")
    found = {item.name: item for item in rate_results(rates, 0.1, 10.0, timed=True, slowest=slowest_row_time([interval]))}
    for name in ("drift_in_frame", "drift_strain"):
        figure = found[name]
        assert isinstance(figure, Figure)
        assert figure.value * 1.25 == pytest.approx(figure.high, rel=1e-3)
        assert figure.low == pytest.approx(figure.value, rel=1e-3)
    assert slowest_row_time([replace(interval, value=2.0)]) == 1.5
    assert slowest_row_time([replace(interval, value=0.8)]) == 1.0
    assert slowest_row_time([]) == 1.0
