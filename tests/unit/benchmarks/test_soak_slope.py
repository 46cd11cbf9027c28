"""The statistic of the soak campaign that detects memory growth in noise."""

from __future__ import annotations

import numpy as np
from bench_soak import grows, slope

TIMES_S, PAIRS_PER_S = np.arange(2000.0), 0.5


def noise(seed: int, memory_s: float = 1.0) -> np.ndarray:
    rng, stored = np.random.default_rng(seed), np.exp(-1.0 / memory_s)
    fresh, found = rng.normal(0.0, 0.5, len(TIMES_S)), np.zeros(len(TIMES_S))
    for at in range(1, len(found)):
        found[at] = stored * found[at - 1] + np.sqrt(1.0 - stored**2) * fresh[at]
    return 100.0 + found


def growth(mb_per_1000_pairs: float) -> np.ndarray:
    return mb_per_1000_pairs * TIMES_S * PAIRS_PER_S / 1000.0


def test_constant_memory_rarely_counts_as_growth_and_its_slope_error_is_calibrated() -> None:
    reported = [slope(TIMES_S, noise(seed), PAIRS_PER_S) for seed in range(150)]
    assert sum(map(grows, reported)) < 15
    scatter = np.std([item["mb_per_1000_pairs"] for item in reported])
    assert 0.8 < np.mean([item["standard_error"] for item in reported]) / scatter < 1.3


def test_memory_growth_is_detected_in_steps_and_in_noise() -> None:
    assert all(grows(slope(TIMES_S, noise(seed) + growth(0.8), PAIRS_PER_S)) for seed in range(20))
    steps = growth(2.0) // 0.5 * 0.5
    assert all(grows(slope(TIMES_S, noise(seed) + steps, PAIRS_PER_S)) for seed in range(20))
    assert all(grows(slope(TIMES_S, 100.0 + 20.0 * (noise(seed) - 100.0) + growth(3.0), PAIRS_PER_S)) for seed in range(20))
    assert grows({})


def test_autocorrelated_noise_has_a_larger_slope_error() -> None:
    quick, slow = (np.mean([slope(TIMES_S, noise(seed, s), PAIRS_PER_S)["alike"] for seed in range(40)]) for s in (1.0, 300.0))
    assert slow > quick + 0.2
