"""A forecast of the drift's rate holds within its intervals, and its uncertainty grows as it looks further ahead."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from semlive import estimate as estimating
from semlive.data.drift import DriftForecast
from semlive.data.settings import EstimateSettings

Field = NDArray[np.float64]
RANDOM_PX_S = 1e-4  # change of the rate every ten seconds: a twentieth of a pixel per scan in half an hour, at random


def forecast_of(world: Any, steps: list[Any]) -> tuple[DriftForecast, estimating.Solution]:
    state = estimating.init(EstimateSettings(), world.grid, 1024, 884)
    for item in world.pairs(steps):
        state = estimating.update(state, item.pair, item.step.phase, item.times, item.maps)
    solution = estimating.solve(state)
    return estimating.forecast(solution), solution


def normalised(forecast: DriftForecast, drift: Callable[[Field], Field]) -> Field:
    """(scans, 2) errors over sigma."""
    true = (drift(forecast.time_s + forecast.duration_s) - drift(forecast.time_s)) / forecast.duration_s
    return (forecast.rate_px_s - true) / forecast.sigma_px_s


def test_the_forecast_of_a_settling_drift_holds(world: Callable[..., Any], plans: dict[str, list[Any]]) -> None:
    """Warm-up with a time constant of half an hour and a drift beyond it, neither of them a spline; seen for 40 minutes."""
    z, wrong_px = [], []
    for seed in range(300, 304):
        item = world(seed, step_px=60)
        found, _ = forecast_of(item, plans["short"][:7])
        assert np.all(np.diff(found.sigma_px_s, axis=0) > 0)
        z.append(normalised(found, item.drift))
        wrong_px.append(z[-1] * found.sigma_px_s * found.duration_s)
    assert np.mean(np.abs(z) < 1.96) >= 0.9
    assert 0.3 < np.sqrt(np.mean(np.square(z))) < 1.2
    assert np.sqrt(np.mean(np.square(wrong_px), axis=(0, 2)))[0] < 0.01  # of about 0.3 px in a scan


def test_the_forecast_of_a_random_drift_holds(world: Callable[..., Any], plans: dict[str, list[Any]]) -> None:
    """The rate is a random walk: the future is uncertain, and the intervals reflect that."""
    z = []
    for seed in range(310, 316):
        item, at_s = world(seed, step_px=60), np.arange(0.0, 6000.0, 10.0)
        rates = np.cumsum(np.random.default_rng(seed).normal(0, RANDOM_PX_S, (len(at_s), 2)), axis=0)
        walked = np.concatenate((np.zeros((1, 2)), 10.0 * np.cumsum(rates, axis=0)[:-1]))

        def drift(time_s: Field, at_s: Field = at_s, walked: Field = walked) -> Field:
            return np.stack([np.interp(time_s, at_s, walked[:, axis]) for axis in (0, 1)], axis=-1)

        item.drift = drift
        z.append(normalised(forecast_of(item, plans["short"][:7])[0], drift))
    assert 0.6 < np.sqrt(np.mean(np.square(z))) < 1.3
    assert np.mean(np.abs(z) < 1.96) >= 0.9


def test_the_forecast_of_waves_of_ten_minutes_to_an_hour_holds(world: Callable[..., Any], plans: dict[str, list[Any]]) -> None:
    """As a room, a chiller and an instrument give: 0.3 px rms of eight waves, in an experiment that is as long as two of the longest."""
    z = []
    for seed in range(330, 336):
        item, phase = world(seed, step_px=60), np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, (2, 8))
        period_s = np.geomspace(600.0, 3600.0, 8)

        def drift(time_s: Field, phase: Field = phase, period_s: Field = period_s) -> Field:
            waves = np.sin(2.0 * np.pi * np.asarray(time_s)[..., None, None] / period_s + phase)
            return 0.3 * np.sqrt(2.0 / 8.0) * waves.sum(axis=-1)

        item.drift = drift
        z.append(normalised(forecast_of(item, plans["full"][:10])[0], drift))
    assert 0.5 < np.sqrt(np.mean(np.square(z))) < 1.3
    assert np.mean(np.abs(z) < 1.96) >= 0.88


def test_the_forecast_begins_where_the_estimate_ends(world: Callable[..., Any], plans: dict[str, list[Any]]) -> None:
    found, solution = forecast_of(world(320, step_px=60), plans["short"][:4])
    assert found.time_s[0] == pytest.approx(solution.state.frames[-1].start_s + found.duration_s)
    np.testing.assert_allclose(found.rate_px_s[0], estimating.current_drift_rate(solution), atol=4 * float(found.sigma_px_s[0].max()))
    published = estimating.to_estimate(solution, 1).drift.forecast
    assert published is not None
    np.testing.assert_array_equal(published.rate_px_s, found.rate_px_s)
