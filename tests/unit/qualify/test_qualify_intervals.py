"""The stated 95 % intervals hold the true value as often as they should, on synthetic data with known truth."""

from __future__ import annotations

import numpy as np
import pytest

from semlive.qualify.drift import DECAYED_PX, DriftRates, decay_results, fit_decay
from semlive.qualify.intervals import magnitude_interval, scatter_interval
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
    time_s = 60.0 * np.arange(count)
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


def test_a_constant_rate_has_no_decay() -> None:
    rng = np.random.default_rng(4)
    found = sum(fit_decay(_rates(rng, 10, 1e9, 1e-3)) is not None for _ in range(50))
    assert found <= 3
    (reason,) = decay_results(_rates(rng, 3, 300.0, 1e-3))
    assert isinstance(reason, Undetermined)
    assert "at least 4 pairs" in reason.remedy
