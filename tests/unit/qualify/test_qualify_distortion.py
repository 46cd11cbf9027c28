"""The interval of the largest distortion contains the truth also where noise is larger than the distortion."""

from __future__ import annotations

import numpy as np
import pytest

from semlive.qualify.figures.distortion import largest_interval


@pytest.mark.parametrize("size", [0.3, 30.0])
def test_the_largest_of_noisy_lengths_is_covered(size: float) -> None:
    """A field of 6 places, of which one has the length `size`, with noise of 1 and a prior of 0.5 or its size at each."""
    rng, inside = np.random.default_rng(7), 0
    true = np.zeros((6, 2))
    true[2, 0] = size
    share = 1.0 / (1.0 + max(size, 0.5) ** -2.0)
    for _ in range(60):
        mean = share * (true + rng.standard_normal(true.shape))
        draws = mean + np.sqrt(share) * rng.standard_normal((400, *true.shape))
        _, low, high = largest_interval(np.linalg.norm(np.concatenate((mean[None], draws)), axis=2).max(axis=1))
        inside += low <= size <= high
    assert inside >= 53  # 98 of 100 counts of 60 with a probability of 95 %
